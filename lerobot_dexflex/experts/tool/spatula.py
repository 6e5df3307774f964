"""How the operator takes a spatula from its stand and where it holds it; shared by tasks."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.spatula import EDGE, HANDLE_HALF_DEPTH, HANDLE_HALF_LENGTH
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.bar import GRASP_CENTRE, HELD, grip_bar, pick_up
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.objects import ObjectSpec

GRASP_AT = 0.006
"""Where along the handle the hand grips, from its centre toward the blade [m]."""
STRAIGHT = Pose(GRASP_CENTRE - GRASP_AT * HELD[:, 2], HELD)
"""How the spatula is held once it is straight, palm frame."""
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
    grip = grip_bar(PALM_DOWN.T @ spatula.rotation[:, 2], half_width, fingers)
    grasp_point = spatula.position + GRASP_AT * spatula.rotation[:, 2]
    yield from pick_up(script, grip, grasp_point, STRAIGHT, arm_at(grasp_point, 0.0), SQUEEZE)
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
