"""A controller's folder: find it here or on the Hub, load its weights, save it.

`config.json` holds the checksums of the weights beside it, so that a damaged file is noticed.
"""

import hashlib
import json
import warnings
from pathlib import Path
from typing import Any, NamedTuple

from huggingface_hub import constants, hf_hub_download
from huggingface_hub.errors import EntryNotFoundError, HfHubHTTPError, HFValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from lerobot_dexflex.controller.config import CHECKSUMS, ControllerConfig
from lerobot_dexflex.controller.finite import check_weights
from lerobot_dexflex.errors import DexFlexError

CONFIG, WEIGHTS, RECORD = "config.json", constants.SAFETENSORS_SINGLE_FILE, "training.json"


class Files(NamedTuple):
    """Where the parts of a checkpoint lie."""

    config: Path
    weights: Path
    record: Path | None


def find(source: str | Path, **hub: Any) -> Files:
    """Return the files of a controller in a folder or, downloaded, on the Hub.

    Args:
        source: A folder or a Hub name `user/controller`.
        **hub: Arguments of `huggingface_hub.hf_hub_download`.

    Raises:
        DexFlexError: If it is neither, or a file is missing.
    """
    folder = Path(source)
    if folder.is_dir():
        missing = [name for name in (CONFIG, WEIGHTS) if not (folder / name).is_file()]
        if missing:
            raise DexFlexError(
                f"{folder} is not a controller's folder: it lacks {', '.join(missing)}. "
                "Train one with `dexflex-train`, or name a folder written by `save_pretrained`."
            )
        record = folder / RECORD
        return Files(folder / CONFIG, folder / WEIGHTS, record if record.is_file() else None)
    try:
        config, weights = (Path(hf_hub_download(str(source), name, **hub)) for name in (CONFIG, WEIGHTS))
    except (HfHubHTTPError, HFValidationError, OSError, ValueError) as error:
        raise DexFlexError(
            f"No controller at {str(source)!r}: there is no such folder, and the Hub says: {error}. "
            "Name a folder with config.json and model.safetensors, or a Hub repository 'user/controller'."
        ) from error
    try:
        return Files(config, weights, Path(hf_hub_download(str(source), RECORD, **hub)))
    except (EntryNotFoundError, OSError):
        return Files(config, weights, None)


def read_record(path: Path | None) -> dict[str, Any]:
    """Return how a controller was trained; empty if nobody wrote it down."""
    if path is None:
        return {}
    try:
        record = json.loads(path.read_text())
    except ValueError as error:
        raise DexFlexError(
            f"{path} is damaged ({error}). Copy the controller again, or delete it."
        ) from error
    if not isinstance(record, dict):
        raise DexFlexError(f"{path} is damaged: it holds no record. Copy the controller again, or delete it.")
    return record


def load_weights(module: nn.Module, path: Path) -> None:
    """Load weights that must fit exactly; warns if `config.json` beside them knows no checksum of theirs.

    Raises:
        DexFlexError: If the file is damaged, belongs to other networks or holds NaN or infinity.
    """
    _check_checksum(path)
    try:
        module.load_state_dict(load_file(path))
    except (SafetensorError, RuntimeError, OSError) as error:
        raise DexFlexError(
            f"{path} does not hold the weights of this controller: {error}. "
            "Download or train it again; its config.json must be the one written beside it."
        ) from error
    check_weights(module, str(path))


def save(module: nn.Module, config: ControllerConfig, record: dict[str, Any], folder: Path) -> None:
    """Write configuration, weights and training record."""
    config.save(folder / CONFIG)
    save_weights(module, folder / WEIGHTS)
    if record:
        (folder / RECORD).write_text(json.dumps(record, indent=2) + "\n")


def save_weights(module: nn.Module, path: Path) -> None:
    """Write weights into a folder with a `config.json`, and their checksum into the latter."""
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in module.state_dict().items()}
    save_file(tensors, path, metadata={"format": "pt"})
    config = path.parent / CONFIG
    values = json.loads(config.read_text())
    values[CHECKSUMS] = {**values.get(CHECKSUMS, {}), path.name: _checksum(path)}
    config.write_text(json.dumps(values, indent=2) + "\n")


def _check_checksum(path: Path) -> None:
    config = path.parent / CONFIG
    values = json.loads(config.read_text()) if config.is_file() else {}
    expected, found = values.get(CHECKSUMS, {}).get(path.name), _checksum(path)
    if expected is None:
        warnings.warn(
            f"{config} holds no checksum of {path.name}: damaged weights would not be noticed. Save the "
            f'controller again, or add "{CHECKSUMS}": {{"{path.name}": "{found}"}} to it.',
            stacklevel=3,
        )
    elif expected != found:
        raise DexFlexError(
            f"{path} is damaged or was exchanged: its checksum is {found}, but {config} says {expected}. "
            "Download or train the controller again."
        )


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
