"""Demonstrate FlipToast: scoop, draw back, tip the slice onto its edge, and push it over."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.flip_toast import FLIPPED, FlipToastEnv
from lerobot_dexflex.envs.spatula import BLADE_END, EDGE
from lerobot_dexflex.experts.command import Command, min_jerk
from lerobot_dexflex.experts.tool.script import Pose, Script
from lerobot_dexflex.experts.tool.spatula import (
    CARRY_RAISED,
    carry,
    scoop,
    spatula_at,
    spatula_script,
    straight,
    take_spatula,
    tipped,
)

TRIES = 2
"""After so many the operator gives up."""
TIP_AT = -0.07
"""Where the edge tips, from a slice's length behind the rim [m]."""
DRAW_BACK = 30
"""Control steps for that."""
TIP_HEIGHT = 0.046
"""Height of the edge meanwhile [m]: half a slice, so that the slice comes to stand on its own edge."""
TIP_RAISED = -0.75
"""Pitch of the spatula then [rad]."""
TIP_SPEED, PUSH_SPEED = 0.06, 0.006
"""How fast it is tipped [rad], and pushes the slice once that slides [m], per control step."""
WOUND_UP, TIPPED = 0.1, -0.3
"""What of the pitch the fingers turn before it is tipped, the arm keeping the blade level, and then [rad]."""
PUSH = 0.085
"""How far the edge pushes the slice [m]."""


def demonstrate(env: FlipToastEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of the spatula and of the slice. The caller executes `Command.executed`
    before it asks for the next command.
    """
    episode = env.episode
    half_width = episode.slice_half_size[0]
    end = -max(0.004, 2 * half_width - 0.071)  # The slice is not to be pushed against the neck.
    script = spatula_script(env, rng)
    yield from take_spatula(script, Pose(*env.spatula_pose), episode.handle_half_width, rng)
    for _ in range(TRIES):
        yield from scoop(env, script, half_width + 0.004, episode.slice_mass, end)
        yield from _turn_over(env, script)
        if env.turned > FLIPPED:
            break
    yield from script.hold(20)


def _turn_over(env: FlipToastEnv, script: Script) -> Iterator[Command]:
    """Let the slice slide off until it stands on its edge, leaning on the blade, and push it over."""
    origin, turn = env.griddle_pose
    heading = env.episode.griddle[2]
    across = (turn.T @ (env.food_pose[0] - origin))[1]
    x = TIP_AT - 2 * env.episode.slice_half_size[0]

    def blade_at(ahead: float, height: float, raised: float) -> Pose:
        return spatula_at(origin + turn @ np.array([x + ahead, across, height]), heading, raised)

    before = script.in_palm(*env.spatula_pose)

    def held_now() -> Pose:
        # Of how the spatula moves in the hand, the arm makes up for pitch alone: following yaw, it sways.
        now = script.in_palm(*env.spatula_pose)
        return tipped(script, before, float(np.arcsin(now.rotation[2, 2]) - np.arcsin(before.rotation[2, 2])))

    def step_to(ahead: float, height: float, raised: float) -> Command:
        if env.food_on_spatula()[2] < BLADE_END - 0.01:
            carry(env, script, env.episode.slice_mass)
        else:
            script.hand.brace(np.zeros(3), np.zeros(3))
        return script.step(*script.palm_for(held_now(), *blade_at(ahead, height, raised)))

    position, rotation = env.spatula_pose
    start = turn.T @ (position + rotation @ EDGE - origin)
    script.hand.lead(*tipped(script, straight(script), WOUND_UP))
    for step in range(1, DRAW_BACK + 1):
        phase = min_jerk(step / DRAW_BACK)
        ahead, height = (1 - phase) * (start[0] - x), start[2] + phase * (TIP_HEIGHT - start[2])
        yield step_to(ahead, height, CARRY_RAISED)
    script.hand.lead(*tipped(script, straight(script), TIPPED))
    raised, ahead = CARRY_RAISED, 0.0
    for _ in range(50):
        raised = max(raised - TIP_SPEED, TIP_RAISED)
        sliding = ahead > 0 or env.food_on_spatula()[2] > BLADE_END - 0.01
        ahead = min(ahead + PUSH_SPEED * sliding, PUSH)
        yield step_to(ahead, TIP_HEIGHT, raised)
        if ahead == PUSH:
            break
    held = script.in_palm(*env.spatula_pose)
    yield from script.hold(6)
    yield from script.glide(*script.palm_for(held, *blade_at(0.0, TIP_HEIGHT + 0.04, TIP_RAISED)), 14)
    script.hand.lead(*straight(script))
    yield from script.glide(*script.palm_for(held, *blade_at(-0.02, 0.09, 0.0)), 14)
