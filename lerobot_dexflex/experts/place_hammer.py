"""Demonstrate PlaceHammer: three fingers against the thumb, a pure pitch of the wrist, hang, let go."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.place_hammer import ARM_START, HAND_OPEN, PlaceHammerEnv
from lerobot_dexflex.experts.command import Array, Command, fingertips_of
from lerobot_dexflex.experts.script import Pose, Script

GRASP_CENTRE = np.array([-0.0405, -0.0353, -0.1401])
"""Point on the handle axis between the four pads, palm frame [m]; the handle runs along palm y."""
HAND_TOUCH = (
    *(1.519, 0.004, 0.368, -0.316),
    *(1.518, -0.024, 0.367, -0.315),
    *(1.524, -0.053, 0.354, -0.307),
    *(1.755, 0.002, 0.386, -0.385),
)
"""All four pads flat on a handle of 13 mm radius [rad] (least squares of pad poses)."""
HAND_SQUEEZE = (
    *(1.865, 0.004, 0.043, -0.328),
    *(1.864, -0.022, 0.043, -0.328),
    *(1.865, -0.048, 0.041, -0.327),
    *(1.754, 0.003, 0.725, -0.242),
)
"""Fingers 20 mm and thumb 50 mm into the handle [rad]: the thumb must balance three fingers."""
ARM_FORWARD = (0.0, 0.40, 0.0, 0.75, 0.0, -1.2, np.pi / 2)
"""Planar seed with the flange pointing forward [rad]."""
HAMMER_UPRIGHT = np.array([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]])
"""Orientation of the hanging hammer: head up, palm facing the holder."""
GRASP_RANGE = (-0.012, -0.002)
"""Where along the handle the hand grips, from its centre toward the head [m]."""


def demonstrate(env: PlaceHammerEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of hammer and holder. The caller executes `Command.executed` before it
    asks for the next command.
    """
    script = Script(env, rng, GRASP_CENTRE)
    grasp_offset = rng.uniform(*GRASP_RANGE)
    position, rotation = env.hammer_pose
    grasp_rotation = rotation[:, [1, 2, 0]]  # palm x, y, z along the hammer's y, z, x
    grasp_point = position + rotation @ np.array([0.0, 0.0, grasp_offset])
    tips_open, tips_touch, tips_squeeze = map(fingertips_of, (HAND_OPEN, HAND_TOUCH, HAND_SQUEEZE))

    yield from script.swing(grasp_point + np.array([0, 0, 0.08]), grasp_rotation, 22, ARM_START)
    yield from script.glide(grasp_point, grasp_rotation, 15)
    yield from script.move_tips(tips_touch, 10)
    yield from script.move_tips(tips_squeeze, 11, steady=True)
    yield from script.glide(script.position + np.array([0, 0, 0.10]), script.rotation, 14)

    def palm_for(goal: Array) -> Pose:
        return script.palm_for(script.in_palm(*env.hammer_pose), goal, HAMMER_UPRIGHT)

    goal = env.goal_position
    via = np.array([0.49, goal[1], goal[2] + 0.03])
    yield from script.swing(*palm_for(via), 34, ARM_FORWARD)
    yield from script.swing(*palm_for(goal + np.array([-0.11, 0, 0.012])), 20, ARM_FORWARD)
    yield from script.glide(*palm_for(goal + np.array([-0.11, 0, 0.012])), 6)
    script.care = 0.4
    yield from script.glide(*palm_for(goal + np.array([-0.002, 0, 0.010])), 22)
    yield from script.glide(*palm_for(goal + np.array([-0.002, 0, -0.001])), 11)
    yield from script.move_tips(tips_touch, 8, steady=True)
    yield from script.move_tips(tips_open, 9)
    yield from script.glide(script.position + 0.13 * script.rotation[:, 2], script.rotation, 17)
    yield from script.glide(script.position, script.rotation, 15)
