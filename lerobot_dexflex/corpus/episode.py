"""One running episode: executes displacements of the commanded tips and records every control step."""

from dataclasses import asdict
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.schema import COLUMNS, FAILED, SNAPSHOT_COLUMNS, SNAPSHOT_INTERVAL
from lerobot_dexflex.corpus.shard import Shard
from lerobot_dexflex.corpus.world import World
from lerobot_dexflex.envs.hand_env import Snapshot
from lerobot_dexflex.envs.reach import DROP_DISTANCE, GOAL_RADIUS, ReachEpisode
from lerobot_dexflex.experts.reach.sensing import HandState, Senses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE

Array = NDArray[np.float64]

_LEFT = DROP_DISTANCE + GOAL_RADIUS
"""The object has left the hand this far from where the episode began [m]."""


class Leader(Protocol):
    """Who knows what to do: an operator, a script."""

    def label(self, run: "RunningEpisode") -> Array | None:
        """Return the clean displacement of the commanded tips [m] (4, 3), or None to end the episode.

        Called exactly once per control step.
        """
        ...


class Bookmark(NamedTuple):
    """Where an episode can go back to."""

    snapshot: Snapshot
    rows: int
    command: Array
    observation: dict[str, Any]
    now: HandState
    lost_steps: int


class RunningEpisode:
    """Execute and record one episode.

    Commands and displacements are kept in float32 precision, as they are stored, so that a replay of stored
    chunks is exact.

    Args:
        env: Where it runs.
        episode: Object, gravity and grasp.
        world: Servos, sensors and disturbances.
        kind: Index into `schema.KINDS`.
        facts: What else the metadata shall say.
    """

    def __init__(
        self, env: CorpusEnv, episode: ReachEpisode, world: World, kind: int, facts: dict[str, Any]
    ) -> None:
        self.env, self.kind, self.facts = env, kind, facts
        self.observation = env.start(episode, world)
        self.senses = Senses(env)
        self.now: HandState = self.senses.read()
        self.command = stored(kernels.fingertips(self.env.command))
        self.lost_steps = 0
        self._rows: list[tuple[Any, ...]] = []
        self._snapshots: list[tuple[int, Array, Array]] = []

    @property
    def steps(self) -> int:
        """Control steps recorded so far."""
        return len(self._rows)

    def step(
        self, draft: Array, label: Array, executed: Array | None = None, joints: Array | None = None
    ) -> None:
        """Record the state and execute.

        Args:
            draft: What the operator asks for [m]. Shape (4, 3).
            label: What it should have asked for [m]. Shape (4, 3).
            executed: Displacement to execute [m]; None executes the label. Shape (4, 3).
            joints: Joint command of an interface [rad], whose commanded tips moved by `executed`; None
                solves for the tips.
        """
        env, before = self.env, self.env.command
        label = stored(label)
        executed = label if executed is None else stored(executed)
        command = stored(self.command + executed)
        if joints is None:
            joints = kernels.solve_fingertips(command, before)
        own = np.array_equal(executed, label)
        label_joints = joints if own else kernels.solve_fingertips(stored(self.command + label), before)
        if self.steps % SNAPSHOT_INTERVAL == 0:
            self._snapshots.append((self.steps, env.physics_state(), before))
        seen = self.observation
        row = (
            seen["agent_pos"],
            seen["fingertips"].reshape(4, 3),
            seen["gravity"],
            seen["tactile"],
            self.command,
            draft,
            label,
            executed,
            joints,
            label_joints,
            self.now.loads,
            own,
        )
        supported = env.supported
        env.advance(joints)
        self.command, self.observation, self.now = command, env.observe(), self.senses.read()
        lost = not supported and is_lost(self.now, env.episode)
        self.lost_steps = self.lost_steps + 1 if lost else 0
        self._rows.append((*row, lost))

    def bookmark(self) -> Bookmark:
        """Remember the state before the next step."""
        state = self.env.snapshot()
        return Bookmark(state, self.steps, self.command, self.observation, self.now, self.lost_steps)

    def go_back(self, mark: Bookmark) -> None:
        """Return to a state of this episode and forget the steps after it."""
        self.env.restore(mark.snapshot)
        _, rows, self.command, self.observation, self.now, self.lost_steps = mark
        del self._rows[rows:]
        self._snapshots = [kept for kept in self._snapshots if kept[0] < rows]

    def finish(self) -> Shard:
        """Return the recorded episode."""
        return self._excerpt(0, self.kind)

    def failure(self, first: int) -> Shard:
        """Return the steps from row `first` on as a failed branch, nobody's expert."""
        failed = self._excerpt(first, FAILED)
        failed.tensors["expert"][:] = False
        return failed

    def _excerpt(self, first: int, kind: int) -> Shard:
        columns = [np.array(values) for values in zip(*self._rows[first:], strict=True)]
        rows = self.steps - first
        columns += [np.arange(rows), np.zeros(rows), np.full(rows, kind)]
        tensors = dict(zip(COLUMNS, columns, strict=True))
        snapshots = [(row - first, *state) for row, *state in self._snapshots if row >= first]
        kept = [np.array(values) for values in zip(*snapshots, strict=True)]
        tensors |= dict(zip(SNAPSHOT_COLUMNS, kept, strict=True))
        types = {**COLUMNS, **SNAPSHOT_COLUMNS}
        metadata = {
            "kind": kind,
            "rows": rows,
            "clock": first,
            "episode": asdict(self.env.episode),
            "world": self.env.world.to_dict(),
            **self.facts,
        }
        return Shard({k: v.astype(types[k].dtype) for k, v in tensors.items()}, [metadata], {})


def is_lost(now: HandState, episode: ReachEpisode) -> bool:
    """Say whether fewer than two tips are loaded or the object left the hand."""
    away = float(np.linalg.norm(now.position - np.array(episode.position)))
    return bool((now.loads > CONTACT_FORCE).sum() < 2 or away > _LEFT)


def stored(values: Array) -> Array:
    """Round to what a shard keeps."""
    return values.astype(np.float32).astype(np.float64)
