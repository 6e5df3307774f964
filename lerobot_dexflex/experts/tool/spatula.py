"""How the operator takes a spatula from its stand, holds it, and scoops with it; shared by tasks."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.spatula import BLADE_TOP, EDGE, HANDLE_HALF_DEPTH, HANDLE_HALF_LENGTH, SpatulaEnv
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.bar import HELD, pick_up
from lerobot_dexflex.experts.tool.grip import all_fingers, without
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.grasp_candidates import GRAVITY
from lerobot_dexflex.hand.objects import ObjectSpec

GRASP_AT = 0.006
"""Where along the handle the hand grips, from its centre toward the blade [m]."""
ALL_FINGERS = 0.6
"""How often all fingers take part; else the second does not."""
SQUEEZE = 4.5
"""Squeeze per finger that is wished for whatever the margin [N]: scraping shakes off what hardly presses."""
FLEXED_DOWN = (-0.35, 0.0, 0.95, 0.0, 1.3)
"""Joints 2 to 6 of the arm with the palm down over the table [rad]."""

PRESS = 0.001
"""How deep the edge is led into the griddle [m]."""
SCOOP_RAISED = -0.06
"""Pitch of the spatula while it scoops [rad]."""
RUN_UP = 0.025
"""How far behind the food the edge comes down, in motion [m]."""
SCOOP_SPEED = 0.003
"""Speed of scooping [m] per control step: the rim is not to be hit hard."""
SCRAPE = np.array([0.0, -0.2, 0.1])
"""Force of the griddle on the edge that the hand braces for, working frame [N]."""
CARRY_RAISED = 0.06
"""Pitch of the spatula while it carries the food [rad]."""


def spatula_script(env: SpatulaEnv, rng: np.random.Generator) -> Script:
    """Return the operator's script for a task with a spatula, that has just been reset."""
    episode = env.episode
    half_size = (HANDLE_HALF_DEPTH, episode.handle_half_width, HANDLE_HALF_LENGTH)
    shape = ObjectSpec("box", half_size, episode.mass)
    senses = ToolSenses(env, Tool("spatula", shape, np.zeros(3), episode.tip_friction))
    holds = holds_of(env.hand)
    hand = OperatorHand(senses, env.command, rng, rng.uniform(*MARGIN), holds.frame)
    return Script(env, hand, rng, holds.bar.centre)


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
    hand = script.hand.senses.hand
    fingers = all_fingers(hand) if rng.random() < ALL_FINGERS else without(hand, 1)
    grip = holds_of(hand).bar.grip(PALM_DOWN.T @ spatula.rotation[:, 2], half_width, fingers)
    grasp_point = spatula.position + GRASP_AT * spatula.rotation[:, 2]
    yield from pick_up(script, grip, grasp_point, straight(script), arm_at(grasp_point, 0.0), SQUEEZE)
    yield from script.glide(script.position + np.array([0, 0, 0.05]), PALM_DOWN, 10)


def scoop(
    env: SpatulaEnv, script: Script, half_length: float, mass: float, end: float = -0.004
) -> Iterator[Command]:
    """Push the blade along the griddle below the food, up to the rim, and lift.

    Args:
        env: The environment.
        script: Of the operator.
        half_length: Of the food, along the push [m].
        mass: Of the food [kg].
        end: Where the edge stops, from the rim toward it [m].
    """
    origin, turn = env.griddle_pose
    heading = env.episode.griddle[2]
    food = turn.T @ (env.food_pose[0] - origin)
    start = food[0] - half_length - 0.005

    def blade_at(x: float, height: float, raised: float = SCOOP_RAISED) -> Pose:
        return spatula_at(origin + turn @ np.array([x, food[1], height]), heading, raised)

    script.care = 0.4
    above = script.palm_for(straight(script), *blade_at(start - RUN_UP, 0.05))
    yield from script.swing(*above, 26, arm_at(above.position, heading))
    yield from script.wait(lambda: script.hand.there, 20)
    script.care = 0.08
    held = script.in_palm(*env.spatula_pose)
    yield from script.glide(*script.palm_for(held, *blade_at(start - RUN_UP, 0.01)), 12)
    script.hand.brace(SCRAPE, np.array([BLADE_TOP, 0.0, 0.15]))
    way = end - (start - RUN_UP)
    steps = round(way / SCOOP_SPEED)
    for gone in np.linspace(0, way, steps + 1)[1:]:
        height = 0.01 * np.clip(1 - gone / RUN_UP, 0, 1) - PRESS
        yield script.step(*script.palm_for(held, *blade_at(start - RUN_UP + gone, height)))
    carry(env, script, mass)
    yield from script.hold(5)
    held = script.in_palm(*env.spatula_pose)
    yield from script.glide(*script.palm_for(held, *blade_at(end - 0.004, 0.01, CARRY_RAISED)), 10)
    yield from script.glide(*script.palm_for(held, *blade_at(end - 0.016, 0.08, CARRY_RAISED)), 14)


def carry(env: SpatulaEnv, script: Script, mass: float) -> None:
    """Let the hand expect the weight of food of a mass [kg] where the food is on the blade."""
    weight: Array = np.array([0.0, 0.0, -mass * GRAVITY])
    script.hand.brace(script.rotation.T @ weight, env.food_on_spatula())


def straight(script: Script) -> Pose:
    """Return how the spatula is held once it is straight, working frame."""
    return Pose(script.grasp_centre - GRASP_AT * HELD[:, 2], HELD)


def tipped(script: Script, held: Pose, pitch: float) -> Pose:
    """Return how a spatula is held, working frame, once fingers have raised its blade by a pitch [rad]."""
    centre, turn = script.grasp_centre, rotation_matrix(np.array([pitch, 0.0, 0.0]))
    return Pose(centre + turn @ (held.position - centre), turn @ held.rotation)


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
