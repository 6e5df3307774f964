"""Who leads the hand: a person's stream, or the task's expert in a person's place."""

from collections.abc import Callable, Iterator
from typing import Protocol

import gymnasium
import numpy as np

from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.command import Command

Say = Callable[[str], None]
"""Tells the operator something."""


class Leader(Protocol):
    """Says what the robot should do."""

    @property
    def ready(self) -> bool:
        """Whether an episode may begin."""
        ...

    @property
    def over(self) -> bool:
        """Whether nothing more can come, in any episode."""
        ...

    def begin(self, env: gymnasium.Env, index: int) -> None:
        """Go on in an environment that has just been reset, for attempt `index`."""
        ...

    def tick(self, now: float) -> None:
        """Look at what is new; called at 50 Hz with the caller's clock [s]."""
        ...

    def command(self) -> Command | None:
        """Return what to do in this control step; None if there is nothing more in this episode."""
        ...

    def toggle(self) -> None:
        """Take the hand, or release it."""
        ...

    def calibrate(self) -> None:
        """Begin again with the person's open hand."""
        ...


class ExpertLeader:
    """The task's privileged expert, as in `dexflex-record`: attempt k is the same. Satisfies `Leader`.

    Args:
        task: Name in `TASKS`.
        seed: Of the recording.

    Raises:
        DexFlexError: If the task has no expert.
    """

    ready, over = True, False

    def __init__(self, task: str, seed: int) -> None:
        self._expert, self._seed = make_expert(task), seed
        self._commands: Iterator[Command] = iter(())

    def begin(self, env: gymnasium.Env, index: int) -> None:
        """See `Leader.begin`."""
        self._commands = self._expert(env.unwrapped, np.random.default_rng((self._seed, index)))

    def tick(self, now: float) -> None:
        """See `Leader.tick`; an expert looks at the simulator, once per control step."""

    def command(self) -> Command | None:
        """See `Leader.command`."""
        return next(self._commands, None)

    def toggle(self) -> None:
        """See `Leader.toggle`; an expert does not let go."""

    def calibrate(self) -> None:
        """See `Leader.calibrate`; an expert has no hand."""
