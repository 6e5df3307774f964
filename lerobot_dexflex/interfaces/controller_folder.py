"""Find a trained controller: the one shipped for a hand, a folder, or one on the Hugging Face hub."""

import re
from collections.abc import Sequence
from pathlib import Path

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand

CONTROLLER_FILES = ("config.json", "model.safetensors")
"""Files of a controller's folder that decide what its networks do."""
SHIPPED = Path(__file__).resolve().parents[2] / "policies/checkpoints"
"""Where the repository keeps its own controllers, in `controller_<name of the hand>`."""
_HUB_ID = re.compile(r"[\w.-]+/[\w.-]+")
_TRAIN = "dexflex-train --config=configs/controller/full.yaml"


def find_controller(
    hand: Hand, where: str | Path | None = None, files: Sequence[str] = CONTROLLER_FILES
) -> Path:
    """Return the folder of a controller.

    Args:
        hand: The hand that it is to serve.
        where: A folder or a hub id `owner/name`, which is downloaded once; the one shipped for the hand if
            empty.
        files: Files that must be there.

    Raises:
        DexFlexError: If there is none; says how to train one.
    """
    folder = Path(where) if where else SHIPPED / f"controller_{hand.name}"
    if not folder.is_dir() and isinstance(where, str) and _HUB_ID.fullmatch(where):
        folder = _download(where)
    missing = [name for name in files if not (folder / name).is_file()]
    if missing:
        raise DexFlexError(
            f"No controller for '{hand.name}' at {folder}: {', '.join(missing)} not found. Give "
            f"--policy.controller=<folder or hub id> of a trained one, or train it: {_TRAIN}"
        )
    return folder


def _download(hub_id: str) -> Path:
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import HfHubHTTPError, HFValidationError, LocalEntryNotFoundError

    try:
        return Path(snapshot_download(hub_id, allow_patterns=["*.json", "*.safetensors"]))
    except (HfHubHTTPError, HFValidationError, LocalEntryNotFoundError, OSError) as error:
        raise DexFlexError(
            f"No controller at {hub_id!r}: it is neither a folder here nor one that the hub gives "
            f"({type(error).__name__}). Check the name and the connection, or train one: {_TRAIN}"
        ) from error
