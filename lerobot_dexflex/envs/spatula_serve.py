"""SpatulaServe: take a spatula, scoop the patty off the griddle and let it slide onto the plate."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.scene import (
    ContactSurface,
    add_block,
    add_camera,
    add_wrist_camera,
    place_robot,
    robot_at_table,
)
from lerobot_dexflex.envs.spatula import (
    BLADE_END,
    BLADE_HALF_WIDTH,
    BLADE_START,
    BLADE_TOP,
    LYING,
    add_spatula,
    add_spatula_stand,
    lay_spatula,
)
from lerobot_dexflex.envs.stages import furthest_progress, has_settled
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched

ARM_START = (0.40, -0.35, 0.0, 0.95, 0.0, 1.3, np.pi / 2 + 0.40)
"""Arm at the start of an episode [rad]: the hand hovers behind the stand, palm down."""
GRIDDLE_HEIGHT, RIM_HEIGHT = 0.006, 0.010
"""Height of the griddle over the table and of its rim over the griddle [m]; its frame: origin on its top at
the foot of the rim, x toward the rim, z up."""
PATTY_HALF_HEIGHT = 0.006
PLATE_RADIUS, PLATE_HEIGHT = 0.08, 0.010
MOST_TILTED = np.radians(20)
"""A patty that is served lies flatter than this [rad]."""
LIFTED = 0.02
"""A patty whose centre is so far above where it lies on the griddle has been lifted [m]."""

_GRIDDLE_HALF_SIZE = (0.07, 0.065)
_CORNERS = 8
_BENDING = (0.06, 1.0)
"""Contact of the blade's edge with griddle and plate: as soft as a blade that bends."""


