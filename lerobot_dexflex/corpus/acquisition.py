"""Kind 1: take an object from a fixture, carry it for a while, give it back and let go.

The grasp is known to hold; the script finds a way to it. The fixture is the scene's weld: it carries the
object until all fingers squeeze, and again while they open. What fingers shall press follows from what can
be observed: a finger presses from its first touch on, or once it has come to rest while another touches; it
stops when its plan leads away.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.goal_follower import GoalFollower
from lerobot_dexflex.corpus.world import Support, World
from lerobot_dexflex.envs.reach import DROP_STEPS, ReachEpisode
from lerobot_dexflex.experts.command import min_jerk
from lerobot_dexflex.experts.reach.balance import balance_forces
from lerobot_dexflex.experts.reach.operator import LEAST_FORCE, PRELOAD, Guidance, Operator
from lerobot_dexflex.experts.reach.sensing import Senses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE, gripping_joints

Array = NDArray[np.float64]

_OPENING = (0.02, 0.04)
_NEAR = 0.006
_RETREAT_INCREMENTS = 12
_ATTEMPTS = 4
_OVERLAP = 0.0005
_TOUCHED = 2 * CONTACT_FORCE
_CLOSE_STEPS, _RELEASE_STEPS = 36, 3
"""Longest duration of closing, and the steps in which a finger's force goes."""
_DEPTH = (-0.0015, 0.004)
"""How deep the ways in lead into the object [m]: fingers stop where they touch, or just before."""
_MAX_STEP = 0.006
"""Longest motion per control step [m]."""
_SOFTNESS = (0.01, 0.06)


class Opening(NamedTuple):
    """An open hand before a grasp, and the way in. Frames: palm."""

    joints: Array
    """Joint posture of the open hand [rad]. Shape (joints,)."""
    near: Array
    """Tips just before the object [m]. Shape (fingers, 3)."""
    closed: Array
    """Tips that hold the object [m]. Shape (fingers, 3)."""
    inward: Array
    """Contact normals of the grasp into the object; zero for others than `active`. Shape (fingers, 3)."""

    @property
    def active(self) -> NDArray[np.bool_]:
        """Which fingers grasp. Shape (fingers,)."""
        return np.abs(self.inward).max(1) > 0


def find_opening(env: CorpusEnv, episode: ReachEpisode, rng: np.random.Generator) -> Opening | None:
    """Retreat from a grasp along the contact normals; None if the fingers would be in the way.

    Args:
        env: Where to look; it is started anew.
        episode: A grasp that holds.
        rng: Source of randomness, for the width.
    """
    env.start(episode, World())
    hand, now = env.hand, Senses(env).read()
    width = rng.uniform(*_OPENING, hand.n_fingers)
    for _ in range(_ATTEMPTS):
        joints = now.joints
        for share in np.linspace(0, 1, _RETREAT_INCREMENTS + 1)[1:]:
            targets = now.tips - share * width[:, None] * now.inward
            joints = kernels.solve_fingertips(hand.tables, targets, joints)
        env.data.qpos[: hand.n_joints] = joints
        mujoco.mj_forward(env.model, env.data)
        if env.data.ncon == 0 or env.data.contact.dist.min() > -_OVERLAP:
            inward = now.inward * (now.loads > CONTACT_FORCE)[:, None]
            return Opening(joints, now.tips - _NEAR * inward, now.tips, inward)
        width *= 0.75
    return None


def open_episode(
    episode: ReachEpisode, world: World, opening: Opening, rng: np.random.Generator
) -> ReachEpisode:
    """Return the episode that begins with an open hand; the object's fixture is added to the world."""
    softness = float(rng.uniform(*_SOFTNESS))
    world.supports.append(Support(0, None, episode.position, episode.quaternion, softness))
    joints = tuple(opening.joints.tolist())
    return replace(episode, hand_joints=joints, joint_targets=joints)


