"""Execute a share of what another interface would execute.

Shrinking alone lowers the gain of the operator's loop and wins against noise and delay. Whoever compares a
learned interface with `shrink` must therefore give it the same chance.
"""

import dataclasses
from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface
from lerobot_dexflex.interfaces.explanation import Explanation, relative_change
from lerobot_dexflex.interfaces.protocol import CommandSpace, Interface
from lerobot_dexflex.interfaces.raw import RawInterface


class GainInterface:
    """Displace the commanded fingertips by `gain` times what another interface would. Satisfies `Interface`.

    The joints are solved anew for the fingertips that result, corrections of the joints included, and the
    inner interface is told what was executed.

    Args:
        inner: An interface whose drafts are displacements.
        gain: Share of its displacement that is executed, in (0, 1].

    Raises:
        DexFlexError: If the gain is outside or `inner` takes joint targets.
    """

    command_space: CommandSpace = "draft"

    def __init__(self, inner: Interface, gain: float) -> None:
        if not 0 < gain <= 1:
            raise DexFlexError(f"`gain` must be in (0, 1]; 0 is the interface 'hold'. Got {gain}.")
        if inner.command_space != "draft":
            raise DexFlexError(f"Only displacements can be scaled; {inner.name!r} executes joint targets.")
        self.name = f"{inner.name}@{gain:g}"
        self._inner, self._gain, self._raw = inner, gain, RawInterface()
        self._explanation: Explanation | None = None

    @property
    def command(self) -> Tensor | None:
        """Executed commanded fingertips [m]. Shape (batch, 4, 3)."""
        return self._raw.command

    @property
    def explanation(self) -> Explanation | None:
        """The inner interface's, with the intervention that was executed; None if it gives none."""
        return self._explanation

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self._inner.reset(mask)
        self._raw.reset(mask)

    def start(self, observation: Mapping[str, Tensor], initial: Tensor | None = None) -> Tensor:
        """Return the commanded fingertips before this step [m], (batch, 4, 3); see `Interface.start`."""
        self._inner.start(observation, initial)
        return self._raw.start(observation, initial)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the scaled displacement; see `Interface.step`."""
        before = self._inner.start(observation)
        targets = self._inner.step(observation, draft)
        after = self._inner.command
        assert after is not None
        displacement = self._gain * (after - before)
        joints = self._raw.move(observation, displacement)
        command = self._raw.command
        assert command is not None
        if isinstance(self._inner, CommandedInterface):
            self._inner.follow(joints, command)
        inner: Explanation | None = getattr(self._inner, "explanation", None)
        if inner is not None:
            change = relative_change(displacement, draft[:, 0].to(displacement))
            inner = dataclasses.replace(inner, intervention=change)
        self._explanation = inner
        return joints.to(targets.dtype)
