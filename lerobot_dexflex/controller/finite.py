"""Refuse networks that are broken: their numbers would move a hand, or silently be the raw draft."""

import torch
from torch import Tensor, nn

from lerobot_dexflex.errors import DexFlexError

_REMEDY = "Download the controller or train it again."


def check_output(part: str, output: Tensor) -> Tensor:
    """Return what a network put out.

    Args:
        part: The network, for the message.
        output: Any shape.

    Raises:
        DexFlexError: If it holds NaN or infinity.
    """
    if not torch.isfinite(output).all():
        raise DexFlexError(
            f"The controller's {part} put out NaN or infinity; nothing was executed. Its weights are damaged "
            f"or it was shown impossible values. {_REMEDY}"
        )
    return output


def check_weights(module: nn.Module, source: str) -> None:
    """Refuse weights that are no numbers.

    Args:
        module: The networks.
        source: Where the weights come from, for the message.

    Raises:
        DexFlexError: If one holds NaN or infinity.
    """
    broken = [name for name, value in module.state_dict().items() if not torch.isfinite(value).all()]
    if broken:
        more = f" and {len(broken) - 1} more" if len(broken) > 1 else ""
        raise DexFlexError(f"{source} holds NaN or infinity in {broken[0]}{more}. {_REMEDY}")
