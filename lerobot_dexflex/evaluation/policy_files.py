"""Find out whether the files of a LeRobot checkpoint are all there and whole, before LeRobot reads them."""

import json
from pathlib import Path

from safetensors import SafetensorError, safe_open

from lerobot_dexflex.errors import DexFlexError

_PROCESSORS = ("policy_preprocessor.json", "policy_postprocessor.json")
POLICY_FILES = ("config.json", "model.safetensors", *_PROCESSORS)


def missing_files(folder: Path) -> list[str]:
    """Return the names of the files that a checkpoint needs and this folder lacks."""
    return [name for name in POLICY_FILES if not (folder / name).is_file()]


def check_policy_files(folder: Path) -> None:
    """Refuse a checkpoint with a missing, empty or cut-off file; reads no weights.

    Args:
        folder: Folder `pretrained_model`.

    Raises:
        DexFlexError: Names the file.
    """
    for name in missing_files(folder):
        raise DexFlexError(
            f"The checkpoint {folder} lacks {name}. A `pretrained_model` of lerobot-train holds "
            f"{', '.join(POLICY_FILES)}: copy all of it."
        )
    for name in ("config.json", *_PROCESSORS):
        settings = _read_json(folder / name)
        for state in _state_files(folder / name, settings) if name in _PROCESSORS else []:
            if not (folder / state).is_file():
                raise _damaged(folder / name, f"its {state} is missing")
    for file in sorted(folder.glob("*.safetensors")):
        try:
            with safe_open(file, "pt"):
                pass
        except (OSError, SafetensorError) as error:
            raise _damaged(file, str(error)) from error


def _read_json(file: Path) -> dict:
    try:
        settings = json.loads(file.read_text())
    except ValueError as error:
        raise _damaged(file, str(error)) from error
    if not isinstance(settings, dict):
        raise _damaged(file, "it holds no settings")
    return settings


def _state_files(file: Path, settings: dict) -> list[str]:
    steps = settings.get("steps")
    if not isinstance(steps, list) or not all(isinstance(step, dict) for step in steps):
        raise _damaged(file, "its steps are no list of settings")
    states = [step["state_file"] for step in steps if step.get("state_file") is not None]
    if not all(isinstance(state, str) for state in states):
        raise _damaged(file, "its steps are no list of settings, as a state_file is no name")
    return states


def _damaged(file: Path, why: str) -> DexFlexError:
    return DexFlexError(f"{file} is damaged: {why}. Copy the checkpoint again, or train it again.")
