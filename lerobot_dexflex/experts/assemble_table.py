"""Demonstrate AssembleTable: thumb against index and middle, carry, insert, one turn of joint 7, let go."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.assemble_table import ARM_START, HAND_OPEN, AssembleTableEnv
from lerobot_dexflex.envs.leg_and_socket import PITCH, STUD_LENGTH, TURNS
from lerobot_dexflex.experts.command import Array, Command, fingertips_of
from lerobot_dexflex.experts.script import Pose, Script
from lerobot_dexflex.hand.arm import rotation_matrix

GRASP_CENTRE = np.array([-0.0230, 0.0242, -0.1247])
"""Point on the leg's axis between the three pads, palm frame [m]; the leg runs along palm z."""
HAND_TOUCH = (
    *(1.066, -0.533, 0.917, -0.316),
    *(1.752, -0.630, -0.457, 0.194),
    *(0.600, -0.300, 0.300, 0.300),
    *(1.369, -0.068, 0.912, -0.924),
)
"""Thumb opposite a shallow V of index and middle on a leg of 12 mm radius [rad] (least squares)."""
HAND_SQUEEZE = (
    *(1.177, -0.465, 0.944, -0.354),
    *(1.793, -0.637, -0.240, -0.025),
    *(0.600, -0.300, 0.300, 0.300),
    *(1.329, -0.006, 0.758, -0.265),
)
"""Fingers 12 mm and thumb 22 mm into the leg [rad]: the thumb must balance two fingers."""
GRASP_YAW = -np.pi / 2
"""Yaw of the palm at which `ARM_START` has joint 7 wound back [rad]."""
GRASP_RANGE = (0.083, 0.091)
"""Where along the leg the hand grips, above the shaft's lower end [m]."""
SCREW_RATE = 1.75
"""How fast the palm turns the leg [rad/s]."""
OVERTURN, PRESS = 1.2, 0.002
"""Turn after the leg has become tight [rad], and depth below the thread at which the palm aims [m]."""
_CONTROL_PERIOD = 0.05


def demonstrate(env: AssembleTableEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of leg and socket, and whether the thread has caught. The caller executes
    `Command.executed` before it asks for the next command.
    """
    script = Script(env, rng, GRASP_CENTRE)
    grasp_rotation = _about_z(GRASP_YAW)
    position, rotation = env.leg_pose
    grasp_point = position + rng.uniform(*GRASP_RANGE) * rotation[:, 2]
    tips_open, tips_touch, tips_squeeze = map(fingertips_of, (HAND_OPEN, HAND_TOUCH, HAND_SQUEEZE))

    yield from script.swing(grasp_point + np.array([0, 0, 0.07]), grasp_rotation, 26, ARM_START)
    script.care = 0.3
    yield from script.glide(grasp_point, grasp_rotation, 18)
    yield from script.move_tips(tips_touch, 9)
    yield from script.move_tips(tips_squeeze, 11, steady=True)
    yield from script.glide(script.position + np.array([0, 0, 0.07]), script.rotation, 16)

    yield from script.swing(*_palm_above(env, script, 0.035), 30, ARM_START)
    yield from script.hold(4)
    script.care = 0.2
    yield from script.glide(*_palm_above(env, script, 0.015), 12)
    yield from _insert(env, script)
    yield from _screw(env, script)
    script.care = 0.7
    yield from script.move_tips(tips_touch, 7, steady=True)
    yield from script.move_tips(tips_open, 8)
    yield from script.glide(script.position + np.array([0, 0, 0.12]), script.rotation, 17)
    yield from script.hold(15)


def _palm_above(env: AssembleTableEnv, script: Script, height: float) -> Pose:
    """Return the palm pose that holds the leg upright, `height` [m] above where the thread catches it."""
    held = script.in_palm(*env.leg_pose)
    goal = env.goal_position + np.array([0, 0, height])
    return script.palm_for(held, goal, _made_upright(_about_z(GRASP_YAW) @ held.rotation))


def _insert(env: AssembleTableEnv, script: Script, steps: int = 45, pressing: int = 6) -> Iterator[Command]:
    """Lower the stud into the socket, steered by its measured tip, until the thread has caught it safely.

    Pressing on for a few steps lets also those who repeat the motion less exactly catch the thread.
    """
    held = script.in_palm(*env.leg_pose)
    upright = _made_upright(_about_z(GRASP_YAW) @ held.rotation)
    correction = np.zeros(3)
    for k in range(1, steps + 1):
        position, rotation = env.leg_pose
        beside = env.goal_position - (position - STUD_LENGTH * rotation[:, 2])
        if not env.caught:
            correction[:2] = np.clip(correction[:2] + 0.15 * beside[:2], -0.006, 0.006)
        height = np.array([0, 0, max(0.015 - 0.001 * k, -0.006)])
        yield script.step(*script.palm_for(held, env.goal_position + height + correction, upright))
        pressing -= env.caught
        if pressing < 0:
            return


def _screw(env: AssembleTableEnv, script: Script) -> Iterator[Command]:
    """Turn the leg clockwise about its own axis, sinking with the thread, until it lights and a bit more."""
    held = script.in_palm(*env.leg_pose)
    upright = _made_upright(env.leg_pose[1])
    angle, rate, limit = 0.0, 0.0, 2 * np.pi * (TURNS + 0.5)
    while env.caught and angle < limit:
        if env.lit:
            limit = min(limit, angle + OVERTURN)
            rate = SCREW_RATE * min(1.0, (limit - angle) / 0.3 + 0.2)
        else:
            rate = min(SCREW_RATE, rate + 0.2 * SCREW_RATE)
        angle += rate * _CONTROL_PERIOD
        sunk = np.array([0, 0, -PITCH * min(TURNS, angle / (2 * np.pi)) - PRESS])
        pose = script.palm_for(held, env.goal_position + sunk, _about_z(-angle) @ upright)
        yield script.step(*pose, unbend=True)


def _about_z(angle: float) -> Array:
    return rotation_matrix(np.array([0.0, 0.0, angle]))


def _made_upright(rotation: Array) -> Array:
    """Return the orientation with a vertical z axis that is nearest to `rotation`."""
    axis = np.cross(rotation[:, 2], [0.0, 0.0, 1.0])
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return rotation
    return rotation_matrix(np.arcsin(min(1.0, sine)) / sine * axis) @ rotation
