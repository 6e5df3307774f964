"""A spatula and the stand it lies in, shared by the tasks that use one."""

import mujoco
import numpy as np

from lerobot_dexflex.envs.scene import add_block
from lerobot_dexflex.hand import model as robot

HANDLE_HALF_DEPTH, HANDLE_HALF_LENGTH = 0.008, 0.068
"""Half height and half length of the handle's bar [m]; the spatula's frame: origin in the middle of it, z
along it to the blade, x up."""
BLADE_TOP, BLADE_HALF_WIDTH = -0.038, 0.035
"""Height of the blade's upper face, along x, and half its width along y [m]: below the fingertips."""
BLADE_START, BLADE_BEND, BLADE_END = 0.078, 0.130, 0.150
"""Where the blade begins, bends down and ends along z [m]."""
BEVEL = np.radians(8)
"""Slope of the blade's front, beyond the bend [rad]."""
BLADE_THICKNESS, EDGE_THICKNESS = 0.0015, 0.001
EDGE = np.array([BLADE_TOP - (BLADE_END - BLADE_BEND) * np.tan(BEVEL) - EDGE_THICKNESS, 0.0, BLADE_END])
"""Middle of the lower front edge in the spatula's frame [m]."""
LYING = 0.035
"""A spatula whose handle's centre is lower than this has been dropped [m]."""

_HANDLE_SHARE, _NECK_SHARE = 0.6, 0.1
"""Shares of the mass; the rest is the blade's."""
_FOOT_HEIGHT = 0.02


def add_spatula(spec: mujoco.MjSpec, handle_half_width: float, mass: float, blade_friction: float) -> None:
    """Add a bar as the handle, a neck that leads down, and a blade of two boxes, the front one sloping.

    Args:
        spec: The scene.
        handle_half_width: [m].
        mass: Of the whole spatula [kg].
        blade_friction: Sliding friction of the blade with whatever lies on it or below it [1].
    """
    steel, dark = (0.75, 0.75, 0.78, 1), (0.2, 0.2, 0.22, 1)
    body = spec.worldbody.add_body(name="spatula")
    body.add_freejoint(name="spatula")
    bar = (HANDLE_HALF_DEPTH, handle_half_width, HANDLE_HALF_LENGTH)
    handle = add_block(body, "spatula_handle", bar, (0, 0, 0), (0.85, 0.55, 0.2, 1))
    handle.mass, handle.condim = _HANDLE_SHARE * mass, 4

    top, bottom = np.array([0, HANDLE_HALF_LENGTH - 0.003]), np.array([BLADE_TOP, BLADE_START + 0.002])
    _slope(body, "spatula_neck", top, bottom, 0.007, 0.002, dark).mass = _NECK_SHARE * mass

    thickness = BLADE_THICKNESS / 2
    start, bend = np.array([BLADE_TOP, BLADE_START]), np.array([BLADE_TOP, BLADE_BEND])
    end = np.array([EDGE[0] + EDGE_THICKNESS, BLADE_END])
    plate = _slope(body, "blade", start, bend, BLADE_HALF_WIDTH, thickness, steel)
    front = _slope(body, "blade_front", bend, end, BLADE_HALF_WIDTH, EDGE_THICKNESS / 2, steel)
    for geom, share in ((plate, 0.75), (front, 0.25)):
        geom.mass = share * (1 - _HANDLE_SHARE - _NECK_SHARE) * mass
        geom.priority, geom.friction[0], geom.solref = 1, blade_friction, robot.TIP_SOLREF


def _slope(
    body: mujoco.MjsBody,
    name: str,
    start: np.ndarray,
    end: np.ndarray,
    half_width: float,
    half_thickness: float,
    rgba: tuple,
) -> mujoco.MjsGeom:
    """Add a plate whose upper face leads from one point to another, both x, z [m]."""
    way = end - start
    length = float(np.hypot(*way))
    pitch = float(np.arctan2(way[0], way[1]))
    middle = (start + end) / 2 - half_thickness * np.array([way[1], -way[0]]) / length
    half_size = (half_thickness, half_width, length / 2)
    plate = add_block(body, name, half_size, (middle[0], 0, middle[1]), rgba)
    plate.quat = (np.cos(pitch / 2), 0, np.sin(pitch / 2), 0)
    return plate


def add_spatula_stand(spec: mujoco.MjSpec, place: tuple[float, float, float]) -> None:
    """Add a foot under the blade, with cheeks beside it, and a rail under the handle's end.

    Args:
        spec: The scene.
        place: Position x, y [m] of the handle's centre and its yaw [rad].
    """
    x, y, yaw = place
    brown = (0.45, 0.3, 0.18, 1)
    stand = spec.worldbody.add_body(
        name="stand", pos=(x, y, 0), quat=(np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    )
    foot = _FOOT_HEIGHT / 2
    rail = (_handle_height() - HANDLE_HALF_DEPTH) / 2
    along = (BLADE_START + BLADE_BEND) / 2
    add_block(stand, "stand_foot", (0.02, BLADE_HALF_WIDTH + 0.008, foot), (along, 0, foot), brown)
    for side in (-1, 1):
        where = (along, side * (BLADE_HALF_WIDTH + 0.005), foot + 0.003)
        add_block(stand, f"stand_cheek{side}", (0.02, 0.002, foot + 0.003), where, brown)
    add_block(stand, "stand_rail", (0.004, 0.02, rail), (-0.063, 0, rail), brown)


def lay_spatula(data: mujoco.MjData, place: tuple[float, float, float], yaw: float) -> None:
    """Lay the spatula into its stand at `place`, askew by `yaw` [rad]."""
    angle = place[2] + yaw
    handle = np.array([np.cos(angle), np.sin(angle), 0.0])
    rotation = np.stack([np.array([0.0, 0.0, 1.0]), np.cross(handle, [0.0, 0.0, 1.0]), handle], 1)
    pose = data.joint("spatula").qpos
    pose[:3] = (*place[:2], _handle_height() + 0.0003)
    mujoco.mju_mat2Quat(pose[3:7], rotation.ravel())


def _handle_height() -> float:
    """Return the height of the handle's axis over the table in the stand [m]."""
    return _FOOT_HEIGHT + BLADE_THICKNESS - BLADE_TOP
