"""Kind 2: take an object from a fixture, carry it for a while, give it back and let go.

The grasp is known to hold; the script finds a way to it. The fixture is the scene's weld: it carries the
object until all fingers squeeze, and again before they open.
"""

from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.goal_follower import GoalFollower
from lerobot_dexflex.corpus.world import Support, World
from lerobot_dexflex.envs.reach import DROP_STEPS, ReachEpisode
from lerobot_dexflex.experts.command import min_jerk
from lerobot_dexflex.experts.reach.sensing import Senses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE

Array = NDArray[np.float64]

_OPENING = (0.02, 0.04)
_NEAR = 0.006
_RETREAT_INCREMENTS = 12
_ATTEMPTS = 4
_OVERLAP = 0.0005
_TOUCHED = 2 * CONTACT_FORCE
_CLOSE_STEPS = 25
_FIRM_SHARE, _PRESS, _PRESS_STEPS = 0.8, 0.0005, 16
"""Fingers press on in such steps [m] until they carry this share of the grasp's forces, or so many steps."""
_MAX_STEP = 0.006
"""Longest displacement per control step [m]."""
_SOFTNESS = (0.01, 0.06)


class Opening(NamedTuple):
    """An open hand before a grasp, and the way in. Frames: palm."""

    joints: Array
    """Joint posture of the open hand [rad]. Shape (16,)."""
    near: Array
    """Commanded tips just before the object [m]. Shape (4, 3)."""
    closed: Array
    """Commanded tips that hold the object [m]. Shape (4, 3)."""
    loads: Array
    """Normal forces of the grasp [N]; zero for fingers that take no part. Shape (4,)."""
    inward: Array
    """Contact normals of the grasp into the object; zero for fingers that take no part. Shape (4, 3)."""

    @property
    def active(self) -> NDArray[np.bool_]:
        """Which fingers grasp. Shape (4,)."""
        return self.loads > 0


