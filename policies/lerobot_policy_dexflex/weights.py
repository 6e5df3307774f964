"""Load a policy's weights, all of them or none; a released checkpoint holds their running average only."""

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from lerobot_dexflex.errors import DexFlexError

TRAINED, AVERAGE = "network.", "average."
"""How the names begin: of the weights that are trained, and of their running average."""


def without_trained(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the weights without those that only a resumed training needs."""
    return {name: value for name, value in weights.items() if not name.startswith(TRAINED)}


def load_weights(policy: nn.Module, file: Path) -> None:
    """Load the weights of a checkpoint into a policy of the same configuration.

    Where a file holds none of the trained weights, they are those of the running average.

    Raises:
        DexFlexError: If the file is missing or damaged, holds weights of another network, or numbers that are
            not finite.
    """
    try:
        weights = load_file(file)
        policy.load_state_dict(_with_trained(weights))
    except (OSError, RuntimeError, SafetensorError) as error:
        raise DexFlexError(
            f"The weights {file} cannot be loaded: {error}. Copy the checkpoint again if the file is "
            "damaged; leave --policy.learns and the network's settings, e.g. --policy.dim, as they were."
        ) from error
    broken = [name for name, value in weights.items() if not torch.isfinite(value).all()]
    if broken:
        raise DexFlexError(
            f"The weights {file} hold numbers that are not finite, in {', '.join(broken[:3])}. "
            "Copy the checkpoint again, or load an earlier one of the same training."
        )


def _with_trained(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    if any(name.startswith(TRAINED) for name in weights):
        return weights
    averages = {name: value for name, value in weights.items() if name.startswith(AVERAGE)}
    return weights | {TRAINED + name.removeprefix(AVERAGE): value for name, value in averages.items()}
