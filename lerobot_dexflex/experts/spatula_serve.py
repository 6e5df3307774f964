"""Demonstrate SpatulaServe: turn the spatula straight in the hand, scoop, carry level, tip, draw back."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.spatula_serve import PLATE_HEIGHT, SpatulaServeEnv
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.experts.tool.script import Pose, Script
from lerobot_dexflex.experts.tool.spatula import (
    CARRY_RAISED,
    arm_at,
    carry,
    scoop,
    spatula_at,
    spatula_script,
    straight,
    take_spatula,
    tipped,
)

TIP_RAISED = -0.5
"""Pitch of the spatula while the patty slides off [rad]."""
TIPPED = -0.25
"""What of that the fingers turn [rad]."""
DROP_AHEAD = 0.01
"""Where the edge tips, from the plate's centre away from the robot [m]."""


def demonstrate(env: SpatulaServeEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of the spatula and of the patty. The caller executes `Command.executed`
    before it asks for the next command.
    """
    script = spatula_script(env, rng)
    yield from take_spatula(script, Pose(*env.spatula_pose), env.episode.handle_half_width, rng)
    yield from scoop(env, script, env.episode.patty_radius, env.episode.patty_mass)
    yield from _serve(env, script)


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
    script.hand.lead(*tipped(script, straight(script), TIPPED))
    for raised in np.linspace(CARRY_RAISED, TIP_RAISED, 25)[1:]:
        carry(env, script, env.episode.patty_mass)
        held = script.in_palm(*env.spatula_pose)
        yield script.step(*script.palm_for(held, *blade_at(DROP_AHEAD, 0.004, raised)))
    yield from script.hold(4)
    script.hand.brace(np.zeros(3), np.zeros(3))
    held = script.in_palm(*env.spatula_pose)
    yield from script.glide(*script.palm_for(held, *blade_at(DROP_AHEAD - 0.09, 0.02, TIP_RAISED)), 22)
    yield from script.glide(*script.palm_for(held, *blade_at(DROP_AHEAD - 0.12, 0.06, 0.0)), 12)
    yield from script.hold(20)
