"""Demonstrate PourCup: grip the bar, tip the pitcher with arm and fingers, set it down, let go."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.pour_cup import (
    BOWL_HEIGHT,
    HANDLE_CENTRE,
    HANDLE_HALF_DEPTH,
    HANDLE_HALF_HEIGHT,
    PITCHER_HEIGHT,
    PITCHER_RADIUS,
    PourCupEnv,
)
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.grip import all_fingers, without
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.script import Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.objects import ObjectSpec

ALL_FINGERS = 0.6
"""How often all fingers take part; else the second does not."""
LEAN = (-0.2, -0.4)
"""How far the palm leans against the bar when it grips [rad], and more of it per turn of the pitcher."""
TIPPED = 0.35
"""How far the fingers tip the pitcher in the hand while the arm pours [rad]."""
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
    episode, holds = env.episode, holds_of(env.hand)
    hold, in_pitcher = holds.pitcher, palm_in_pitcher(holds.pitcher.turn)
    half_size = (HANDLE_HALF_DEPTH, episode.handle_half_width, HANDLE_HALF_HEIGHT)
    shape, centre = ObjectSpec("box", half_size, episode.mass), np.array(HANDLE_CENTRE)
    senses = ToolSenses(env, Tool("pitcher", shape, centre, episode.tip_friction))
    senses.mass += episode.balls * episode.ball_mass
    hand = OperatorHand(senses, env.command, rng, rng.uniform(*MARGIN), holds.frame)
    script = Script(env, hand, rng, hold.centre)
    fingers = all_fingers(env.hand) if rng.random() < ALL_FINGERS else without(env.hand, 1)
    lean = rotation_matrix(np.array([LEAN[0] + LEAN[1] * episode.pitcher[2], 0.0, 0.0]))
    grip = hold.grip(lean.T[:, 1], episode.handle_half_width, fingers)
    position, rotation = env.pitcher_pose
    grasp_point, grasp_rotation = position + rotation @ centre, rotation @ in_pitcher @ lean
    upright = Pose(hold.centre - in_pitcher.T @ centre, in_pitcher.T)
    tip = rotation_matrix(np.array([-TIPPED, 0.0, 0.0]))
    tipped = Pose(hold.centre + tip @ (upright.position - hold.centre), tip @ upright.rotation)

    hand.go(grip.open, 20)
    behind = grasp_point + 0.085 * grasp_rotation[:, 2]
    yield from script.swing(behind, grasp_rotation, 22, ARM_FORWARD)
    script.care = 0.2
    yield from script.take(grip, grasp_point, grasp_rotation, 15)
    yield from script.glide(script.position + np.array([0, 0, 0.02]), script.rotation, 6)
    hand.lead(*upright)
    yield from script.glide(script.position + np.array([0, 0, 0.08]), script.rotation, 12)

    script.care = 0.5
    bowl = np.array([*episode.bowl, 0.0])
    hover = upright_at(bowl, HOVER)
    yield from script.swing(*script.palm_for(upright, *hover), 28, ARM_FORWARD)
    script.care = 0.3
    hand.lead(*tipped)
    yield from script.swing(*script.palm_for(tipped, *pouring_pose(bowl, SPILL_TILT)), 25, ARM_TILTED)
    hand.keep()
    script.care = 0.2
    held = script.in_palm(*env.pitcher_pose)
    yield from script.glide(*script.palm_for(held, *pouring_pose(bowl, SPILL_TILT)), 6)
    for tilt in np.linspace(SPILL_TILT, FULL_TILT, 31)[1:]:
        yield script.step(*script.palm_for(held, *pouring_pose(bowl, tilt)))
    yield from script.hold(8)
    senses.mass -= episode.balls * episode.ball_mass
    for tilt in np.linspace(FULL_TILT, SPILL_TILT, 17)[1:]:
        yield script.step(*script.palm_for(held, *pouring_pose(bowl, tilt)))

    script.care = 0.5
    yield from script.swing(*script.palm_for(tipped, *hover), 27, ARM_FORWARD)
    above = Pose(PLACE + np.array([0, 0, 0.06]), rotation_matrix(np.array([0, 0, np.pi])))
    yield from script.swing(*script.palm_for(tipped, *above), 22, ARM_FORWARD)
    script.care = 0.2
    held = script.in_palm(*env.pitcher_pose)
    yield from script.glide(*script.palm_for(held, *above._replace(position=PLACE)), 14)
    straight = hold.grip(np.array([0.0, 1.0, 0.0]), episode.handle_half_width, fingers)
    yield from script.let_go(straight, 8)
    hand.relax(25, after=5)
    yield from script.glide(script.position + 0.13 * script.rotation[:, 2], script.rotation, 15)
    yield from script.hold(15)


def palm_in_pitcher(turn: float) -> Array:
    """Return the orientation of the working frame in the pitcher's: y up, reaching for the pitcher.

    Args:
        turn: Of the push about the handle [rad]; see `BarHold`.
    """
    return np.array(
        [
            [np.sin(turn), 0.0, np.cos(turn)],
            [np.cos(turn), 0.0, -np.sin(turn)],
            [0.0, 1.0, 0.0],
        ]
    )


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
