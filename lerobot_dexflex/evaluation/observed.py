"""How an interface changes drafts, looked at from outside."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.interfaces.protocol import Interface
from lerobot_dexflex.interfaces.wrapper import WrappedInterface


class ObservedInterface(WrappedInterface):
    """Passes all to an interface and remembers how it changed the last draft. Satisfies `Interface`."""

    def __init__(self, inner: Interface) -> None:
        super().__init__(inner)
        self.motion: Motion | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self.motion = None
        super().reset(mask)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the inner interface's joint targets; see `Interface.step`."""
        before = self.inner.start(observation)
        targets = self.inner.step(observation, draft)
        command = self.inner.command
        if self.command_space == "draft" and command is not None:
            parts = (draft[:, 0], command - before, command)
            self.motion = Motion(*(part.double().cpu().numpy() for part in parts))
        return targets