@dataclass(frozen=True)
class SpatulaEpisode:
    """Everything random about an episode; lengths [m], angles [rad]."""

    handle_half_width: float
    mass: float
    """Mass of the spatula [kg]."""
    tip_friction: float
    blade_friction: float
    stand: tuple[float, float, float]
    """Position x, y of the handle's centre and yaw: the handle points away from the robot at yaw 0."""
    spatula_yaw: float
    """How the spatula lies askew in its stand."""
    griddle: tuple[float, float, float]
    """Position x, y of the rim's middle and yaw: the rim is at the far end at yaw 0."""
    patty_radius: float
    patty_mass: float
    """Mass of the patty [kg]."""
    patty: tuple[float, float, float]
    """Gap to the rim, offset sideways, and yaw of the patty."""
    plate: tuple[float, float]
    """Centre of the plate."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class SpatulaServeEnv(HandEnv):
    """Serve the patty with the spatula; see `HandEnv` for observations and actions.

    The patty's edge is round, as that of a real one, and the rim stops it: so a blade that is pushed along
    the griddle gets below it. Blade and patty are in front of the hand, which carries their torque.

    Success: the patty lies on the plate, its centre over it and tilted by less than 20 degrees, at rest and
    off the spatula, while thumb and a finger hold the spatula, for half a second.
    Dropping the spatula, or the patty beside griddle and plate, ends the episode.
    """

    task = "SpatulaServe-v0"
    manipulated = "spatula"

    def _sample_episode(self, rng: np.random.Generator) -> SpatulaEpisode:
        return SpatulaEpisode(
            handle_half_width=rng.uniform(0.009, 0.014),
            mass=rng.uniform(0.04, 0.06),
            tip_friction=rng.uniform(0.8, 1.2),
            blade_friction=rng.uniform(0.2, 0.3),
            stand=(rng.uniform(0.42, 0.45), rng.uniform(0.20, 0.23), rng.uniform(-0.3, 0.3)),
            spatula_yaw=rng.normal(scale=0.02),
            griddle=(rng.uniform(0.66, 0.69), rng.uniform(-0.02, 0.03), rng.uniform(-0.2, 0.2)),
            patty_radius=rng.uniform(0.032, 0.036),
            patty_mass=rng.uniform(0.03, 0.045),
            patty=(rng.uniform(0.001, 0.03), rng.uniform(-0.015, 0.015), rng.uniform(-np.pi, np.pi)),
            plate=(rng.uniform(0.58, 0.62), rng.uniform(-0.26, -0.22)),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: SpatulaEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(episode.tip_friction)
        add_camera(spec, "front", position=(1.10, -0.36, 0.52), target=(0.52, -0.02, 0.05), fovy=44)
        add_wrist_camera(palm, position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70)
        add_spatula_stand(spec, episode.stand)
        _add_griddle(spec, episode.griddle)
        _add_disc(spec.worldbody, "plate", PLATE_RADIUS, PLATE_HEIGHT / 2, (0.92, 0.92, 0.95, 1)).pos = (
            *episode.plate,
            PLATE_HEIGHT / 2,
        )
        add_spatula(spec, episode.handle_half_width, episode.mass, episode.blade_friction)
        add_patty(spec, episode.patty_radius, episode.patty_mass)
        for ground in ("griddle", "plate"):
            pair = spec.add_pair(geomname1="blade_front", geomname2=ground, condim=3)
            pair.friction[:2], pair.solref = episode.blade_friction, _BENDING
        return spec

    def _initialise(self, episode: SpatulaEpisode) -> None:
        place_robot(self.data, np.add(ARM_START, episode.arm_noise), robot.HAND_RELAXED)
        lay_spatula(self.data, episode.stand, episode.spatula_yaw)
        gap, sideways, yaw = episode.patty
        position, rotation = self.griddle_pose
        there = np.array([-episode.patty_radius - gap, sideways, PATTY_HALF_HEIGHT + 0.0002])
        pose = self.data.joint("patty").qpos
        pose[:3] = position + rotation @ there
        pose[3:] = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))

    @property
    def spatula_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the handle's centre in the world; privileged."""
        return self._pose_of("spatula")

    @property
    def patty_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the patty's centre in the world; privileged."""
        return self._pose_of("patty")

    @property
    def griddle_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the griddle in the world."""
        x, y, yaw = self.episode.griddle
        cosine, sine = np.cos(yaw), np.sin(yaw)
        rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return np.array([x, y, GRIDDLE_HEIGHT]), rotation

    def patty_on_spatula(self) -> np.ndarray:
        """Return the patty's centre in the spatula's frame [m]. Shape (3,)."""
        position, rotation = self.spatula_pose
        return rotation.T @ (self.patty_pose[0] - position)

    def _pose_of(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        body = self.data.body(name)
        return body.xpos.copy(), body.xmat.reshape(3, 3).copy()

    def _patty_touches_spatula(self) -> bool:
        """Say whether they touch, however lightly: a patty weighs little at each of its many contacts."""
        bodies = self.model.geom_bodyid[self.data.contact.geom]
        pair = sorted((self.model.body("patty").id, self.model.body("spatula").id))
        return bool((np.sort(bodies, axis=1) == pair).all(1).any())

    def _update(self) -> dict[str, Any]:
        touching = contact_names(self.model, self.data, "spatula")
        below = contact_names(self.model, self.data, "patty")
        holding = pinched(touching)
        height, across, along = self.patty_on_spatula()
        touched = self._patty_touches_spatula()
        on_blade = touched and 0 < height - BLADE_TOP < 2 * PATTY_HALF_HEIGHT
        on_blade &= abs(across) < BLADE_HALF_WIDTH and BLADE_START < along < BLADE_END
        patty, tilt = self.patty_pose
        lifted = on_blade and patty[2] > GRIDDLE_HEIGHT + PATTY_HALF_HEIGHT + LIFTED
        over_plate = np.linalg.norm(patty[:2] - self.episode.plate) < PLATE_RADIUS
        at_rest = np.linalg.norm(self.data.joint("patty").qvel[:3]) < 0.02
        flat = abs(tilt[2, 2]) > np.cos(MOST_TILTED)
        served = holding and over_plate and at_rest and flat and below == {"plate"} and not touched
        lying = self.spatula_pose[0][2] < LYING
        in_stand = any(name.startswith("stand") for name in touching)
        stages = (
            holding,
            holding and not in_stand,
            holding and on_blade,
            holding and lifted,
            holding and lifted and over_plate,
            served,
        )
        return {
            "is_success": has_settled(self.memory, served),
            "progress": furthest_progress(self.memory, stages),
            "dropped": bool((lying and not holding) or "floor" in touching or below & {"table", "floor"}),
            "holding": holding,
            "contacts": contact_flags(touching),
        }


def _add_griddle(spec: mujoco.MjSpec, place: tuple[float, float, float]) -> None:
    """Add a low board with a rim at its far end, fixed to the table."""
    x, y, yaw = place
    grey, dark = (0.25, 0.26, 0.28, 1), (0.12, 0.12, 0.13, 1)
    griddle = spec.worldbody.add_body(
        name="griddle", pos=(x, y, GRIDDLE_HEIGHT), quat=(np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    )
    depth, width = _GRIDDLE_HALF_SIZE
    half = GRIDDLE_HEIGHT / 2
    add_block(griddle, "griddle", (depth, width, half), (-depth, 0, -half), grey)
    rim = (RIM_HEIGHT + GRIDDLE_HEIGHT) / 2
    add_block(griddle, "griddle_rim", (0.003, width, rim), (0.003, 0, rim - GRIDDLE_HEIGHT), dark)


def add_patty(spec: mujoco.MjSpec, radius: float, mass: float) -> None:
    """Add a disc with a ring of capsules as its round edge."""
    body = spec.worldbody.add_body(name="patty")
    body.add_freejoint(name="patty")
    brown, ring = (0.42, 0.22, 0.12, 1), radius - PATTY_HALF_HEIGHT
    _add_disc(body, "patty", ring, PATTY_HALF_HEIGHT - 0.0002, brown).mass = mass
    angles = np.arange(_CORNERS + 1) * 2 * np.pi / _CORNERS
    corners = ring * np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], 1)
    for k in range(_CORNERS):
        body.add_geom(
            name=f"patty_edge{k}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=(PATTY_HALF_HEIGHT, 0, 0),
            fromto=(*corners[k], *corners[k + 1]),
            mass=0,
            rgba=brown,
            **ContactSurface()._asdict(),
        )


def _add_disc(
    body: mujoco.MjsBody, name: str, radius: float, half_height: float, rgba: Any
) -> mujoco.MjsGeom:
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(radius, half_height, 0),
        rgba=rgba,
        **ContactSurface()._asdict(),
    )
