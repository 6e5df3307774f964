"""SpatulaServe: take a spatula, scoop the patty off the griddle and let it slide onto the plate."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.envs.scene import (
    ContactSurface,
    add_camera,
    add_palm_camera,
    place_robot,
    robot_at_table,
)
from lerobot_dexflex.envs.spatula import (
    ARM_START,
    GRIDDLE_HEIGHT,
    SpatulaEnv,
    add_griddle,
    add_spatula,
    add_spatula_stand,
    lay_spatula,
    let_blade_bend,
)
from lerobot_dexflex.envs.stages import furthest_progress, has_settled
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched

PATTY_HALF_HEIGHT = 0.006
PLATE_RADIUS, PLATE_HEIGHT = 0.08, 0.010
MOST_TILTED = np.radians(20)
"""A patty that is served lies flatter than this [rad]."""
LIFTED = 0.02
"""A patty whose centre is so far above where it lies on the griddle has been lifted [m]."""

_GRIDDLE_HALF_SIZE = (0.07, 0.065)
_CORNERS = 8


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


class SpatulaServeEnv(SpatulaEnv):
    """Serve the patty with the spatula; see `HandEnv` for observations and actions.

    The patty's edge is round, as that of a real one, and the rim stops it: so a blade that is pushed along
    the griddle gets below it. Blade and patty are in front of the hand, which carries their torque.

    Success: the patty lies on the plate, its centre over it and tilted by less than 20 degrees, at rest and
    off the spatula, while thumb and a finger hold the spatula, for half a second.
    Dropping the spatula, or the patty beside griddle and plate, ends the episode.
    """

    task = "SpatulaServe-v0"
    food = "patty"

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
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(1.10, -0.36, 0.52), target=(0.52, -0.02, 0.05), fovy=44)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70
        )
        add_spatula_stand(spec, episode.stand)
        add_griddle(spec, episode.griddle, _GRIDDLE_HALF_SIZE, sides=False)
        _add_disc(spec.worldbody, "plate", PLATE_RADIUS, PLATE_HEIGHT / 2, (0.92, 0.92, 0.95, 1)).pos = (
            *episode.plate,
            PLATE_HEIGHT / 2,
        )
        add_spatula(spec, episode.handle_half_width, episode.mass, episode.blade_friction)
        add_patty(spec, episode.patty_radius, episode.patty_mass)
        for ground in ("griddle", "plate"):
            let_blade_bend(spec, ground, episode.blade_friction)
        return spec

    def _initialise(self, episode: SpatulaEpisode) -> None:
        place_robot(self.hand, self.data, np.add(ARM_START, episode.arm_noise))
        lay_spatula(self.data, episode.stand, episode.spatula_yaw)
        gap, sideways, yaw = episode.patty
        self._put_on_griddle(-episode.patty_radius - gap, sideways, PATTY_HALF_HEIGHT, yaw)

    def _update(self) -> dict[str, Any]:
        touching = contact_names(self.model, self.data, "spatula")
        below = contact_names(self.model, self.data, "patty")
        holding = pinched(self.hand, touching)
        touched, on_blade = self._food_touches_spatula(), self._on_blade(PATTY_HALF_HEIGHT)
        patty, tilt = self.food_pose
        lifted = on_blade and patty[2] > GRIDDLE_HEIGHT + PATTY_HALF_HEIGHT + LIFTED
        over_plate = np.linalg.norm(patty[:2] - self.episode.plate) < PLATE_RADIUS
        at_rest = np.linalg.norm(self.data.joint("patty").qvel[:3]) < 0.02
        flat = abs(tilt[2, 2]) > np.cos(MOST_TILTED)
        served = holding and over_plate and at_rest and flat and below == {"plate"} and not touched
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
            "dropped": self._dropped(holding, touching, below),
            "holding": holding,
            "contacts": contact_flags(self.hand, touching),
        }


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
