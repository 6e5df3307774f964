"""A precision grasp holds: the property every contact-rich result rests on."""

import mujoco
import numpy as np

from lerobot_dexflex.hand import xarm7
from lerobot_dexflex.hand.model import SUBSTEPS, WORLD_COLLISION, add_arm, add_hand, base_spec
from lerobot_dexflex.hands import LEAP

RADIUS, HALF_LENGTH, MASS = 0.013, 0.06, 0.100
CENTRE = np.array([-0.0405, -0.0353, -0.1401])
"""Where the cylinder's axis is, which lies along palm y, palm frame [m]."""
TOUCH = np.array(
    (
        *(1.519, 0.004, 0.368, -0.316),
        *(1.518, -0.024, 0.367, -0.315),
        *(1.524, -0.053, 0.354, -0.307),
        *(1.755, 0.002, 0.386, -0.385),
    )
)
"""All four pads flat on it [rad]."""
SQUEEZE = np.array(
    (
        *(1.865, 0.004, 0.043, -0.328),
        *(1.864, -0.022, 0.043, -0.328),
        *(1.865, -0.048, 0.041, -0.327),
        *(1.754, 0.003, 0.725, -0.242),
    )
)
"""Fingers 20 mm and thumb 50 mm into it [rad]: the thumb must balance three fingers."""
SWING = np.array([0.3, 0.15, 0.3, -0.2, 0.4, 0.3, 0.6])
"""Amplitude of the arm motion [rad]; at 0.15 Hz the hand moves with up to about 0.6 m/s."""


def held_cylinder():
    """Close the hand on a fixed 100 g cylinder, then let the cylinder go."""
    spec = base_spec()
    add_hand(spec, add_arm(spec), LEAP)
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint(name="object")
    contype, conaffinity = WORLD_COLLISION
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(RADIUS, HALF_LENGTH, 0),
        mass=MASS,
        contype=contype,
        conaffinity=conaffinity,
        condim=4,
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:23] = data.ctrl[:] = [*xarm7.HOME, *TOUCH]
    mujoco.mj_kinematics(model, data)
    palm = data.body("palm").xmat.reshape(3, 3)
    # The cylinder's axis lies along palm y.
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, (palm @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])).ravel())
    pose = np.concatenate([data.body("palm").xpos + palm @ CENTRE, quaternion])
    for k in range(15):
        data.ctrl[7:] = TOUCH + (k + 1) / 15 * (SQUEEZE - TOUCH)
        for _ in range(SUBSTEPS):
            data.joint("object").qpos[:] = pose
            data.joint("object").qvel[:] = 0
            mujoco.mj_step(model, data)
    mujoco.mj_step(model, data, 250)
    return model, data


def in_palm(data) -> np.ndarray:
    palm = data.body("palm")
    return palm.xmat.reshape(3, 3).T @ (data.body("object").xpos - palm.xpos)


def test_a_still_grasp_of_100_g_keeps_the_object_within_a_millimetre_for_ten_seconds():
    model, data = held_cylinder()
    start = in_palm(data)
    mujoco.mj_step(model, data, round(10 / model.opt.timestep))
    assert np.linalg.norm(in_palm(data) - start) < 1e-3


def test_slow_arm_motion_moves_the_object_in_the_hand_by_less_than_three_millimetres():
    model, data = held_cylinder()
    start, begin, worst = in_palm(data), data.time, 0.0
    while (t := data.time - begin) < 10:
        fade = min(1, t) * min(1, 10 - t)
        data.ctrl[:7] = np.array(xarm7.HOME) + fade * SWING * np.sin(2 * np.pi * 0.15 * t)
        mujoco.mj_step(model, data, SUBSTEPS)
        worst = max(worst, float(np.linalg.norm(in_palm(data) - start)))
    assert np.abs(data.qvel[:7]).max() < 1
    assert worst < 3e-3