def find_opening(env: CorpusEnv, episode: ReachEpisode, rng: np.random.Generator) -> Opening | None:
    """Retreat from a grasp along the contact normals; None if the fingers would be in the way.

    Args:
        env: Where to look; it is started anew.
        episode: A grasp that holds.
        rng: Source of randomness, for the width.
    """
    env.start(episode, World())
    now = Senses(env).read()
    width = rng.uniform(*_OPENING, 4)
    closed = kernels.fingertips(env.command)
    for _ in range(_ATTEMPTS):
        joints = now.joints
        for share in np.linspace(0, 1, _RETREAT_INCREMENTS + 1)[1:]:
            targets = now.tips - share * width[:, None] * now.inward
            joints = kernels.solve_fingertips(targets, joints)
        env.data.qpos[:16] = joints
        mujoco.mj_forward(env.model, env.data)
        if env.data.ncon == 0 or env.data.contact.dist.min() > -_OVERLAP:
            loads = np.where(now.loads > CONTACT_FORCE, now.loads, 0.0)
            return Opening(joints, now.tips - _NEAR * now.inward, closed, loads, now.inward)
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

    Args:
        opening: The way in.
        rng: Source of randomness: paces, pauses, how long to carry.
    """

    def __init__(self, opening: Opening, rng: np.random.Generator) -> None:
        self._opening, self._rng = opening, rng
        self._phases = [self._approach, self._close, self._squeeze, self._carry, self._let_go, self._retreat]
        self._timer = 0
        self._start, self._target, self._inward = np.zeros((3, 4, 3))
        self._duration = self._pause = 0
        self._delay = rng.integers(0, 6, 4)
        self._touched = ~opening.active
        self._extra = np.zeros(4)
        self._follower: GoalFollower | None = None

    def label(self, run: RunningEpisode) -> Array | None:
        """Return the displacement toward the phase's next waypoint; None once it is over or lost."""
        if run.lost_steps >= DROP_STEPS:
            return None
        while self._phases:
            label = self._phases[0](run)
            self._timer += 1
            if label is not None:
                return label
            self._phases.pop(0)
            self._timer = 0
        return None

    def _approach(self, run: RunningEpisode) -> Array | None:
        """Bring the pads in front of the object, one finger later than another."""
        if self._timer == 0:
            self._start, self._duration = run.command, int(self._rng.integers(12, 26))
        if self._timer >= self._duration + self._delay.max():
            return None
        return _toward(run, self._way(run.command, self._opening.near, self._opening.active))

    def _close(self, run: RunningEpisode) -> Array | None:
        """Move every finger on until it touches."""
        if self._timer == 0:
            self._start, self._duration = run.command, int(self._rng.integers(6, 16))
        self._touched |= run.now.loads > _TOUCHED
        if self._touched.all() or self._timer >= _CLOSE_STEPS:
            return None
        share = min(1.0, (self._timer + 1) / self._duration)
        targets = self._start + share * (self._opening.closed - self._start)
        return _toward(run, np.where(self._touched[:, None], run.command, targets))

    def _squeeze(self, run: RunningEpisode) -> Array | None:
        """Build up the forces that hold the object, pressing further where the pad is not loaded enough."""
        if self._timer == 0:
            self._start, self._duration = run.command, int(self._rng.integers(4, 11))
            self._delay, self._pause = np.zeros(4, int), int(self._rng.integers(2, 6))
        weak = run.now.loads < _FIRM_SHARE * self._opening.loads
        patience = _PRESS_STEPS if weak.any() else self._pause
        if self._timer >= self._duration + patience:
            return None
        if self._timer >= self._duration:
            self._extra += _PRESS * weak
        target = self._opening.closed + self._extra[:, None] * self._opening.inward
        return _toward(run, self._way(run.command, target, self._opening.active))

    def _carry(self, run: RunningEpisode) -> Array | None:
        """Take the object from the fixture and lead it to goals."""
        if self._timer == 0:
            run.env.world.supports[-1].stop = run.env.clock
            self._follower = GoalFollower(run, self._rng, int(self._rng.integers(15, 60)))
        assert self._follower is not None
        return self._follower.label(run)

    def _let_go(self, run: RunningEpisode) -> Array | None:
        """Give the object back to a fixture where it is and take the squeeze away."""
        if self._timer == 0:
            softness = float(self._rng.uniform(*_SOFTNESS))
            pose = tuple(run.now.position.tolist()), tuple(run.now.quaternion.tolist())
            run.env.world.supports.append(Support(run.env.clock, None, *pose, softness))
            self._duration, self._pause = int(self._rng.integers(4, 10)), int(self._rng.integers(0, 4))
        elapsed = self._timer - self._pause
        if elapsed < 0:
            return np.zeros((4, 3))
        if elapsed == 0:
            self._start, self._inward = run.command, run.now.inward
            self._target = run.now.tips
        if elapsed >= self._duration:
            return None
        share = (elapsed + 1) / self._duration
        return _toward(run, self._start + share * (self._target - self._start))

    def _retreat(self, run: RunningEpisode) -> Array | None:
        """Move the pads away from the object."""
        if self._timer == 0:
            self._start, self._duration = run.command, int(self._rng.integers(10, 24))
            self._delay = self._rng.integers(0, 5, 4)
            self._target = self._start - self._rng.uniform(*_OPENING, (4, 1)) * self._inward
        if self._timer >= self._duration + self._delay.max():
            return None
        return _toward(run, self._way(run.command, self._target, np.abs(self._inward).max(1) > 0))

    def _way(self, command: Array, target: Array, active: NDArray[np.bool_]) -> Array:
        """Return the minimum-jerk waypoints between start and target; idle fingers stay."""
        phase = np.clip((self._timer + 1 - self._delay) / self._duration, 0, 1)
        share = np.array([min_jerk(float(p)) for p in phase])[:, None]
        return np.where(active[:, None], self._start + share * (target - self._start), command)


def _toward(run: RunningEpisode, targets: Array) -> Array:
    """Return the displacement from the commanded tips to targets, shortened to a human pace."""
    way = targets - run.command
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return way * np.minimum(1.0, _MAX_STEP / np.maximum(length, 1e-9))
