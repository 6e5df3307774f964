"""Demonstrate PourCup: three fingers against the thumb on the bar, tilt about the lip, set down, let go."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.pour_cup import (
    BOWL_HEIGHT,
    HAND_OPEN,
    HANDLE_CENTRE,
    PITCHER_HEIGHT,
    PITCHER_RADIUS,
    PourCupEnv,
)
from lerobot_dexflex.experts.command import Array, Command, fingertips_of
from lerobot_dexflex.experts.script import Pose, Script
from lerobot_dexflex.hand.arm import rotation_matrix

GRASP_CENTRE = np.array([-0.0495, -0.0335, -0.1372])
"""Point inside the bar between the four pads, palm frame [m]; the bar runs along palm y."""
GRASP_TURN = 0.081
"""Turn of the palm about the bar at which the pads lie flat [rad]."""
PALM_IN_PITCHER = np.array(
    [
        [np.sin(GRASP_TURN), 0.0, np.cos(GRASP_TURN)],
        [np.cos(GRASP_TURN), 0.0, -np.sin(GRASP_TURN)],
        [0.0, 1.0, 0.0],
    ]
)
"""Orientation of the palm in the pitcher's frame: palm y up, the flange pointing at the pitcher."""
HAND_TOUCH = (
    *(1.658, -0.040, 0.283, -0.286),
    *(1.656, -0.045, 0.285, -0.286),
    *(1.657, -0.049, 0.284, -0.286),
    *(1.929, -0.027, 0.326, -0.399),
)
"""All four pads flat on a bar of 20 mm width [rad] (least squares of pad poses)."""
HAND_SQUEEZE = (
    *(1.739, -0.040, 0.329, -0.263),
    *(1.737, -0.045, 0.331, -0.263),
    *(1.738, -0.049, 0.330, -0.263),
    *(1.923, -0.027, 0.498, -0.310),
)
"""Servos asked for 2 N per finger and 5.8 N of the thumb [rad]: the thumb must balance three fingers."""
ARM_FORWARD = (0.0, 0.56, 0.05, 0.63, 3.2, 1.5, -1.6)
"""Seed with the flange pointing forward [rad]."""
ARM_TILTED = (-0.6, -0.5, 0.05, 0.65, 3.2, -0.75, -1.6)
"""Seed with the flange pointing down, on the same branch, joint 6 beyond the wrist's singularity [rad]."""
GRASP_RANGE = (-0.004, 0.004)
"""Where along the bar the hand grips, from its centre upward [m]."""
PLACE = np.array([0.58, 0.04, 0.0])
"""Where the pitcher is set down, world frame [m]."""
HOVER = (0.10, 0.20)
"""Pitcher upright in front of the bowl: how far behind the bowl's centre and how high its bottom [m]."""
SPILL_TILT, FULL_TILT = 1.0, 2.04
"""Tilts between which the pitcher turns slowly [rad]; at the last its wall falls by 27 degrees."""
_LIP_CLEARANCE = 0.030
_POUR_OFFSET = -0.035
"""How far behind the bowl's centre the lip is while pouring [m]; negative, since the balls fly forward."""


def demonstrate(env: PourCupEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true poses of pitcher and bowl. The caller executes `Command.executed` before it
    asks for the next command.
    """
    script = Script(env, rng, GRASP_CENTRE)
    tips_open, tips_touch, tips_squeeze = map(fingertips_of, (HAND_OPEN, HAND_TOUCH, HAND_SQUEEZE))
    position, rotation = env.pitcher_pose
    offset = np.array([0.0, 0.0, rng.uniform(*GRASP_RANGE)])
    grasp_point = position + rotation @ (np.array(HANDLE_CENTRE) + offset)
    grasp_rotation = rotation @ PALM_IN_PITCHER

    behind = grasp_point + 0.085 * grasp_rotation[:, 2]
    yield from script.swing(behind, grasp_rotation, 22, ARM_FORWARD)
    yield from script.glide(grasp_point, grasp_rotation, 15)
    yield from script.hold(2)
    yield from script.move_tips(tips_touch, 10)
    yield from script.move_tips(tips_squeeze, 10, steady=True)
    yield from script.hold(2)
    yield from script.glide(script.position + np.array([0, 0, 0.10]), script.rotation, 14)

    def palm_for(pose: Pose) -> Pose:
        return script.palm_for(script.in_palm(*env.pitcher_pose), *pose)

    bowl = np.array([*env.episode.bowl, 0.0])
    hover = upright_at(bowl, HOVER)
    yield from script.swing(*palm_for(hover), 28, ARM_FORWARD)
    yield from script.swing(*palm_for(pouring_pose(bowl, SPILL_TILT)), 25, ARM_TILTED)
    held = script.in_palm(*env.pitcher_pose)
    for tilt in np.linspace(SPILL_TILT, FULL_TILT, 31)[1:]:
        yield script.step(*script.palm_for(held, *pouring_pose(bowl, tilt)))
    yield from script.hold(8)
    for tilt in np.linspace(FULL_TILT, SPILL_TILT, 14)[1:]:
        yield script.step(*script.palm_for(held, *pouring_pose(bowl, tilt)))

    yield from script.swing(*palm_for(hover), 23, ARM_FORWARD)
    above = Pose(PLACE + np.array([0, 0, 0.06]), rotation_matrix(np.array([0, 0, np.pi])))
    yield from script.swing(*palm_for(above), 22, ARM_FORWARD)
    yield from script.glide(*palm_for(above._replace(position=PLACE)), 14)
    yield from script.move_tips(tips_touch, 8, steady=True)
    yield from script.move_tips(tips_open, 8)
    yield from script.glide(script.position + 0.13 * script.rotation[:, 2], script.rotation, 15)
    yield from script.hold(14)


def upright_at(bowl: Array, offset: tuple[float, float]) -> Pose:
    """Return a pose of the upright pitcher near the bowl, its handle toward the robot.

    Args:
        bowl: Position of the bowl's foot, world frame [m]. Shape (3,).
        offset: How far its axis is from the bowl's, away from the robot, and how high its bottom [m].
    """
    bearing = np.arctan2(bowl[1], bowl[0])
    forward = np.array([np.cos(bearing), np.sin(bearing), 0.0])
    rotation = rotation_matrix(np.array([0.0, 0.0, bearing + np.pi]))
    return Pose(bowl + offset[0] * forward + np.array([0.0, 0.0, offset[1]]), rotation)


def pouring_pose(bowl: Array, tilt: float) -> Pose:
    """Return the pitcher's pose, tilted away from the robot by `tilt` [rad], its lip above the bowl.

    Args:
        bowl: Position of the bowl's foot, world frame [m]. Shape (3,).
        tilt: Angle from upright [rad].
    """
    height = BOWL_HEIGHT + max(0.040, _LIP_CLEARANCE + PITCHER_HEIGHT * np.cos(tilt))
    lip, upright = upright_at(bowl, (_POUR_OFFSET, height))
    rotation = upright @ rotation_matrix(np.array([0.0, -tilt, 0.0]))
    return Pose(lip - rotation @ np.array([-PITCHER_RADIUS, 0.0, PITCHER_HEIGHT]), rotation)
