"""One running episode: executes what it is told and records every control step."""

from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.corpus.distortion import Distortion, UnsteadyGrip
from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.schema import SNAPSHOT_INTERVAL, columns, snapshot_columns
from lerobot_dexflex.corpus.shard import Shard
from lerobot_dexflex.corpus.world import World
from lerobot_dexflex.envs.reach import DROP_DISTANCE, GOAL_RADIUS, ReachEpisode
from lerobot_dexflex.experts.reach.operator import Guidance
from lerobot_dexflex.experts.reach.sensing import HandState, Senses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE, gripping_joints

Array = NDArray[np.float64]

_LEFT = DROP_DISTANCE + GOAL_RADIUS
"""The object has left the hand this far from where the episode began [m]."""


class Leader(Protocol):
    """Who knows what to do: an operator, a script."""

    def guide(self, run: "RunningEpisode") -> Guidance | None:
        """Return what to do in the state now, or None to end the episode.

        Called exactly once per control step.
        """
        ...


class RunningEpisode:
    """Execute and record one episode.

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
        self.env, self.hand, self.kind, self.facts = env, env.hand, kind, facts
        self.observation = env.start(episode, world)
        self.senses = Senses(env)
        self.now: HandState = self.senses.read()
        self.lost_steps = 0
        self._rows: list[tuple[Any, ...]] = []
        self._snapshots: list[tuple[int, Array, Array]] = []

    @property
    def steps(self) -> int:
        """Control steps recorded so far."""
        return len(self._rows)

    def run(self, leader: Leader, distortion: Distortion, grip: UnsteadyGrip | None = None) -> None:
        """Let a leader lead to the end: its own command is executed, or its draft, spoilt, by turns.

        Args:
            leader: Knows what to do.
            distortion: Spoils the drafts.
            grip: Errors of the executed forces; none if None.
        """
        while (guidance := leader.guide(self)) is not None:
            draft, spoilt = distortion.step(guidance.tips - self.now.tips, self.now)
            self.step(guidance, draft, spoilt, None if grip is None else grip.step(guidance.grip))

    def step(self, guidance: Guidance, draft: Array, spoilt: bool, error: Array | None = None) -> None:
        """Record the state and execute.

        Args:
            guidance: What the leader wants in this state.
            draft: What is left of its plan [m]. Shape (8, fingers, 3).
            spoilt: Whether the draft is executed, with the leader's grip; else the leader's own command.
            error: What is added to the executed forces [N]. Shape (fingers, 3).
        """
        env, now, seen = self.env, self.now, self.observation
        joints = self._follow(guidance, draft[0]) if spoilt else guidance.joints
        if error is not None:
            joints = gripping_joints(self.hand, joints, now.joints, guidance.points, error)
        joints = joints.astype(np.float32)  # As recorded, so that it can be replayed.
        if self.steps % SNAPSHOT_INTERVAL == 0:
            self._snapshots.append((self.steps, env.physics_state(), env.command))
        wanted = now.tips + draft[0] if spoilt else guidance.tips[0]
        row = (
            seen["agent_pos"],
            seen["fingertips"].reshape(-1, 3),
            seen["gravity"],
            seen["tactile"],
            draft,
            guidance.tips - now.tips,
            guidance.forces,
            wanted,
            joints,
            now.loads,
            np.concatenate([now.position, now.quaternion]),
            not spoilt,
        )
        supported = env.supported
        env.advance(joints)
        self.observation, self.now = env.observe(), self.senses.read()
        lost = not supported and is_lost(self.now, env.episode)
        self.lost_steps = self.lost_steps + 1 if lost else 0
        self._rows.append((*row, lost))

    def _follow(self, guidance: Guidance, motion: Array) -> Array:
        """Return joint targets [rad] that move the tips [m] (fingers, 3) with the leader's grip."""
        now = self.now
        solved = kernels.solve_fingertips(self.hand.tables, now.tips + motion, now.joints)
        return gripping_joints(self.hand, solved, now.joints, guidance.points, guidance.grip)

    def finish(self) -> Shard:
        """Return the recorded episode."""
        types = columns(self.hand) | snapshot_columns(self.hand)
        found = [np.array(values) for values in zip(*self._rows, strict=True)]
        found += [np.arange(self.steps), np.zeros(self.steps), np.full(self.steps, self.kind)]
        found += [np.array(values) for values in zip(*self._snapshots, strict=True)]
        tensors = dict(zip(types, found, strict=True))
        metadata = {
            "kind": self.kind,
            "rows": self.steps,
            "episode": asdict(self.env.episode),
            "world": self.env.world.to_dict(),
            **self.facts,
        }
        typed = {key: value.astype(types[key].dtype) for key, value in tensors.items()}
        return Shard(self.hand, typed, [metadata], {})


def is_lost(now: HandState, episode: ReachEpisode) -> bool:
    """Say whether fewer than two tips are loaded or the object left the hand."""
    away = float(np.linalg.norm(now.position - np.array(episode.position)))
    return bool((now.loads > CONTACT_FORCE).sum() < 2 or away > _LEFT)
