"""Motion primitives of the scripted experts."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.experts.command import (
    Array,
    Command,
    FingertipExecutor,
    Unsteadiness,
    fingertips_of,
    min_jerk,
)
from lerobot_dexflex.hand.arm import ArmKinematics, rotation_matrix, rotation_vector

_ARM_NOISE, _HAND_NOISE = 0.010, 0.010


class Pose(NamedTuple):
    """Where a body is."""

    position: Array
    """Origin [m]. Shape (3,)."""
    rotation: Array
    """Orientation. Shape (3, 3)."""


class Script:
    """Keeps track of where the palm and the fingertips have been commanded to, and moves them on.

    Args:
        env: The environment, unwrapped and just reset.
        rng: Source of the unsteadiness.
        grasp_centre: Point between the pads that every pose is about, palm frame [m]. Shape (3,).
    """

    def __init__(self, env: HandEnv, rng: np.random.Generator, grasp_centre: Array) -> None:
        self._env = env
        self._grasp_centre = grasp_centre
        self._arm = env.command[:7]
        self._kinematics = ArmKinematics(grasp_centre, self._arm)
        self._executor = FingertipExecutor(env.command[7:])
        self._tips = fingertips_of(env.command[7:])
        scale = np.concatenate([np.full(7, _ARM_NOISE), np.full(16, _HAND_NOISE)])
        self._noise = Unsteadiness(rng, scale)
        self.care = 1.0
        """Share of the natural unsteadiness; less of it where precision counts."""
        self.position, self.rotation = self._kinematics.forward(self._arm)

    def in_palm(self, position: Array, rotation: Array) -> Pose:
        """Return a world pose in the measured palm frame: how an object is held."""
        palm = self._env.data.body("palm")
        palm_rotation = palm.xmat.reshape(3, 3)
        return Pose(palm_rotation.T @ (position - palm.xpos), palm_rotation.T @ rotation)

    def palm_for(self, held: Pose, position: Array, rotation: Array) -> Pose:
        """Return the grasp point's position and palm orientation that bring a held object to a pose."""
        palm_rotation = rotation @ held.rotation.T
        return Pose(position + palm_rotation @ (self._grasp_centre - held.position), palm_rotation)

    def swing(self, position: Array, rotation: Array, steps: int, seed: tuple) -> Iterator[Command]:
        """Interpolate the joints to a pose found from a planar seed: for large reorientations."""
        start, goal = self._arm, self._kinematics.reach(np.array(seed), position, rotation)
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

    def step(self, position: Array, rotation: Array, unbend: bool = False) -> Command:
        """Move the palm to a nearby pose at once.

        Args:
            position: Position of the grasp point, world frame [m]. Shape (3,).
            rotation: Orientation of the palm, world frame. Shape (3, 3).
            unbend: Let the spare joint keep joints 3 and 5 at zero and joint 1 at half the bearing, which
                turning the flange about an axis beside it needs.
        """
        if unbend:
            self._kinematics.posture = self._arm * (0, 1, 0, 1, 0, 1, 1)
            self._kinematics.posture[0] = np.arctan2(position[1], position[0]) / 2
        gain = 0.05 if unbend else 0.02
        self._arm = self._kinematics.solve(self._arm, position, rotation, posture_gain=gain)
        self.position, self.rotation = position, rotation
        return self._command()

    def move_tips(self, target: Array, steps: int, steady: bool = False) -> Iterator[Command]:
        """Move the fingertips on straight lines, at constant speed if `steady`."""
        start = self._tips
        for k in range(1, steps + 1):
            phase = k / steps if steady else min_jerk(k / steps)
            self._tips = start + phase * (target - start)
            yield self._command()

    def hold(self, steps: int) -> Iterator[Command]:
        """Keep still."""
        for _ in range(steps):
            yield self._command()

    def _command(self) -> Command:
        joints = np.concatenate([self._arm, self._executor.step(self._tips)])
        return Command(joints, self._tips.copy(), joints + self._noise.step(self.care))
