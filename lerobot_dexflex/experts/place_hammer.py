"""Demonstrate PlaceHammer: grip the handle as it lies, turn it straight in the hand, hang it, let go."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.hammer import ARM_START, HANDLE_HALF_LENGTH
from lerobot_dexflex.envs.place_hammer import PlaceHammerEnv
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.bar import HELD, pick_up
from lerobot_dexflex.experts.tool.grip import all_fingers, without
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.objects import ObjectSpec

ARM_FORWARD = (0.0, 0.40, 0.0, 0.75, 0.0, -1.2, np.pi / 2)
"""Planar seed with the flange pointing forward [rad]."""
HAMMER_UPRIGHT = np.array([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]])
"""Orientation of the hanging hammer: head up, the hand reaching for the holder."""
GRASP_AT = 0.006
"""Where along the handle the hand grips, from its centre toward the head [m]."""
ALL_FINGERS = 0.6
"""How often all fingers take part; else the last that does not oppose is out."""


def demonstrate(env: PlaceHammerEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of hammer and holder. The caller executes `Command.executed` before it
    asks for the next command.
    """
    episode, holds = env.episode, holds_of(env.hand)
    hold = holds.bar
    shape = ObjectSpec("cylinder", (episode.handle_radius, HANDLE_HALF_LENGTH), episode.mass)
    senses = ToolSenses(env, Tool("hammer", shape, np.zeros(3), episode.tip_friction))
    hand = OperatorHand(senses, env.command, rng, rng.uniform(*MARGIN), holds.frame)
    script = Script(env, hand, rng, hold.centre)
    position, rotation = env.hammer_pose
    grasp_point = position + rotation @ np.array([0.0, 0.0, GRASP_AT])
    held = Pose(hold.centre - GRASP_AT * HELD[:, 2], HELD)
    askew = PALM_DOWN.T @ rotation[:, 2]
    fingers = all_fingers(env.hand) if rng.random() < ALL_FINGERS else without(env.hand, -1)
    grip = hold.grip(askew, episode.handle_radius, fingers)

    yield from pick_up(script, grip, grasp_point, held, ARM_START)
    yield from script.glide(script.position + np.array([0, 0, 0.08]), PALM_DOWN, 14)

    script.care = 0.6
    goal = env.goal_position
    via = np.array([0.49, goal[1], goal[2] + 0.03])
    yield from script.swing(*script.palm_for(held, via, HAMMER_UPRIGHT), 34, ARM_FORWARD)
    yield from script.wait(lambda: hand.there, 20)

    def palm_for(goal: Array) -> Pose:
        return script.palm_for(script.in_palm(*env.hammer_pose), goal, HAMMER_UPRIGHT)

    yield from script.swing(*palm_for(goal + np.array([-0.11, 0, 0.012])), 20, ARM_FORWARD)
    script.care = 0.16
    yield from script.glide(*palm_for(goal + np.array([-0.11, 0, 0.012])), 6)
    yield from script.glide(*palm_for(goal + np.array([-0.002, 0, 0.010])), 22)
    yield from script.glide(*palm_for(goal + np.array([-0.002, 0, -0.001])), 11)
    straight = hold.grip(np.array([0.0, 1.0, 0.0]), episode.handle_radius, fingers)
    yield from script.let_go(straight, 9)
    hand.relax(25, after=5)
    yield from script.glide(script.position + 0.13 * script.rotation[:, 2], script.rotation, 17)
    yield from script.hold(15)
