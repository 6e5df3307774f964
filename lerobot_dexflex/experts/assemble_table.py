"""Demonstrate AssembleTable: grip the leaning leg, right it in the hand, insert, screw with the fingers."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lerobot_dexflex.envs.assemble_table import ARM_START, AssembleTableEnv
from lerobot_dexflex.envs.leg_and_socket import LEG_LENGTH, STUD_LENGTH
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.reach.operator import FRICTION_SHARE
from lerobot_dexflex.experts.tool.grip import Grip, Handle, grip_handle
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.objects import ObjectSpec

_IDLE = (0.6, -0.3, 0.3, 0.3)
_THUMB = (1.369, -0.068, 0.912, -0.924)


class Habit(NamedTuple):
    """Thumb opposite a shallow V of two neighbouring fingers."""

    fingers: tuple[int, ...]
    """Which take part, as indices into `FINGERS`."""
    centre: Array
    """Point on the leg's axis between the pads, palm frame [m]; the leg runs along palm z in the end."""
    touch: Array
    """The pads on a leg of 12 mm radius [rad] (16,): where the search for a grip begins."""

    def grip(self, leg: Handle, turn: float = 0.0, room: float = 0.016) -> Grip:
        """Return the grip of a leg with all fingers turned about it by `turn` [rad]."""
        first = self.fingers[0]
        around = np.roll([0.29, -0.155, 0.0, 0.0], first) + np.array([0.0, 0.0, 0.0, 0.069])
        beside = np.roll([-0.0105, 0.0105, 0.0, 0.0], first)  # Of the pads' middles.
        beside[3] = THUMB_SHIFT * turn
        push = np.array([-1.0, 0.0, 0.0])
        return grip_handle(
            leg, np.zeros(4), push, self.fingers, self.touch, self.touch, room, around + turn, beside
        )


HABITS = (
    Habit(
        (0, 1, 3),
        np.array([-0.0230, 0.0242, -0.1247]),
        np.array((1.066, -0.533, 0.917, -0.316, 1.752, -0.630, -0.457, 0.194, *_IDLE, *_THUMB)),
    ),
    Habit(
        (1, 2, 3),
        np.array([-0.0230, -0.0212, -0.1247]),
        np.array((*_IDLE, 1.066, -0.533, 0.917, -0.316, 1.752, -0.630, -0.457, 0.194, *_THUMB)),
    ),
)
"""How legs are held: those that lean toward the robot between thumb, index and middle, others beside them."""
GRASP_AT = 0.087
"""Where along the leg the hand grips, above the shaft's lower end [m]."""
STROKE = 0.6
"""How far the fingers turn the leg before they grasp again [rad]."""
ROOM = 0.03
"""How far the pads leave the leg between strokes [m]: the leg must not be turned back."""
THUMB_SHIFT = -0.03
"""By how much the thumb's pad is moved aside per turn of the grip [m/rad]: it rolls on the leg."""
LEAST_TURN = 0.01
"""Turns in 8 steps below which a stroke has come to its end."""
SCREW_PRELOAD = 6.0
"""Squeeze while screwing [N]: the thread resists."""
STROKES = 10
"""After so many the operator gives up."""


