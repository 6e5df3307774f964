"""Demonstrate HammerNail: grip the handle as it lies, turn it straight in the hand, strike until it is in."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.hammer import ARM_START, HANDLE_HALF_LENGTH, HEAD_CENTRE, HEAD_HALF_SIZE
from lerobot_dexflex.envs.hammer_nail import NAIL_DEPTH, TOLERANCE, HammerNailEnv
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.experts.place_hammer import GRASP_AT
from lerobot_dexflex.experts.tool.bar import pick_up
from lerobot_dexflex.experts.tool.grip import all_fingers, without
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.objects import ObjectSpec

HELD = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
"""Orientation of the hammer in the hand once it is straight: its handle along y, its face down."""
FACE = np.array([0.0, -HEAD_HALF_SIZE[1], HEAD_CENTRE])
"""Centre of the face that strikes, in the hammer's frame [m]."""
RAISED = (0.10, 0.45)
"""How high the face is raised over the nail [m], and how far the arm tips the hammer back there [rad]."""
STROKE, LAG = 5, 2.0
"""Control steps in which the face comes down, and by how many the arm lags behind its command."""
RETURN = 0.25
"""Where the arm turns back to as the face lands, as a share of the way up: later, and the hand would follow
through and twist the hammer; further, and the jerk would make it slip."""
STRIKE_PRELOAD = (2.0, 0.5)
"""Squeeze per finger that is wished for while striking [N], and more of it per unit of the margin."""
ALL_FINGERS = 0.6
"""How often all fingers take part; else the second does not."""
BLOWS = 12
"""After so many the operator gives up."""


def demonstrate(env: HammerNailEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of the hammer and the depth of the nail. The caller executes
    `Command.executed` before it asks for the next command.
    """
    episode, holds = env.episode, holds_of(env.hand)
    hold = holds.bar
    shape = ObjectSpec("cylinder", (episode.handle_radius, HANDLE_HALF_LENGTH), episode.mass)
    senses = ToolSenses(env, Tool("hammer", shape, np.zeros(3), episode.tip_friction))
    margin = rng.uniform(*MARGIN)
    hand = OperatorHand(senses, env.command, rng, margin, holds.frame)
    script = Script(env, hand, rng, hold.centre)
    position, rotation = env.hammer_pose
    grasp_point = position + rotation @ np.array([0.0, 0.0, GRASP_AT])
    held = Pose(hold.centre - GRASP_AT * HELD[:, 2], HELD)
    fingers = all_fingers(env.hand) if rng.random() < ALL_FINGERS else without(env.hand, 1)
    grip = hold.grip(PALM_DOWN.T @ rotation[:, 2], episode.handle_radius, fingers)

    yield from pick_up(script, grip, grasp_point, held, ARM_START)
    yield from script.glide(script.position + np.array([0, 0, 0.06]), PALM_DOWN, 10)

    script.care = 0.5
    yield from script.swing(*script.palm_for(held, *raised(env, 1.0)), 26, ARM_START)
    assert hand.operator is not None
    hand.operator.preload = STRIKE_PRELOAD[0] + STRIKE_PRELOAD[1] * margin
    yield from script.wait(lambda: hand.there, 20)
    script.care = 0.15
    for _ in range(BLOWS):
        yield from _strike(env, script, held)
        if env.nail_depth > NAIL_DEPTH - TOLERANCE / 2:
            break
    yield from script.hold(20)


def _strike(env: HammerNailEnv, script: Script, held: Pose) -> Iterator[Command]:
    """Raise the hammer, put it straight in the hand, and let the face land as the command turns back.

    Where the command comes down steadily, the arm follows late by `LAG`: its pace is chosen so that the face
    is at the nail at the end of the stroke, at about 0.7 m/s.
    """
    yield from script.glide(*script.palm_for(held, *raised(env, 1.0)), 8)
    yield from script.wait(lambda: script.hand.there, 8)
    now = script.in_palm(*env.hammer_pose)
    pace = 1.0 / (STROKE - LAG * (1.0 - np.exp(-STROKE / LAG)))
    for k in range(1, STROKE + 1):
        yield script.step(*script.palm_for(now, *raised(env, 1.0 - k * pace)))
    yield script.step(*script.palm_for(now, *raised(env, RETURN)))


def raised(env: HammerNailEnv, share: float) -> Pose:
    """Return the hammer's pose over the nail: 0 strikes it level, 1 is fully raised."""
    x, y, _ = env.episode.nail
    bearing = np.arctan2(y, x)
    up, handle = np.array([0.0, 0.0, 1.0]), np.array([np.cos(bearing), np.sin(bearing), 0.0])
    level = np.stack([np.cross(up, handle), up, handle], 1)
    rotation = level @ rotation_matrix(np.array([-RAISED[1] * share, 0.0, 0.0]))
    return Pose(env.nail_top + RAISED[0] * share * up - rotation @ FACE, rotation)
