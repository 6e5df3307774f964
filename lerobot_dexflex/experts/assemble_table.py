"""Demonstrate AssembleTable: grip the leaning leg, right it in the hand, insert, screw with the fingers."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.assemble_table import ARM_START, AssembleTableEnv
from lerobot_dexflex.envs.leg_and_socket import LEG_LENGTH, STUD_LENGTH
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.experts.tool.grip import Handle
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.screwing import UP, Screw, Strokes, aligned, insert, turn
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.objects import ObjectSpec

GRASP_AT = 0.087
"""Where along the leg the hand grips, above the shaft's lower end [m]."""
STROKES = Strokes(angle=0.6, most=10, room=0.03, room_back=0.016, squeeze=6.0)
"""The leg must not be turned back between strokes: the pads leave it by 3 cm."""


def demonstrate(env: AssembleTableEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of leg and socket, and whether the thread has caught. The caller executes
    `Command.executed` before it asks for the next command.
    """
    episode, holds = env.episode, holds_of(env.hand)
    habit = holds.habits[int(episode.lean > 0)]
    shape = ObjectSpec("cylinder", (episode.leg_radius, LEG_LENGTH / 2), episode.mass)
    at = np.array([0.0, 0.0, GRASP_AT])
    senses = ToolSenses(env, Tool("leg", shape, np.array([0.0, 0.0, LEG_LENGTH / 2]), episode.tip_friction))
    hand = OperatorHand(senses, env.command, rng, rng.uniform(*MARGIN), holds.frame)
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
    straight = aligned(script.in_palm(*env.leg_pose).rotation, UP)
    held = Pose(habit.centre - straight @ at, straight)
    hand.lead(*held)
    yield from script.glide(script.position + np.array([0, 0, 0.05]), PALM_DOWN, 14)

    script.care = 0.5
    above = script.palm_for(held, env.goal_position + np.array([0, 0, 0.035]), PALM_DOWN @ straight)
    yield from script.swing(*above, 30, ARM_START)
    yield from script.wait(lambda: hand.there, 20)
    hand.keep()
    script.care = 0.08
    yield from insert(
        script, lambda: env.leg_pose, env.goal_position, PALM_DOWN, STUD_LENGTH, lambda: env.caught
    )
    if env.caught:
        radius = episode.leg_radius
        leg = Screw(lambda: env.leg_pose, UP, GRASP_AT, radius, lambda: env.turns, lambda: env.lit)
        yield from turn(script, leg, habit.grip, STROKES)
    script.care = 0.3
    hand.let_go()
    upright = habit.grip(Handle(habit.centre, UP, episode.leg_radius))
    yield from script.move_hand(upright.open, 8)
    hand.relax(25, after=5)
    yield from script.glide(script.position + np.array([0, 0, 0.12]), script.rotation, 17)
    yield from script.hold(15)
