"""Demonstrate PlaceHammer: grip the handle as it lies, turn it straight in the hand, hang it, let go."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.hammer import ARM_START, HANDLE_HALF_LENGTH
from lerobot_dexflex.envs.place_hammer import PlaceHammerEnv
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.grip import Grip, Handle, grip_handle
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.objects import ObjectSpec

GRASP_CENTRE = np.array([-0.0405, -0.0353, -0.1401])
"""Point on the handle's axis between the pads, palm frame [m]; the handle runs along palm y in the end."""
HAND_TOUCH = np.array(
    (
        *(1.519, 0.004, 0.368, -0.316),
        *(1.518, -0.024, 0.367, -0.315),
        *(1.524, -0.053, 0.354, -0.307),
        *(1.755, 0.002, 0.386, -0.385),
    )
)
"""All four pads flat on a handle of 13 mm radius [rad]: where the search for a grip begins."""
HAND_IDLE = np.array((0.3, 0.0, 0.3, 0.3) * 3 + (1.6, 0.2, 0.8, -0.2))
"""Fingers that take no part are stretched out [rad]."""
ALONG = np.array([0.043, 0.0, -0.043, 0.012])
"""Where the pads are along the handle, from the middle finger toward the index [m]."""
HELD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Orientation of the hammer in the palm once it is straight: its handle along palm y, head at the index."""
ARM_FORWARD = (0.0, 0.40, 0.0, 0.75, 0.0, -1.2, np.pi / 2)
"""Planar seed with the flange pointing forward [rad]."""
HAMMER_UPRIGHT = np.array([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]])
"""Orientation of the hanging hammer: head up, palm facing the holder."""
GRASP_AT = 0.006
"""Where along the handle the hand grips, from its centre toward the head [m]."""
ROOM = 0.024
"""How far from the handle the open pads are [m]."""
FOUR_FINGERS = 0.6
"""How often the ring finger takes part."""


def demonstrate(env: PlaceHammerEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of hammer and holder. The caller executes `Command.executed` before it
    asks for the next command.
    """
    episode = env.episode
    shape = ObjectSpec("cylinder", (episode.handle_radius, HANDLE_HALF_LENGTH), episode.mass)
    senses = ToolSenses(env, Tool("hammer", shape, np.zeros(3), episode.tip_friction))
    hand = OperatorHand(senses, env.command[7:], rng, rng.uniform(*MARGIN))
    script = Script(env, hand, rng, GRASP_CENTRE)
    position, rotation = env.hammer_pose
    grasp_point = position + rotation @ np.array([0.0, 0.0, GRASP_AT])
    held = Pose(GRASP_CENTRE - GRASP_AT * HELD[:, 2], HELD)
    askew = PALM_DOWN.T @ rotation[:, 2]
    fingers = (0, 1, 2, 3) if rng.random() < FOUR_FINGERS else (0, 1, 3)
    grip = grip_hammer(askew, episode.handle_radius, fingers)

    hand.go(grip.open, 20)
    yield from script.swing(grasp_point + np.array([0, 0, 0.08]), PALM_DOWN, 22, ARM_START)
    script.care = 0.2
    yield from script.take(grip, grasp_point, PALM_DOWN, 15)
    yield from script.glide(script.position + np.array([0, 0, 0.02]), PALM_DOWN, 6)
    hand.lead(*held)
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
    straight = grip_hammer(np.array([0.0, 1.0, 0.0]), episode.handle_radius, fingers)
    yield from script.let_go(straight, 9)
    hand.relax(25, after=5)
    yield from script.glide(script.position + 0.13 * script.rotation[:, 2], script.rotation, 17)
    yield from script.hold(15)


def grip_hammer(axis: Array, radius: float, fingers: tuple[int, ...]) -> Grip:
    """Return the grip of a handle whose axis in the palm frame is (3,), its radius [m]."""
    handle = Handle(GRASP_CENTRE, axis, radius)
    return grip_handle(handle, ALONG, np.array([-1.0, 0, 0]), fingers, HAND_TOUCH, HAND_IDLE, ROOM)
