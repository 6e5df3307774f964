"""How an interface changes drafts, looked at from outside."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.interfaces.protocol import Interface
from lerobot_dexflex.interfaces.wrapper import WrappedInterface


class ObservedInterface(WrappedInterface):
    """Passes all to an interface and keeps how it changed the last draft. Satisfies `Interface`.

    Args:
        inner: Any interface.
    """

    def __init__(self, inner: Interface) -> None:
        super().__init__(inner)
        self.change: Motion | None = None
        """None before the first step, and of joint targets."""

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self.change = None
        super().reset(mask)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the inner interface's joint targets; see `Interface.step`."""
        targets = self.inner.step(observation, draft)
        selected = self.inner.motion
        if self.command_space == "draft" and selected is not None:
            self.change = Motion(*(part.double().cpu().numpy() for part in (draft[:, 0], selected)))
        return targets
