"""Demonstrate SpatulaServe: turn the spatula straight in the hand, scoop, carry level, tip, draw back."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.spatula import BLADE_TOP
from lerobot_dexflex.envs.spatula_serve import PLATE_HEIGHT, SpatulaServeEnv
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.script import Pose, Script
from lerobot_dexflex.experts.tool.spatula import (
    GRASP_CENTRE,
    STRAIGHT,
    arm_at,
    spatula_at,
    spatula_script,
    take_spatula,
)
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.grasp_candidates import GRAVITY

PRESS = 0.001
"""How deep the edge is led into the griddle [m]."""
SCOOP_RAISED = -0.06
"""Pitch of the spatula while it scoops [rad]."""
RUN_UP = 0.025
"""How far behind the patty the edge comes down, in motion [m]."""
SCOOP_SPEED = 0.003
"""Speed of scooping [m] per control step: the rim is not to be hit hard."""
SCRAPE = np.array([0.0, -0.2, 0.1])
"""Force of the griddle on the edge that the hand braces for, palm frame while scooping [N]."""
CARRY_RAISED = 0.06
"""Pitch of the spatula while it carries the patty [rad]."""
TIP_RAISED = -0.5
"""Pitch of the spatula while the patty slides off [rad]."""
TIP = rotation_matrix(np.array([-0.25, 0.0, 0.0]))
"""What of that the fingers turn, in the palm frame."""
TIPPED = Pose(GRASP_CENTRE + TIP @ (STRAIGHT.position - GRASP_CENTRE), TIP @ STRAIGHT.rotation)
"""How the spatula is held then, palm frame."""
DROP_AHEAD = 0.01
"""Where the edge tips, from the plate's centre away from the robot [m]."""


def demonstrate(env: SpatulaServeEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of the spatula and of the patty. The caller executes `Command.executed`
    before it asks for the next command.
    """
    script = spatula_script(env, rng)
    yield from take_spatula(script, Pose(*env.spatula_pose), env.episode.handle_half_width, rng)
    yield from _scoop(env, script)
    yield from _serve(env, script)


def _scoop(env: SpatulaServeEnv, script: Script) -> Iterator[Command]:
    """Push the blade along the griddle below the patty, up to the rim, and lift."""
    origin, turn = env.griddle_pose
    heading = env.episode.griddle[2]
    patty = turn.T @ (env.food_pose[0] - origin)
    start = patty[0] - env.episode.patty_radius - 0.005

    def blade_at(x: float, height: float, raised: float = SCOOP_RAISED) -> Pose:
        return spatula_at(origin + turn @ np.array([x, patty[1], height]), heading, raised)

    script.care = 0.4
    above = script.palm_for(STRAIGHT, *blade_at(start - RUN_UP, 0.05))
    yield from script.swing(*above, 26, arm_at(above.position, heading))
    yield from script.wait(lambda: script.hand.there, 20)
    script.care = 0.08
    held = script.in_palm(*env.spatula_pose)
    yield from script.glide(*script.palm_for(held, *blade_at(start - RUN_UP, 0.01)), 12)
    script.hand.brace(SCRAPE, np.array([BLADE_TOP, 0.0, 0.15]))
    way = -0.004 - (start - RUN_UP)
    steps = round(way / SCOOP_SPEED)
    for gone in np.linspace(0, way, steps + 1)[1:]:
        height = 0.01 * np.clip(1 - gone / RUN_UP, 0, 1) - PRESS
        yield script.step(*script.palm_for(held, *blade_at(start - RUN_UP + gone, height)))
    _carry(env, script)
    yield from script.hold(5)
    held = script.in_palm(*env.spatula_pose)
    yield from script.glide(*script.palm_for(held, *blade_at(-0.008, 0.01, CARRY_RAISED)), 10)
    yield from script.glide(*script.palm_for(held, *blade_at(-0.02, 0.08, CARRY_RAISED)), 14)


def _serve(env: SpatulaServeEnv, script: Script) -> Iterator[Command]:
    """Carry the patty over the plate, tip the blade so that it slides down, and draw the blade back."""
    plate = np.array([*env.episode.plate, PLATE_HEIGHT])
    heading = float(np.arctan2(plate[1], plate[0]))
    forward = np.array([np.cos(heading), np.sin(heading), 0.0])

    def blade_at(ahead: float, height: float, raised: float) -> Pose:
        return spatula_at(plate + ahead * forward + np.array([0.0, 0.0, height]), heading, raised)

    script.care = 0.2
    held = script.in_palm(*env.spatula_pose)
    above = script.palm_for(held, *blade_at(DROP_AHEAD, 0.08, CARRY_RAISED))
    yield from script.swing(*above, 36, arm_at(above.position, heading))
    held = script.in_palm(*env.spatula_pose)
    yield from script.glide(*script.palm_for(held, *blade_at(DROP_AHEAD, 0.015, CARRY_RAISED)), 14)
    script.care = 0.08
    script.hand.lead(*TIPPED)
    for raised in np.linspace(CARRY_RAISED, TIP_RAISED, 25)[1:]:
        _carry(env, script)
        held = script.in_palm(*env.spatula_pose)
        yield script.step(*script.palm_for(held, *blade_at(DROP_AHEAD, 0.004, raised)))
    yield from script.hold(4)
    script.hand.brace(np.zeros(3), np.zeros(3))
    held = script.in_palm(*env.spatula_pose)
    yield from script.glide(*script.palm_for(held, *blade_at(DROP_AHEAD - 0.09, 0.02, TIP_RAISED)), 22)
    yield from script.glide(*script.palm_for(held, *blade_at(DROP_AHEAD - 0.12, 0.06, 0.0)), 12)
    yield from script.hold(20)


def _carry(env: SpatulaServeEnv, script: Script) -> None:
    """Let the hand expect the patty's weight where the patty is on the blade."""
    weight: Array = np.array([0.0, 0.0, -env.episode.patty_mass * GRAVITY])
    script.hand.brace(script.rotation.T @ weight, env.food_on_spatula())
