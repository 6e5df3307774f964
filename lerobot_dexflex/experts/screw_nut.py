"""Demonstrate ScrewNut: grip the nut as it rests askew, right it in the hand, turn it tight by strokes."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.nut_and_bolt import RIM
from lerobot_dexflex.envs.screw_nut import ARM_START, ScrewNutEnv
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.grip import Handle
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.holds import BAR_RADIUS
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.screwing import (
    UP,
    Screw,
    Strokes,
    aligned,
    grasp_again,
    insert,
    turn,
)
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.objects import ObjectSpec

STROKES = Strokes(angle=0.7, most=14, room=0.02, room_back=0.012, squeeze=5.0, ahead=0.3)
"""As long as the fingers reach; the thread holds while they go back."""
TRIES = 3
"""How often the operator tries to set the nut straight on the bolt."""
SLID = 0.01
"""The fingers grasp again before they turn, if they are so far from where they should hold the nut [m]."""
LIFT = 0.02
"""How far the nut is lifted off the bolt, to right it in the hand [m]."""


def demonstrate(env: ScrewNutEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of nut and bolt, and whether the thread has caught. The caller executes
    `Command.executed` before it asks for the next command.
    """
    episode, holds = env.episode, holds_of(env.hand)
    shape = ObjectSpec("cylinder", (episode.nut_radius, episode.nut_height / 2), episode.mass)
    at = RIM + episode.nut_height / 2
    senses = ToolSenses(env, Tool("nut", shape, np.array([0.0, 0.0, at]), episode.tip_friction))
    hand = OperatorHand(senses, env.command, rng, rng.uniform(*MARGIN), holds.frame)
    habit = holds.habits[int(rng.integers(2))]
    centre = habit.centre + np.array([episode.nut_radius - BAR_RADIUS, 0.0, 0.0])  # The thumb keeps its room.
    script = Script(env, hand, rng, centre)
    position, rotation = env.nut_pose
    grasp_point = position + at * rotation[:, 2]
    grip = habit.grip(Handle(centre, PALM_DOWN.T @ rotation[:, 2], episode.nut_radius))
    nut = Screw(
        lambda: env.nut_pose,
        UP,
        at,
        episode.nut_radius,
        lambda: env.turns,
        lambda: env.tight,
        lambda: env.goal_position,
    )

    script.care = 0.5
    hand.go(grip.open, 22)
    yield from script.swing(grasp_point + np.array([0, 0, 0.07]), PALM_DOWN, 26, ARM_START)
    script.care = 0.1
    yield from script.take(grip, grasp_point, PALM_DOWN, 18)
    yield from _set_on_bolt(env, script, centre, at)
    if env.caught:
        seat = env.goal_position + at * UP
        if np.linalg.norm(script.position - seat) > SLID:  # The thread caught it while it was lifted.
            upright = habit.grip(Handle(centre, UP, episode.nut_radius))
            yield from script.let_go(upright, 8)
            yield from script.take(upright, seat, PALM_DOWN, 10)
        yield from script.glide(seat, PALM_DOWN, 4)
        yield from turn(script, nut, habit.grip, STROKES)
        hand.keep()
        yield from script.hold(12)
        yield from grasp_again(script, nut, habit.grip, STROKES, 0.0)
    yield from script.hold(15)


def _set_on_bolt(env: ScrewNutEnv, script: Script, centre: Array, at: float) -> Iterator[Command]:
    """Lift the gripped nut, right it in the hand and put it back, until the thread catches it.

    Args:
        env: The environment.
        script: Moves the hand.
        centre: Where the nut is held, working frame [m]. Shape (3,).
        at: Where along its axis it is held [m].
    """
    hand = script.hand
    for _ in range(TRIES):
        if env.caught:  # Fingers that close may right it, too.
            return
        yield from script.glide(script.position + np.array([0, 0, LIFT]), PALM_DOWN, 6)
        straight = aligned(script.in_palm(*env.nut_pose).rotation, UP)
        hand.lead(centre - at * UP, straight)
        yield from script.wait(lambda: env.caught or hand.there, 30)
        hand.keep()
        if not env.caught:
            goal = env.goal_position
            yield from insert(
                script, lambda: env.nut_pose, goal, PALM_DOWN, 0.0, lambda: env.caught, pressing=2
            )
