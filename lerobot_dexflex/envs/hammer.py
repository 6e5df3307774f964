"""The hammer, and the cradle that it lies in: what PlaceHammer and HammerNail share."""

import mujoco
import numpy as np

from lerobot_dexflex.envs.scene import ContactSurface, add_block

ARM_START = (0.0, -0.35, 0.0, 0.95, 0.0, 1.3, np.pi / 2)
"""Arm at the start of an episode [rad]: the hand hovers behind the cradle, palm down."""
HANDLE_HALF_LENGTH = 0.08
HEAD_HALF_SIZE = (0.016, 0.04, 0.016)
HEAD_CENTRE = 0.095
"""Centre of the head along the handle axis, from the handle's centre [m]."""
CRADLE_HEIGHT = 0.05
"""Height of the handle axis in the cradle above the table [m]: room for the fingertips below it."""
CRADLE_BROWN = (0.45, 0.3, 0.18, 1)
_HANDLE_SHARE = 0.6
"""Share of the mass in the handle: less, and the hand could not carry the torque."""


def add_hammer(spec: mujoco.MjSpec, handle_radius: float, mass: float) -> None:
    """Add the free body `hammer` [m], [kg]: z along the handle to the head, which is longest along y."""
    surface = ContactSurface(condim=4)._asdict()
    body = spec.worldbody.add_body(name="hammer")
    body.add_freejoint(name="hammer")
    body.add_geom(
        name="hammer_handle",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(handle_radius, HANDLE_HALF_LENGTH, 0),
        mass=_HANDLE_SHARE * mass,
        rgba=(0.85, 0.55, 0.2, 1),
        **surface,
    )
    body.add_geom(
        name="hammer_head",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=HEAD_HALF_SIZE,
        pos=(0, 0, HEAD_CENTRE),
        mass=(1 - _HANDLE_SHARE) * mass,
        rgba=(0.75, 0.15, 0.15, 1),
        **surface,
    )


def add_cradle(
    spec: mujoco.MjSpec, pose: tuple[float, float, float], handle_radius: float, head_half_height: float
) -> mujoco.MjsBody:
    """Add the body `cradle`: a block under the head, and a rail under the handle's end.

    Args:
        spec: The spec to extend.
        pose: Position x, y [m] and yaw [rad]: the handle points away from the robot at yaw 0.
        handle_radius: Of the hammer [m].
        head_half_height: Half of the head's size along the vertical as it lies [m].
    """
    x, y, yaw = pose
    cradle = spec.worldbody.add_body(
        name="cradle", pos=(x, y, 0), quat=(np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    )
    block = (CRADLE_HEIGHT - head_half_height) / 2
    rail = (CRADLE_HEIGHT - handle_radius) / 2
    add_block(cradle, "cradle_head", (0.014, 0.03, block), (HEAD_CENTRE, 0, block), CRADLE_BROWN)
    add_block(cradle, "cradle_tail", (0.005, 0.02, rail), (-0.073, 0, rail), CRADLE_BROWN)
    return cradle


def lay_hammer(data: mujoco.MjData, position: tuple[float, float], rotation: np.ndarray) -> None:
    """Lay the hammer at the height of its cradle.

    Args:
        data: Of a scene with a hammer.
        position: Centre of the handle, x and y [m].
        rotation: Orientation of the hammer. Shape (3, 3).
    """
    pose = data.joint("hammer").qpos
    pose[:3] = (*position, CRADLE_HEIGHT + 0.0005)
    mujoco.mju_mat2Quat(pose[3:7], rotation.ravel())
