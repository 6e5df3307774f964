"""Demonstrate Screwdriver: grip it in its leaning stand, right it in the hand, seat it, turn by strokes."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.driver_and_screw import BIT_LENGTH, HANDLE_LENGTH
from lerobot_dexflex.envs.screwdriver import ScrewdriverEnv
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.reach.operator import FRICTION_SHARE
from lerobot_dexflex.experts.tool.grip import Grip, Handle, grip_handle
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.screwing import UP, Screw, Strokes, aligned, grasp_again, insert, turn
from lerobot_dexflex.experts.tool.script import Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.objects import ObjectSpec

GRASP_CENTRE = np.array([-0.0405, -0.0353, -0.1301])
"""Point on the handle's axis between the pads, palm frame [m]; the handle runs along palm y in the end."""
HAND_TOUCH = np.array(
    (
        *(1.519, 0.004, 0.368, -0.316),
        *(1.518, -0.024, 0.367, -0.315),
        *(1.524, -0.053, 0.354, -0.307),
        *(1.755, 0.002, 0.386, -0.385),
    )
)
"""All four pads on a handle of 12 mm radius [rad]: where the search for a grip begins."""
HAND_IDLE = np.array((0.3, 0.0, 0.3, 0.3) * 3 + (1.6, 0.2, 0.8, -0.2))
"""Fingers that take no part are stretched out [rad]."""
ALONG = np.array([0.043, 0.0, -0.043, 0.018])
"""Where the pads are along the handle, from the middle finger toward the index [m]."""
AXIS = np.array([0.0, 1.0, 0.0])
"""Along which the handle stands in the level palm."""
PALM_FORWARD = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Orientation of the level palm: fingers away from the robot, the index on top."""
ARM_FORWARD = (0.0, 0.56, 0.05, 0.63, 3.2, 1.5, -1.6)
"""Seed with the flange pointing forward [rad]."""
TRIES = 3
"""How often the operator grasps again and turns on where the driver or the screw did not stay."""
GRASP_AT = 0.068
"""Where along the handle the middle finger grips, above its lower end [m]."""
TURNING = (0, 1, 3)
"""The fingers that turn the driver; the ring finger would slip past the handle's end."""
FOUR_FINGERS = 0.4
"""How often the ring finger helps until the fingers grasp again."""
ROOM = 0.024
"""How far from the handle the open pads are [m]."""
PADS_TURNED, PADS_TURN = np.array([-0.175, -0.175, -0.175, 0.375]), -0.45
"""How the pads are turned about the handle in the middle of a stroke [rad], and that they turn the other way,
by this share, when they roll it: fingers bend."""
STROKES = Strokes(angle=1.4, most=12, room=0.012, room_back=0.012, squeeze=3.0, ahead=0.4, press=0.007)
"""Long strokes; the bit slips in the screw while it is not pressed, so that the pads may stay near."""


def demonstrate(env: ScrewdriverEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of driver and screw. The caller executes `Command.executed` before it asks
    for the next command.
    """
    episode = env.episode
    shape = ObjectSpec("cylinder", (episode.handle_radius, HANDLE_LENGTH / 2), episode.mass)
    middle, at = np.array([0.0, 0.0, HANDLE_LENGTH / 2]), np.array([0.0, 0.0, GRASP_AT])
    senses = ToolSenses(env, Tool("driver", shape, middle, episode.tip_friction))
    hand = OperatorHand(senses, env.command[7:], rng, rng.uniform(*MARGIN))
    script = Script(env, hand, rng, GRASP_CENTRE)
    position, rotation = env.driver_pose
    grasp_point, palm = position + rotation @ at, _toward(position)
    handle = Handle(GRASP_CENTRE, palm.T @ rotation[:, 2], episode.handle_radius)
    grip = _grip(handle, fingers=(0, 1, 2, 3) if rng.random() < FOUR_FINGERS else TURNING)

    script.care = 0.5
    hand.go(grip.open, 22)
    yield from script.swing(grasp_point + 0.09 * palm[:, 2], palm, 26, ARM_FORWARD)
    script.care = 0.2
    yield from script.take(grip, grasp_point, palm, 15)
    yield from script.glide(script.position + 0.06 * rotation[:, 2], palm, 12)
    straight = aligned(script.in_palm(*env.driver_pose).rotation, AXIS)
    held = Pose(GRASP_CENTRE - straight @ at, straight)
    hand.lead(*held)
    yield from script.glide(script.position + np.array([0, 0, 0.03]), palm, 8)

    script.care = 0.5
    palm = _toward(env.goal_position)
    above = script.palm_for(held, env.goal_position + np.array([0, 0, 0.035]), palm @ straight)
    yield from script.swing(*above, 26, ARM_FORWARD)
    yield from script.wait(lambda: hand.there, 20)
    hand.keep()
    script.care = 0.08
    goal = env.goal_position
    yield from insert(script, lambda: env.driver_pose, goal, palm, BIT_LENGTH, lambda: env.seated)
    if env.seated:
        screw = Screw(
            lambda: env.driver_pose,
            AXIS,
            GRASP_AT,
            episode.handle_radius,
            lambda: env.turns,
            lambda: env.tight,
            lambda: env.goal_position,
        )
        hand.squeeze(STROKES.squeeze, FRICTION_SHARE)
        for _ in range(TRIES):
            yield from turn(script, screw, _grip, STROKES)
            hand.keep()
            yield from script.hold(10)
            yield from grasp_again(script, screw, _grip, STROKES, 0.0)
            yield from script.hold(12)


def _grip(handle: Handle, back: float = 0.0, room: float = ROOM, fingers: tuple[int, ...] = TURNING) -> Grip:
    """Return the grip of a handle whose fingers have rolled it back by an angle [rad] from their middle."""
    around = -PADS_TURNED + PADS_TURN * back
    beside = np.array([0.0, 0.0, 0.0, 0.002]) - handle.radius * (1 - PADS_TURN) * back
    push = np.array([-1.0, 0.0, 0.0])
    return grip_handle(handle, ALONG, push, fingers, HAND_TOUCH, HAND_IDLE, room, around, beside)


def _toward(position: Array) -> Array:
    """Return the orientation (3, 3) of a level palm that faces a place [m] (3,), seen from the robot."""
    return rotation_matrix(np.arctan2(position[1], position[0]) * UP) @ PALM_FORWARD