class Acquisition:
    """Approach, close, squeeze, carry, give back, let go, retreat; satisfies `Leader`.

    Subclasses do something else with what they have grasped.

    Args:
        opening: The way in.
        rng: Source of randomness: paces, pauses, how long to carry.
        strength: Factor of the executed squeeze.
    """

    APPROACH, CLOSE, SQUEEZE, LET_GO = (12, 26), (8, 18), (6, 14), (10, 24)
    """Control steps of these phases, the upper ends excluded."""
    LATE, DELAY = 6, (2, 12)
    """By how much later than the first the others may come, and leave [control steps]."""
    RAMP = 6
    """Steps in which a finger's force builds up."""

    def __init__(self, opening: Opening, rng: np.random.Generator, strength: float = 1.0) -> None:
        self._opening, self._rng, self._strength = opening, rng, strength
        self._fingers = len(opening.closed)
        self._phases: list[Callable[[RunningEpisode], Guidance | None]] = [
            self._approach,
            self._close,
            self._squeeze,
            self._carry,
            self._let_go,
        ]
        self._timer = 0
        self._start, self._target = np.zeros((2, self._fingers, 3))
        self._duration = 0
        self._delay = np.zeros(self._fingers, int)
        self._touched = np.zeros(self._fingers, bool)
        self._pressed = np.zeros(self._fingers)
        self._squeezed, self._held = np.zeros((2, self._fingers, 3))
        self._operator: Operator | None = None
        self._follower: GoalFollower | None = None

    def guide(self, run: RunningEpisode) -> Guidance | None:
        """Return the phase's guidance; None once all is over or the object is lost."""
        if run.lost_steps >= DROP_STEPS:
            return None
        while self._phases:
            guidance = self._phases[0](run)
            self._timer += 1
            if guidance is not None:
                return guidance
            self._phases.pop(0)
            self._timer = 0
        return None

    def _approach(self, run: RunningEpisode) -> Guidance | None:
        """Bring the pads in front of the object, one finger later than another."""
        if self._timer == 0:
            self._begin(run, self._opening.near, self.APPROACH)
            self._delay = self._rng.integers(0, self.LATE, self._fingers)
            self._touched, self._pressed = ~self._opening.active, np.zeros(self._fingers)
        if self._timer >= self._duration + self._delay.max():
            return None
        return self._on_the_way(run)

    def _close(self, run: RunningEpisode) -> Guidance | None:
        """Move every finger on until it touches; it presses while the others come."""
        active, inward = self._opening.active, self._opening.inward
        if self._timer == 0:
            depth = self._rng.uniform(*_DEPTH, (self._fingers, 1))
            self._begin(run, self._opening.closed + depth * inward, self.CLOSE)
            self._squeezed[active], _ = balance_forces(
                self._opening.closed[active],
                inward[active],
                run.now.position,
                np.zeros(6),
                run.senses.friction,
                PRELOAD,
                LEAST_FORCE,
            )
        self._touched |= run.now.loads > _TOUCHED
        arrived = self._timer >= self._duration + self._delay
        pressing = active & (self._touched | (arrived & (run.now.loads > _TOUCHED).any()))
        self._pressed += pressing
        if (self._pressed[active] > self.RAMP).all() or self._timer >= _CLOSE_STEPS:
            return None
        forces = np.minimum(1.0, self._pressed / self.RAMP)[:, None] * self._squeezed
        return self._on_the_way(run, waiting=self._touched, forces=forces)

    def _squeeze(self, run: RunningEpisode) -> Guidance | None:
        """Balance the forces that hold the object, the fixture still carrying it."""
        if self._timer == 0:
            self._operator = Operator(run.senses, self._rng, self._strength)
            self._operator.expect(self._opening.inward, run.now)
            self._duration = int(self._rng.integers(*self.SQUEEZE))
        assert self._operator is not None
        return None if self._timer >= self._duration else self._operator.guide(run.now)

    def _carry(self, run: RunningEpisode) -> Guidance | None:
        """Take the object from the fixture and lead it to goals."""
        if self._timer == 0:
            run.env.world.supports[-1].stop = run.env.clock
            steps = int(self._rng.integers(15, 60))
            self._follower = GoalFollower(run, self._rng, steps, self._strength)
            self._operator = self._follower.operator
        assert self._follower is not None
        return self._follower.guide(run)

    def _let_go(self, run: RunningEpisode) -> Guidance | None:
        """Give the object back and take the pads away, one later than another."""
        if self._timer == 0:
            self._give_back(run)
            assert self._operator is not None
            self._held = self._operator.guide(run.now).forces
            away = self._rng.uniform(*_OPENING, (self._fingers, 1)) * run.now.inward
            self._begin(run, run.now.tips - away, self.LET_GO)
            self._delay = self._rng.integers(*self.DELAY, self._fingers)
        if self._timer >= self._duration + self._delay.max():
            return None
        share = np.clip((self._delay - self._timer) / _RELEASE_STEPS, 0, 1)[:, None]
        return self._on_the_way(run, forces=share * self._held)

    def _give_back(self, run: RunningEpisode) -> None:
        """Let a fixture carry the object where it is."""
        softness = float(self._rng.uniform(*_SOFTNESS))
        pose = tuple(run.now.position.tolist()), tuple(run.now.quaternion.tolist())
        run.env.world.supports.append(Support(run.env.clock, None, *pose, softness))

    def _begin(self, run: RunningEpisode, target: Array, steps: tuple[int, int]) -> None:
        self._start, self._target = run.now.tips.copy(), target
        self._duration = int(self._rng.integers(*steps))

    def _on_the_way(
        self,
        run: RunningEpisode,
        waiting: NDArray[np.bool_] | None = None,
        forces: Array | None = None,
    ) -> Guidance:
        """Return guidance along the minimum-jerk way from start to target.

        Args:
            run: The episode.
            waiting: Fingers that stay where they are. Shape (fingers,).
            forces: What the fingers should press [N], none by default. Shape (fingers, 3).
        """
        tips = np.empty((DRAFT_HORIZON, self._fingers, 3))
        place = run.now.tips
        for ahead in range(DRAFT_HORIZON):
            phase = np.clip((self._timer + 1 + ahead - self._delay) / self._duration, 0, 1)
            share = np.array([min_jerk(float(p)) for p in phase])[:, None]
            way = self._start + share * (self._target - self._start) - place
            length = np.linalg.norm(way, axis=1, keepdims=True)
            place = place + way * np.minimum(1.0, _MAX_STEP / np.maximum(length, 1e-9))
            tips[ahead] = place
        if waiting is not None:
            tips[:, waiting] = run.now.tips[waiting]
        forces = np.zeros((self._fingers, 3)) if forces is None else forces
        return _guidance(run, tips, forces, self._strength * forces)


def _guidance(run: RunningEpisode, tips: Array, forces: Array, grip: Array) -> Guidance:
    """Return guidance with the joint targets that bring the tips somewhere and press."""
    hand, now = run.hand, run.now
    pressing = np.abs(grip).max(1) > 0
    # A free finger goes on from its command, so that it arrives; one that presses must not wind up.
    begin = np.where(pressing[hand.finger_of_joint], now.joints, run.env.command)
    posture = kernels.solve_fingertips(hand.tables, tips[0], begin)
    joints = gripping_joints(hand, posture, now.joints, now.points, grip)
    return Guidance(tips, forces, grip, now.points, joints)
