"""Load a policy's weights, all of them or none."""

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn

from lerobot_dexflex.errors import DexFlexError


def load_weights(policy: nn.Module, file: Path) -> None:
    """Load the weights of a checkpoint into a policy of the same configuration.

    Raises:
        DexFlexError: If the file is missing or damaged, holds weights of another network, or numbers that are
            not finite.
    """
    try:
        weights = load_file(file)
        policy.load_state_dict(weights)
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
