"""Demonstrate Screwdriver: grip it in its leaning stand, right it in the hand, seat it, turn by strokes."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from lerobot_dexflex.envs.driver_and_screw import BIT_LENGTH, HANDLE_LENGTH
from lerobot_dexflex.envs.screwdriver import ScrewdriverEnv
from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.reach.operator import FRICTION_SHARE
from lerobot_dexflex.experts.tool.grip import Handle, all_fingers, without
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.screwing import UP, Screw, Strokes, aligned, grasp_again, insert, turn
from lerobot_dexflex.experts.tool.script import Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.objects import ObjectSpec

AXIS = np.array([0.0, 1.0, 0.0])
"""Along which the handle stands in the working frame."""
PALM_FORWARD = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Orientation of the working frame: reaching away from the robot, the first finger on top."""
ARM_FORWARD = (0.0, 0.56, 0.05, 0.63, 3.2, 1.5, -1.6)
"""Seed with the flange pointing forward [rad]."""
TRIES = 3
"""How often the operator grasps again and turns on where the driver or the screw did not stay."""
GRASP_AT = 0.068
"""Where along the handle the middle finger grips, above its lower end [m]."""
ALL_FINGERS = 0.4
"""How often all fingers help until they grasp again; else, and then, the last that does not oppose is out: it
would slip past the handle's end."""
STROKES = Strokes(angle=1.4, most=12, room=0.012, room_back=0.012, squeeze=3.0, ahead=0.4, press=0.007)
"""Long strokes; the bit slips in the screw while it is not pressed, so that the pads may stay near."""


def demonstrate(env: ScrewdriverEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of driver and screw. The caller executes `Command.executed` before it asks
    for the next command.
    """
    episode, holds = env.episode, holds_of(env.hand)
    hold = holds.driver.bar
    strokes = STROKES._replace(angle=holds.driver.stroke)
    shape = ObjectSpec("cylinder", (episode.handle_radius, HANDLE_LENGTH / 2), episode.mass)
    middle, at = np.array([0.0, 0.0, HANDLE_LENGTH / 2]), np.array([0.0, 0.0, GRASP_AT])
    senses = ToolSenses(env, Tool("driver", shape, middle, episode.tip_friction))
    hand = OperatorHand(senses, env.command, rng, rng.uniform(*MARGIN), holds.frame)
    script = Script(env, hand, rng, hold.centre)
    position, rotation = env.driver_pose
    grasp_point, palm = position + rotation @ at, _toward(position)
    handle = Handle(hold.centre, palm.T @ rotation[:, 2], episode.handle_radius)
    fingers = all_fingers(env.hand) if rng.random() < ALL_FINGERS else without(env.hand, -1)
    grip = holds.driver.grip(fingers, handle)

    script.care = 0.5
    hand.go(grip.open, 22)
    yield from script.swing(grasp_point + hold.approach * palm[:, 2], palm, 26, ARM_FORWARD)
    script.care = 0.2
    yield from script.take(grip, grasp_point, palm, 15)
    yield from script.glide(script.position + 0.06 * rotation[:, 2], palm, 12)
    straight = aligned(script.in_palm(*env.driver_pose).rotation, AXIS)
    held = Pose(hold.centre - straight @ at, straight)
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
        turning = partial(holds.driver.grip, without(env.hand, -1))
        for _ in range(TRIES):
            yield from turn(script, screw, turning, strokes)
            hand.keep()
            yield from script.hold(10)
            yield from grasp_again(script, screw, turning, strokes, 0.0)
            yield from script.hold(12)


def _toward(position: Array) -> Array:
    """Return the orientation (3, 3) of a level palm that faces a place [m] (3,), seen from the robot."""
    return rotation_matrix(np.arctan2(position[1], position[0]) * UP) @ PALM_FORWARD
