"""Small scenes for the tests of cameras, and measures of how much two pictures differ."""

import mujoco
import numpy as np

from lerobot_dexflex.envs.rendering import tune_visuals
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.touch import add_touch
from lerobot_dexflex.hands import LEAP

SHAPES = (
    (mujoco.mjtGeom.mjGEOM_BOX, (0.03, 0.02, 0.05)),
    (mujoco.mjtGeom.mjGEOM_CYLINDER, (0.03, 0.05, 0)),
    (mujoco.mjtGeom.mjGEOM_CAPSULE, (0.02, 0.04, 0)),
    (mujoco.mjtGeom.mjGEOM_SPHERE, (0.03, 0, 0)),
    (mujoco.mjtGeom.mjGEOM_ELLIPSOID, (0.03, 0.045, 0.02)),
)


def hand_scene(scale=1.0, touch=True, camera_height=0.5):
    """The arm and hand over a floor with five coloured shapes, seen by the camera `front`."""
    spec = robot.base_spec()
    robot.add_hand(spec, robot.add_arm(spec), LEAP)
    if touch:
        add_touch(spec, LEAP)
    tune_visuals(spec)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(2, 2, 0.1), rgba=(0.3, 0.3, 0.4, 1))
    for k, (kind, size) in enumerate(SHAPES):
        spec.worldbody.add_geom(
            type=kind,
            size=scale * np.array(size),
            pos=(0.35 + 0.1 * (k % 2), -0.24 + 0.12 * k, 0.06),
            quat=(1, 0.1 * k, 0.2, 0.1),
            rgba=(0.8, 0.2 * k, 0.3, 1),
        )
    spec.worldbody.add_camera(name="front", pos=(1.0, 0, camera_height), xyaxes=(0, 1, 0, -0.5, 0, 0.8))
    return ready(spec)


def flat_scene(fovy=90.0, **geom):
    """One geom seen from 1 m straight above; the image's right is +x, its top +y."""
    spec = mujoco.MjSpec()
    tune_visuals(spec)
    spec.worldbody.add_camera(name="top", pos=(0, 0, 1), fovy=fovy)
    spec.worldbody.add_geom(name="thing", **geom)
    return spec


def ready(spec):
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def mean_difference(a, b):
    return np.abs(a.astype(int) - b).mean()


def share_off(a, b):
    return (np.abs(a.astype(int) - b).max(axis=-1) > 8).mean()
