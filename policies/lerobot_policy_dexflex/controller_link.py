"""Join a policy to the frozen controller of its interface, which it names but neither trains nor saves."""

import warnings
from typing import Protocol

from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.interfaces import Interface, Method
from lerobot_dexflex.runs.provenance import weights_digest


class LinkConfig(Protocol):
    """The fields of a configuration that name an interface and the hand that it serves."""

    hand: str
    interface: str
    controller: str
    controller_digest: str


def link_interface(config: LinkConfig) -> Interface:
    """Make the interface of a policy; notes the controller's content hash in the configuration.

    Warns if the checkpoint was saved with a controller of other content under the same interface.

    Raises:
        DexFlexError: If the interface needs a controller and there is none.
    """
    interface, change = open_interface(config)
    if change:
        warnings.warn(
            f"{change}: its results will differ. Name the original with --policy.controller=<folder or hub "
            "id>, or accept this one with --policy.controller_digest=",
            stacklevel=2,
        )
    return interface


def open_interface(config: LinkConfig) -> tuple[Interface, str]:
    """Make the interface that a configuration names; notes its controller's content hash there.

    Returns:
        The interface, and how its controller differs from the one that was noted before; empty if it does
        not, or none was noted under this interface.

    Raises:
        DexFlexError: If there is no such interface, or it needs a controller and there is none.
    """
    method, hand = Method.parse(config.interface), get_hand(config.hand)
    if not method.learned:
        return method.make(hand), ""
    weights = method.weights(hand, config.controller)
    folder, found, saved = (
        weights[0].parent,
        f"{method.base}:{weights_digest(weights)}",
        config.controller_digest,
    )
    change = ""
    if saved.startswith(f"{method.base}:") and saved != found:
        change = f"The controller {folder} ({found}) is not the one that this policy was saved with ({saved})"
    config.controller_digest = found
    return method.make(hand, folder), change
