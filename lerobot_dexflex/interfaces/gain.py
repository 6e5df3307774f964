"""Execute a share of what another interface would execute.

Shrinking alone lowers the gain of the operator's loop and wins against noise and delay. Whoever compares a
learned interface with `shrink` must therefore give it the same chance.
"""

import dataclasses
from collections.abc import Mapping
from typing import Protocol

from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.explanation import Explanation, relative_change
from lerobot_dexflex.interfaces.protocol import Interface
from lerobot_dexflex.interfaces.wrapper import WrappedInterface


class Movable(Interface, Protocol):
    """An interface that can be told what it should have executed, as every `CommandedInterface` can."""

    def move_instead(self, observation: Mapping[str, Tensor], displacement: Tensor) -> Tensor:
        """See `CommandedInterface.move_instead`."""
        ...


class GainInterface(WrappedInterface[Movable]):
    """Displace the commanded fingertips by `gain` times what another interface would. Satisfies `Interface`.

    The joints are solved anew for the fingertips that result, corrections of the joints included, and the
    inner interface goes on from what was executed.

    Args:
        inner: An interface whose drafts are displacements.
        gain: Share of its displacement that is executed, in (0, 1].

    Raises:
        DexFlexError: If the gain is outside or `inner` takes joint targets.
    """

    def __init__(self, inner: Movable, gain: float) -> None:
        if not 0 < gain <= 1:
            raise DexFlexError(f"`gain` must be in (0, 1]; 0 is the interface 'hold'. Got {gain}.")
        if inner.command_space != "draft":
            raise DexFlexError(f"Only displacements can be scaled; {inner.name!r} executes joint targets.")
        super().__init__(inner)
        self.name = f"{inner.name}@{gain:g}"
        self._gain = gain
        self._explanation: Explanation | None = None

    @property
    def explanation(self) -> Explanation | None:
        """The inner interface's, with the intervention that was executed; None if it gives none."""
        return self._explanation

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the scaled displacement; see `Interface.step`."""
        before = self.inner.start(observation)
        targets = self.inner.step(observation, draft)
        after = self.inner.command
        assert after is not None
        displacement = self._gain * (after - before)
        joints = self.inner.move_instead(observation, displacement)
        inner: Explanation | None = getattr(self.inner, "explanation", None)
        if inner is not None:
            executed = self.inner.command
            assert executed is not None
            change = relative_change(executed - before, draft[:, 0].to(displacement))
            inner = dataclasses.replace(inner, intervention=change)
        self._explanation = inner
        return joints.to(targets.dtype)