def demonstrate(env: AssembleTableEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of leg and socket, and whether the thread has caught. The caller executes
    `Command.executed` before it asks for the next command.
    """
    episode = env.episode
    shape = ObjectSpec("cylinder", (episode.leg_radius, LEG_LENGTH / 2), episode.mass)
    at = np.array([0.0, 0.0, GRASP_AT])
    senses = ToolSenses(env, Tool("leg", shape, np.array([0.0, 0.0, LEG_LENGTH / 2]), episode.tip_friction))
    hand = OperatorHand(senses, env.command[7:], rng, rng.uniform(*MARGIN))
    habit = HABITS[int(episode.lean > 0)]
    script = Script(env, hand, rng, habit.centre)
    position, rotation = env.leg_pose
    grasp_point = position + rotation @ at
    grip = habit.grip(Handle(habit.centre, PALM_DOWN.T @ rotation[:, 2], episode.leg_radius))

    script.care = 0.5
    hand.go(grip.open, 22)
    yield from script.swing(grasp_point + np.array([0, 0, 0.07]), PALM_DOWN, 26, ARM_START)
    script.care = 0.12
    yield from script.take(grip, grasp_point, PALM_DOWN, 18)
    yield from script.glide(script.position + 0.03 * rotation[:, 2], PALM_DOWN, 8)
    straight = _made_upright(script.in_palm(*env.leg_pose).rotation)
    held = Pose(habit.centre - straight @ at, straight)
    hand.lead(*held)
    yield from script.glide(script.position + np.array([0, 0, 0.05]), PALM_DOWN, 14)

    script.care = 0.5
    above = script.palm_for(held, env.goal_position + np.array([0, 0, 0.035]), PALM_DOWN @ straight)
    yield from script.swing(*above, 30, ARM_START)
    yield from script.wait(lambda: hand.there, 20)
    hand.keep()
    script.care = 0.08
    yield from _insert(env, script)
    yield from _screw(env, script, habit)
    script.care = 0.3
    hand.let_go()
    upright = habit.grip(Handle(habit.centre, np.array([0.0, 0.0, 1.0]), episode.leg_radius))
    yield from script.move_hand(upright.open, 8)
    hand.relax(25, after=5)
    yield from script.glide(script.position + np.array([0, 0, 0.12]), script.rotation, 17)
    yield from script.hold(15)


def _insert(env: AssembleTableEnv, script: Script, steps: int = 60, pressing: int = 6) -> Iterator[Command]:
    """Lower the stud into the socket, steered by its measured tip, until the thread has caught it safely.

    Pressing on for a few steps lets also those who repeat the motion less exactly catch the thread.
    """
    held = script.in_palm(*env.leg_pose)
    upright = _made_upright(PALM_DOWN @ held.rotation)
    above = env.goal_position + np.array([0, 0, 0.035])
    yield from script.glide(*script.palm_for(held, above, upright), 8)
    correction = np.zeros(3)
    for k in range(1, steps + 1):
        position, rotation = env.leg_pose
        beside = env.goal_position - (position - STUD_LENGTH * rotation[:, 2])
        if not env.caught:
            correction[:2] = np.clip(correction[:2] + 0.15 * beside[:2], -0.006, 0.006)
        height = np.array([0, 0, max(0.035 - 0.0015 * k, -0.006)])
        yield script.step(*script.palm_for(held, env.goal_position + height + correction, upright))
        pressing -= env.caught
        if pressing < 0:
            return


def _screw(env: AssembleTableEnv, script: Script, habit: Habit) -> Iterator[Command]:
    """Turn the leg clockwise with the fingers, stroke by stroke, until it lights."""
    hand, radius = script.hand, env.episode.leg_radius
    stroke = STROKE / 2
    for _ in range(STROKES if env.caught else 0):
        held = script.in_palm(*env.leg_pose)
        hand.lead(held.position, _about_z(-stroke) @ held.rotation)
        yield from _turn(env, script, env.turns + 0.9 * stroke / (2 * np.pi))
        if env.lit:
            yield from script.hold(4)
            return
        axis = script.in_palm(*env.leg_pose)
        centre = axis.position + axis.rotation @ np.array([0, 0, GRASP_AT])
        handle = Handle(centre, axis.rotation[:, 2], radius)
        end, begin = habit.grip(handle, room=ROOM), habit.grip(handle, STROKE / 2)
        hand.let_go()
        for joints, steps in ((end.open, 5), (begin.open, 6), (begin.touch, 6)):
            yield from script.move_hand(joints, steps)
        hand.grip(begin, SCREW_PRELOAD, FRICTION_SHARE)
        yield from script.wait(lambda: hand.gripped, 5)
        stroke = STROKE


def _turn(env: AssembleTableEnv, script: Script, goal: float, patience: int = 8) -> Iterator[Command]:
    """Let the fingers turn the leg until it lights or has so many turns, or until it turns no more."""
    since = last = env.turns
    for k in range(1, 31):
        yield from script.hold(1)
        last = env.turns
        if env.lit or last > goal:
            return
        if k % patience == 0:
            if last - since < LEAST_TURN:
                return
            since = last


def _about_z(angle: float) -> Array:
    return rotation_matrix(np.array([0.0, 0.0, angle]))


def _made_upright(rotation: Array) -> Array:
    """Return the orientation with z along the frame's z axis that is nearest to `rotation`."""
    axis = np.cross(rotation[:, 2], [0.0, 0.0, 1.0])
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return rotation
    return rotation_matrix(np.arcsin(min(1.0, sine)) / sine * axis) @ rotation
