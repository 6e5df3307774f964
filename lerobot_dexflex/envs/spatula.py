"""A spatula, the stand it lies in and a griddle, shared by the tasks that use them."""

from typing import ClassVar

import mujoco
import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.scene import add_block
from lerobot_dexflex.hand import model as robot

ARM_START = (0.40, -0.35, 0.0, 0.95, 0.0, 1.3, np.pi / 2 + 0.40)
"""Arm at the start of an episode [rad]: the hand hovers behind the stand, palm down."""
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

GRIDDLE_HEIGHT, RIM_HEIGHT = 0.006, 0.010
"""Height of the griddle over the table and of its rim over the griddle [m]; its frame: origin on its top at
the foot of the rim, x toward the rim, z up."""

_HANDLE_SHARE, _NECK_SHARE = 0.6, 0.1
"""Shares of the mass; the rest is the blade's."""
_FOOT_HEIGHT = 0.02
_HALF_RIM = 0.003
_BENDING = (0.06, 1.0)
"""Contact of the blade's edge with what lies below: as soft as a blade that bends."""


class SpatulaEnv(HandEnv):
    """Do something with a spatula to the food on a griddle, whose place is the episode's `griddle`."""

    manipulated = "spatula"
    food: ClassVar[str]
    """Name of the body that is scooped up."""

    @property
    def spatula_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the handle's centre in the world; privileged."""
        return self._pose_of("spatula")

    @property
    def food_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the food's centre in the world; privileged."""
        return self._pose_of(self.food)

    @property
    def griddle_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the griddle in the world."""
        x, y, yaw = self.episode.griddle
        cosine, sine = np.cos(yaw), np.sin(yaw)
        rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return np.array([x, y, GRIDDLE_HEIGHT]), rotation

    def food_on_spatula(self) -> np.ndarray:
        """Return the food's centre in the spatula's frame [m]. Shape (3,)."""
        position, rotation = self.spatula_pose
        return rotation.T @ (self.food_pose[0] - position)

    def _food_touches_spatula(self) -> bool:
        """Say whether they touch, however lightly: food weighs little at each of its many contacts."""
        bodies = self.model.geom_bodyid[self.data.contact.geom]
        pair = sorted((self.model.body(self.food).id, self.model.body("spatula").id))
        return bool((np.sort(bodies, axis=1) == pair).all(1).any())

    def _dropped(self, holding: bool, touching: set[str], below: set[str]) -> bool:
        """Say whether the spatula lies in no hand, or the food beside griddle and plate.

        Args:
            holding: Whether the spatula is held.
            touching: What pushes on the spatula; see `contact_names`.
            below: What pushes on the food.
        """
        lying = self.spatula_pose[0][2] < LYING
        return bool((lying and not holding) or "floor" in touching or below & {"table", "floor"})

    def _on_blade(self, half_height: float) -> bool:
        """Say whether food of a half height [m] lies on the blade."""
        height, across, along = self.food_on_spatula()
        above = self._food_touches_spatula() and 0 < height - BLADE_TOP < 2 * half_height
        return bool(above and abs(across) < BLADE_HALF_WIDTH and BLADE_START < along < BLADE_END)

    def _put_on_griddle(self, x: float, y: float, half_height: float, yaw: float) -> None:
        """Lay the food on the griddle at x, y [m] in its frame, turned by `yaw` [rad] in the world."""
        position, rotation = self.griddle_pose
        pose = self.data.joint(self.food).qpos
        pose[:3] = position + rotation @ np.array([x, y, half_height + 0.0002])
        pose[3:] = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))


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


def add_griddle(
    spec: mujoco.MjSpec, place: tuple[float, float, float], half_size: tuple[float, float], sides: bool
) -> None:
    """Add a low board with a rim at its far end, fixed to the table.

    Args:
        spec: The scene.
        place: Position x, y [m] of the rim's middle and its yaw [rad].
        half_size: Half length toward the rim and half width [m].
        sides: Whether a rim runs along the sides too.
    """
    x, y, yaw = place
    grey, dark = (0.25, 0.26, 0.28, 1), (0.12, 0.12, 0.13, 1)
    griddle = spec.worldbody.add_body(
        name="griddle", pos=(x, y, GRIDDLE_HEIGHT), quat=(np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    )
    depth, width = half_size
    half = GRIDDLE_HEIGHT / 2
    add_block(griddle, "griddle", (depth, width, half), (-depth, 0, -half), grey)
    rim = (RIM_HEIGHT + GRIDDLE_HEIGHT) / 2
    height = rim - GRIDDLE_HEIGHT
    add_block(griddle, "griddle_rim", (_HALF_RIM, width, rim), (_HALF_RIM, 0, height), dark)
    for side in (-1, 1) if sides else ():
        beside = (-depth, side * (width + _HALF_RIM), height)
        add_block(griddle, f"griddle_side{side}", (depth, _HALF_RIM, rim), beside, dark)


def let_blade_bend(spec: mujoco.MjSpec, ground: str, blade_friction: float) -> None:
    """Make the contact of the blade's edge with a geom as soft as if the blade bent."""
    pair = spec.add_pair(geomname1="blade_front", geomname2=ground, condim=3)
    pair.friction[:2], pair.solref = blade_friction, _BENDING


def _handle_height() -> float:
    """Return the height of the handle's axis over the table in the stand [m]."""
    return _FOOT_HEIGHT + BLADE_THICKNESS - BLADE_TOP
