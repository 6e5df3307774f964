"""The folder beside an unfinished dataset that holds its finished attempts."""

import json
from pathlib import Path
from typing import Any

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.attempt import Attempt, load_attempt
from lerobot_dexflex.recording.recipe import Recipe
from lerobot_dexflex.runs.provenance import code_digest

RECORD_FILE = Path("meta/recording.json")
"""In a dataset: what was recorded, with which seeds, by which code."""


def staging_folder(root: Path) -> Path:
    """Return where the attempts of an unfinished recording wait."""
    where = root.resolve()
    return where.with_name(f"{where.name}.partial")


def is_complete(config: Recipe) -> bool:
    """Tell whether the dataset of this recipe is already there.

    Raises:
        DexFlexError: If the output folder holds anything else that recording would overwrite.
    """
    root, staging = config.root, staging_folder(config.root)
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        record = read_record(root, config.program)
        _check_same_recipe(config, record, root)
        if record["complete"]:
            if record["episodes"] == config.episodes:
                return True
            raise DexFlexError(
                f"{root} is a finished recording of {record['episodes']} episodes and cannot be changed to "
                f"{config.episodes}. Choose another --root, or move it away; nothing was changed."
            )
        if not staging.is_dir():
            raise DexFlexError(
                f"{root} is an interrupted recording, but its attempts in {staging} are gone, so it cannot "
                "be continued. Choose another --root, or move it away; nothing was changed."
            )
    return False


def open_staging(config: Recipe) -> Path:
    """Create or continue the staging folder of a recording.

    Raises:
        DexFlexError: If it belongs to another recipe or to other code; nothing is changed then.
    """
    staging = staging_folder(config.root)
    manifest = staging / "manifest.json"
    if manifest.is_file():
        found = _read_manifest(manifest)
        _check_same_recipe(config, found, staging)
        if found.get("controller", "") != config.controller_digest:
            raise DexFlexError(
                f"{staging} was recorded with another controller. Give --controller that one, choose another "
                f"--root, or delete {staging} to start again."
            )
        if config.repeatable and found["code"] != (code := code_digest(config.modules)):
            raise DexFlexError(
                f"{staging} was recorded by other code (digest {found['code']}, now {code}); mixing "
                "both would make a dataset nobody can reproduce. Go back to that code, choose another "
                f"--root, or delete {staging} to start again."
            )
        for leftover in staging.glob("*.tmp"):  # Of a process that was killed: this folder is ours alone.
            leftover.unlink()
        return staging
    temporary = manifest.with_suffix(".json.tmp")
    if staging.exists() and (not staging.is_dir() or set(staging.iterdir()) - {temporary}):
        raise DexFlexError(
            f"{staging} exists and is no staging folder of {config.program}. Choose another --root, or move "
            "it away; nothing was changed."
        )
    staging.mkdir(parents=True, exist_ok=True)
    origin = {"code": code_digest(config.modules), "controller": config.controller_digest}
    recipe = {"program": config.program, "recipe": config.to_dict()}
    temporary.write_text(json.dumps(recipe | origin, indent=2))
    temporary.replace(manifest)
    return staging


def staged_attempts(staging: Path) -> dict[int, Attempt]:
    """Return the finished attempts without their frames, by number."""
    attempts = [load_attempt(path, frames=False) for path in sorted(staging.glob("attempt_*.npz"))]
    return {attempt.index: attempt for attempt in attempts}


def _read_manifest(manifest: Path) -> dict[str, Any]:
    try:
        found = json.loads(manifest.read_text())
        _check_types(found, {"recipe": dict, "code": str})
    except (OSError, ValueError) as error:
        raise DexFlexError(
            f"{manifest} is damaged ({error}), so the recipe of the attempts beside it is unknown. "
            f"Choose another --root, or delete {manifest.parent} to start again."
        ) from error
    return found


def read_record(root: Path, program: str = "dexflex-record") -> dict[str, Any]:
    """Return what `RECORD_FILE` of a dataset says.

    Args:
        root: Folder of the dataset.
        program: What should have recorded it, for the message.

    Raises:
        DexFlexError: If there is none, or it is damaged.
    """
    types = {"complete": bool, "episodes": int, "expert": dict, "recipe": dict, "episode_seeds": list}
    try:
        record = json.loads((root / RECORD_FILE).read_text())
        _check_types(record, types | {"attempts": list})
        _check_types(record["recipe"], {"repo_id": str, "episodes": int})
    except (OSError, ValueError) as error:
        raise DexFlexError(
            f"{root} exists and is no recording of {program} (no readable {RECORD_FILE}: {error}). "
            "Choose another --root, or move it away; nothing was changed."
        ) from error
    return record


def _check_types(found: object, types: dict[str, type]) -> None:
    if not isinstance(found, dict):
        raise ValueError(f"a table of {', '.join(types)} was expected")
    for key, wanted in types.items():
        if type(found.get(key)) is not wanted:
            raise ValueError(f"{key} must be of type {wanted.__name__}, got {found.get(key)!r}")


def program_of(found: dict[str, Any]) -> str:
    """Return the console script that recorded, of a record or a manifest; early ones do not name it."""
    return found.get("program", "dexflex-record")


def _check_same_recipe(config: Recipe, found: dict[str, Any], where: Path) -> None:
    if (program := program_of(found)) != config.program:
        raise DexFlexError(
            f"{where} holds a recording of {program}, which {config.program} does not continue. Choose "
            "another --root, or move it away; nothing was changed."
        )
    wanted, have = config.identity(config.to_dict()), config.identity(found["recipe"])
    different = [
        f"{key}: {have[key]!r} there, {wanted[key]!r} now" for key in wanted if wanted[key] != have[key]
    ]
    if different:
        raise DexFlexError(
            f"{where} holds a recording of another recipe ({'; '.join(different)}). Choose another --root, "
            "or move it away; nothing was changed."
        )
