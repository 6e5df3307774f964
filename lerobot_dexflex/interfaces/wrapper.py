"""What interfaces around another interface share."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.interfaces.explanation import Explanation
from lerobot_dexflex.interfaces.protocol import CommandSpace, Interface


class WrappedInterface[Inner: Interface]:
    """Passes everything to another interface; subclasses change what they are about. Satisfies `Interface`.

    Args:
        inner: The interface, as `inner`.
    """

    def __init__(self, inner: Inner) -> None:
        self.inner = inner
        self.hand = inner.hand
        self.name: str = inner.name
        self.command_space: CommandSpace = inner.command_space

    @property
    def motion(self) -> Tensor | None:
        """See `Interface.motion`."""
        return self.inner.motion

    @property
    def explanation(self) -> Explanation | None:
        """Why the inner interface did what it did in the last step; None if it does not tell."""
        return getattr(self.inner, "explanation", None)

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self.inner.reset(mask)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the inner interface's joint targets; see `Interface.step`."""
        return self.inner.step(observation, draft)
