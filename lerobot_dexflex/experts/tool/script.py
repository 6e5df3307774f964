"""Motion primitives of the operator: the arm moves the palm while the hand does what it was told."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.experts.command import Array, Command, Unsteadiness, min_jerk
from lerobot_dexflex.experts.tool.grip import Grip
from lerobot_dexflex.experts.tool.hand import OperatorHand
from lerobot_dexflex.hand.arm import N_ARM, ArmKinematics, arm_for, rotation_matrix, rotation_vector
from lerobot_dexflex.hands import PALM

PALM_DOWN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Orientation of the working frame over a table: the hand reaches down, its first finger is farthest away."""
_ARM_NOISE, _HAND_NOISE = 0.025, 0.002
"""Unsteadiness [rad]. On its way through the air the arm strays by centimetres, as learned policies do, so
that demonstrations show the way back (DART, Laskey et al. 2017)."""
_EASE = 0.08
"""Largest change of `Script.care` that takes effect in a step."""


class Pose(NamedTuple):
    """Where a body is."""

    position: Array
    """Origin [m]. Shape (3,)."""
    rotation: Array
    """Orientation. Shape (3, 3)."""


class Script:
    """Keeps track of where the palm has been commanded to, and moves it on; the hand goes its own way.

    Poses of the palm are those of its working frame, see `holds`.

    Args:
        env: The environment, unwrapped and just reset.
        hand: The operator's hand.
        rng: Source of the unsteadiness.
        grasp_centre: Point between the pads that every pose is about, working frame [m]. Shape (3,).
    """

    def __init__(
        self, env: HandEnv, hand: OperatorHand, rng: np.random.Generator, grasp_centre: Array
    ) -> None:
        self._env, self.hand = env, hand
        self.grasp_centre = grasp_centre
        self._arm = env.command[:N_ARM]
        self._kinematics = ArmKinematics(env.hand, hand.frame @ grasp_centre, self._arm)
        scale = np.repeat([_ARM_NOISE, _HAND_NOISE], [N_ARM, env.hand.n_joints])
        self._noise = Unsteadiness(rng, scale)
        self.care = self._share = 1.0
        """Share of the arm's unsteadiness; less of it where precision counts. It takes effect gradually."""
        self.position, rotation = self._kinematics.forward(self._arm)
        self.rotation = rotation @ hand.frame

    def in_palm(self, position: Array, rotation: Array) -> Pose:
        """Return a world pose in the measured working frame: how an object is held."""
        palm = self._env.data.body(PALM)
        palm_rotation = palm.xmat.reshape(3, 3) @ self.hand.frame
        return Pose(palm_rotation.T @ (position - palm.xpos), palm_rotation.T @ rotation)

    def palm_for(self, held: Pose, position: Array, rotation: Array) -> Pose:
        """Return the grasp point's position and palm orientation that bring a held object to a pose."""
        palm_rotation = rotation @ held.rotation.T
        return Pose(position + palm_rotation @ (self.grasp_centre - held.position), palm_rotation)

    def swing(self, position: Array, rotation: Array, steps: int, seed: ArrayLike) -> Iterator[Command]:
        """Interpolate the joints to a pose found from a planar seed: for large reorientations."""
        seed = arm_for(self._env.hand, seed)
        start, goal = self._arm, self._kinematics.reach(seed, position, rotation @ self.hand.frame.T)
        for k in range(1, steps + 1):
            self._arm = start + min_jerk(k / steps) * (goal - start)
            yield self._command()
        self._kinematics.posture = goal
        self.position, self.rotation = position, rotation

    def glide(self, position: Array, rotation: Array, steps: int) -> Iterator[Command]:
        """Move the palm on a straight line."""
        start, start_rotation = self.position, self.rotation
        turn = rotation_vector(start_rotation.T @ rotation)
        for k in range(1, steps + 1):
            phase = min_jerk(k / steps)
            towards = start + phase * (position - start), start_rotation @ rotation_matrix(phase * turn)
            yield self.step(*towards)
        self.position, self.rotation = position, rotation

    def step(self, position: Array, rotation: Array) -> Command:
        """Move the palm to a nearby pose at once.

        Args:
            position: Position of the grasp point, world frame [m]. Shape (3,).
            rotation: Orientation of the palm, world frame. Shape (3, 3).
        """
        self._arm = self._kinematics.solve(self._arm, position, rotation @ self.hand.frame.T)
        self.position, self.rotation = position, rotation
        return self._command()

    def hold(self, steps: int) -> Iterator[Command]:
        """Keep still."""
        for _ in range(steps):
            yield self._command()

    def move_hand(self, joints: Array, steps: int) -> Iterator[Command]:
        """Keep the palm still while free fingers go to joint positions [rad] (joints,)."""
        self.hand.go(joints, steps)
        yield from self.hold(steps)

    def take(
        self, grip: Grip, position: Array, rotation: Array, steps: int, preload: float | None = None
    ) -> Iterator[Command]:
        """Move the palm on a straight line to where a tool can be gripped, and grip it."""
        yield from self.glide(position, rotation, steps)
        yield from self.move_hand(grip.touch, 8)
        self.hand.grip(grip, preload)
        yield from self.wait(lambda: self.hand.gripped, 15)
        yield from self.hold(3)

    def let_go(self, grip: Grip, steps: int) -> Iterator[Command]:
        """Let go of what a grip holds, opening the fingers in so many steps."""
        self.hand.let_go()
        yield from self.move_hand(grip.touch, 4)
        yield from self.move_hand(grip.open, steps)

    def wait(self, until: Callable[[], bool], steps: int) -> Iterator[Command]:
        """Keep the palm still until something is true, at most for so many steps."""
        for _ in range(steps):
            if until():
                return
            yield self._command()

    def _command(self) -> Command:
        hand, draft = self.hand.step()
        joints = np.concatenate([self._arm, hand])
        self._share += float(np.clip(self.care - self._share, -_EASE, _EASE))
        noise = self._noise.step()
        noise[:N_ARM] *= self._share
        return Command(joints, joints + noise, draft, self.hand.slipping)
