"""What interfaces that wrap another one share."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.interfaces.explanation import Explanation
from lerobot_dexflex.interfaces.protocol import CommandSpace, Interface


class WrappedInterface:
    """Passes all to an interface. Satisfies `Interface`."""

    def __init__(self, inner: Interface) -> None:
        self.inner = inner
        self.name: str = inner.name
        self.command_space: CommandSpace = inner.command_space

    @property
    def command(self) -> Tensor | None:
        """Executed commanded fingertips [m]. Shape (batch, 4, 3)."""
        return self.inner.command

    @property
    def explanation(self) -> Explanation | None:
        """Why the interface did what it did in the last step, if it tells."""
        return getattr(self.inner, "explanation", None)

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self.inner.reset(mask)

    def start(self, observation: Mapping[str, Tensor], initial: Tensor | None = None) -> Tensor:
        """Return the commanded fingertips before this step [m], (batch, 4, 3); see `Interface.start`."""
        return self.inner.start(observation, initial)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the inner interface's joint targets; see `Interface.step`."""
        return self.inner.step(observation, draft)
