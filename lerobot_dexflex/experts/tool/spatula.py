"""How the operator takes a spatula from its stand and where it holds it; shared by tasks."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.spatula import EDGE, HANDLE_HALF_DEPTH, HANDLE_HALF_LENGTH
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.grip import Handle, grip_handle
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.objects import ObjectSpec

GRASP_CENTRE = np.array([-0.0405, -0.0353, -0.1401])
"""Point in the handle between the pads, palm frame [m]; the handle runs along palm y in the end."""
HAND_TOUCH = np.array(
    (
        *(1.519, 0.004, 0.368, -0.316),
        *(1.518, -0.024, 0.367, -0.315),
        *(1.524, -0.053, 0.354, -0.307),
        *(1.755, 0.002, 0.386, -0.385),
    )
)
"""All four pads flat on a handle of 13 mm half width [rad]: where the search for a grip begins."""
HAND_IDLE = np.array((0.3, 0.0, 0.3, 0.3) * 3 + (1.6, 0.2, 0.8, -0.2))
"""Fingers that take no part are stretched out [rad]."""
ALONG = np.array([0.043, 0.0, -0.043, 0.012])
"""Where the pads are along the handle, from the middle finger toward the index [m]."""
HELD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Orientation of the spatula in the palm once it is straight: its handle along palm y, blade at the index."""
GRASP_AT = 0.006
"""Where along the handle the hand grips, from its centre toward the blade [m]."""
STRAIGHT = Pose(GRASP_CENTRE - GRASP_AT * HELD[:, 2], HELD)
"""How the spatula is held once it is straight, palm frame."""
ROOM = 0.024
"""How far from the handle the open pads are [m]."""
FOUR_FINGERS = 0.6
"""How often the middle finger takes part."""
SQUEEZE = 4.5
"""Squeeze per finger that is wished for whatever the margin [N]: scraping shakes off what hardly presses."""
FLEXED_DOWN = (-0.35, 0.0, 0.95, 0.0, 1.3)
"""Joints 2 to 6 of the arm with the palm down over the table [rad]."""


def spatula_script(env: HandEnv, rng: np.random.Generator) -> Script:
    """Return the operator's script for a task with a spatula, that has just been reset."""
    episode = env.episode
    half_size = (HANDLE_HALF_DEPTH, episode.handle_half_width, HANDLE_HALF_LENGTH)
    shape = ObjectSpec("box", half_size, episode.mass)
    senses = ToolSenses(env, Tool("spatula", shape, np.zeros(3), episode.tip_friction))
    hand = OperatorHand(senses, env.command[7:], rng, rng.uniform(*MARGIN))
    return Script(env, hand, rng, GRASP_CENTRE)


def take_spatula(
    script: Script, spatula: Pose, half_width: float, rng: np.random.Generator
) -> Iterator[Command]:
    """Grip the spatula as it lies in its stand at a pose, lift it and turn it straight in the hand.

    Args:
        script: Of the operator.
        spatula: Where it lies, world frame.
        half_width: Of its handle [m].
        rng: Decides which fingers take part.
    """
    fingers = (0, 1, 2, 3) if rng.random() < FOUR_FINGERS else (0, 2, 3)
    handle = Handle(GRASP_CENTRE, PALM_DOWN.T @ spatula.rotation[:, 2], half_width)
    grip = grip_handle(handle, ALONG, np.array([-1.0, 0, 0]), fingers, HAND_TOUCH, HAND_IDLE, ROOM)
    grasp_point = spatula.position + GRASP_AT * spatula.rotation[:, 2]
    above = grasp_point + np.array([0, 0, 0.08])
    script.hand.go(grip.open, 20)
    yield from script.swing(above, PALM_DOWN, 22, arm_at(grasp_point, 0.0))
    script.care = 0.2
    yield from script.take(grip, grasp_point, PALM_DOWN, 15, SQUEEZE)
    yield from script.glide(script.position + np.array([0, 0, 0.02]), PALM_DOWN, 6)
    script.hand.lead(*STRAIGHT)
    yield from script.glide(script.position + np.array([0, 0, 0.05]), PALM_DOWN, 10)


def arm_at(point: Array, heading: float) -> tuple[float, ...]:
    """Return a seed of the arm that brings the hand over a point (3,), palm down, toward `heading` [rad]."""
    bearing = float(np.arctan2(point[1], point[0]))
    return (bearing, *FLEXED_DOWN, np.pi / 2 + bearing - heading)


def spatula_at(edge: Array, heading: float, raised: float) -> Pose:
    """Return the spatula's pose.

    Args:
        edge: Where the middle of its front edge is, world frame [m]. Shape (3,).
        heading: Direction of its handle about the vertical [rad].
        raised: By how much the edge is raised from level [rad]; negative where it points down.
    """
    handle = np.array([np.cos(heading), np.sin(heading), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    level = np.stack([up, np.cross(handle, up), handle], 1)
    rotation = level @ rotation_matrix(np.array([0.0, raised, 0.0]))
    return Pose(edge - rotation @ EDGE, rotation)
