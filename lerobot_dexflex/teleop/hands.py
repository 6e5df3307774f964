"""What executes a leader's commands: a glove, the errors of who wears it, and an action interface."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.glove import GlovedHand
from lerobot_dexflex.commands.source import Source
from lerobot_dexflex.evaluation.observed import ObservedInterface
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.protocol import Interface
from lerobot_dexflex.teleop.ik import straight_joints

_BACK, _FORWARD = -0.05, 0.15
"""A finger is bent forward if none of its last two joints is bent back farther than the first [rad], and both
together are bent forward by the second."""


class LedHand(GlovedHand):
    """A hand that a person leads. Until its fingers bend forward, joints of the inverse kinematics lead it.

    Interfaces solve for fingertips by themselves, from where the fingers are at their first step. From
    fingers that are straight, or bend back as the robot's relaxed ones do, some would close the wrong way.
    """

    def __init__(self, interface: Interface) -> None:
        super().__init__(interface, NO_ERRORS, 0)
        self.handed_over = False
        """Whether the interface has taken over."""

    def move(self, observation: Mapping[str, Any], command: Command) -> Command:
        """See `GlovedHand.move`."""
        measured = np.asarray(observation["agent_pos"], float)[-self._hand.n_joints :]
        self.handed_over |= bends_forward(self._hand, measured)
        return super().move(observation, command) if self.handed_over else command


def bends_forward(hand: Hand, joints: np.ndarray) -> bool:
    """Return whether all fingers that do not oppose bend forward, of hand joints [rad], shape (joints,)."""
    bends = [joints[finger] for finger in straight_joints(hand)]
    return all((bend > _BACK).all() and bend.sum() > _FORWARD for bend in bends)


class Hands:
    """Makes the hand of each attempt; a simulated person differs from attempt to attempt.

    Args:
        interface: Executes drafts, or joints.
        seed: Of the recording.
        errors: Of a simulated person; None for one who leads the hand himself.
        source: What a simulated person's drafts say.
    """

    def __init__(
        self,
        interface: Interface,
        seed: int = 0,
        errors: CommandErrors | None = None,
        source: Source = "motion",
    ) -> None:
        self._observed, self._seed, self._errors = ObservedInterface(interface), seed, errors
        self._source: Source = source

    def __call__(self, index: int) -> GlovedHand:
        """Return the hand of attempt `index`; a simulated person's is that of `dexflex-record`."""
        if self._errors is None:
            return LedHand(self._observed)
        return GlovedHand(self._observed, self._errors, (self._seed, index, 1), self._source)

    @property
    def motion(self) -> Motion | None:
        """How the interface changed the last draft, shapes (fingers, 3); None where there is none."""
        change = self._observed.change
        return None if change is None else change.row(0)
