"""FlipToast: take a spatula, scoop a slice of toast off the griddle and turn it over."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.envs.scene import (
    ContactSurface,
    add_block,
    add_camera,
    add_palm_camera,
    place_robot,
    robot_at_table,
)
from lerobot_dexflex.envs.spatula import (
    ARM_START,
    SpatulaEnv,
    add_griddle,
    add_spatula,
    add_spatula_stand,
    lay_spatula,
    let_blade_bend,
)
from lerobot_dexflex.envs.stages import has_settled
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched

GRIDDLE_HALF_SIZE = (0.11, 0.075)
"""Half length toward the rim and half width [m]."""
FLIPPED = np.radians(150)
"""A slice that is turned over is turned by more than this [rad]."""

_TAKEN, _TURN_SHARE = (0.1, 0.2, 0.3), 0.6
"""Progress with the spatula held, off its stand, below the slice; the slice's half turn adds 0.6 to that."""

_HARDNESS = 20.0
"""Weight of the slice's contact settings against the griddle's, through which it would fall else."""


@dataclass(frozen=True)
class ToastEpisode:
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
    """Position x, y of the far rim's middle and yaw: that rim is at the far end at yaw 0."""
    slice_half_size: tuple[float, float]
    """Half width and half height of the square slice."""
    slice_mass: float
    """Mass of the slice [kg]."""
    slice: tuple[float, float, float]
    """Gap to the far rim, offset sideways, and yaw of the slice, seen from the griddle."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class FlipToastEnv(SpatulaEnv):
    """Turn the slice over with the spatula; see `HandEnv` for observations and actions.

    The slice's edges are round, so that a blade gets below where a rim stops it. The griddle's near end is
    open. Blade and slice are in front of the hand, which carries their torque.

    Success: the slice lies at rest on the griddle, turned by more than 150 degrees, off the spatula, while
    thumb and a finger hold the spatula, for half a second. Progress counts three stages, then the slice's
    largest turn while the spatula is held.
    Dropping the spatula, or the slice beside the griddle, ends the episode.
    """

    task = "FlipToast-v0"
    food = "toast"

    def _sample_episode(self, rng: np.random.Generator) -> ToastEpisode:
        return ToastEpisode(
            handle_half_width=rng.uniform(0.009, 0.014),
            mass=rng.uniform(0.04, 0.06),
            tip_friction=rng.uniform(0.8, 1.2),
            blade_friction=rng.uniform(0.2, 0.3),
            stand=(rng.uniform(0.42, 0.45), rng.uniform(0.20, 0.23), rng.uniform(-0.3, 0.3)),
            spatula_yaw=rng.normal(scale=0.02),
            griddle=(rng.uniform(0.65, 0.68), rng.uniform(-0.08, -0.03), rng.uniform(-0.2, 0.2)),
            slice_half_size=(rng.uniform(0.035, 0.040), rng.uniform(0.006, 0.007)),
            slice_mass=rng.uniform(0.025, 0.040),
            slice=(rng.uniform(0.001, 0.03), rng.uniform(-0.015, 0.015), rng.uniform(-0.15, 0.15)),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: ToastEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(1.10, -0.36, 0.52), target=(0.52, 0.0, 0.05), fovy=40)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70
        )
        add_spatula_stand(spec, episode.stand)
        add_griddle(spec, episode.griddle, GRIDDLE_HALF_SIZE, sides=True)
        add_spatula(spec, episode.handle_half_width, episode.mass, episode.blade_friction)
        add_slice(spec, episode.slice_half_size, episode.slice_mass)
        let_blade_bend(spec, "griddle", episode.blade_friction)
        return spec

    def _initialise(self, episode: ToastEpisode) -> None:
        place_robot(self.hand, self.data, np.add(ARM_START, episode.arm_noise))
        lay_spatula(self.data, episode.stand, episode.spatula_yaw)
        half_width, half_height = episode.slice_half_size
        gap, sideways, yaw = episode.slice
        self._put_on_griddle(-half_width - gap, sideways, half_height, episode.griddle[2] + yaw)

    @property
    def turned(self) -> float:
        """By how much the slice's upper side is turned from facing up [rad]."""
        return float(np.arccos(np.clip(self.food_pose[1][2, 2], -1, 1)))

    def _update(self) -> dict[str, Any]:
        touching = contact_names(self.model, self.data, "spatula")
        below = contact_names(self.model, self.data, "toast")
        holding = pinched(self.hand, touching)
        in_stand = any(name.startswith("stand") for name in touching)
        on_blade = self._on_blade(self.episode.slice_half_size[1])
        at_rest = np.linalg.norm(self.data.joint("toast").qvel[:3]) < 0.02
        on_griddle = "griddle" in below and all(name.startswith("griddle") for name in below)
        over = self.turned > FLIPPED and at_rest and on_griddle and not self._food_touches_spatula()
        flipped = holding and over
        stages = (holding, holding and not in_stand, holding and on_blade)
        taken = max((share for share, stage in zip(_TAKEN, stages, strict=True) if stage), default=0.0)
        turn = _TAKEN[-1] + _TURN_SHARE * self.turned / np.pi if holding and self.turned > 0.2 else 0.0
        progress = max(taken, turn, float(flipped), self.memory.get("progress", 0.0))
        self.memory["progress"] = progress
        return {
            "is_success": has_settled(self.memory, flipped),
            "progress": progress,
            "dropped": self._dropped(holding, touching, below),
            "holding": holding,
            "contacts": contact_flags(self.hand, touching),
        }


def add_slice(spec: mujoco.MjSpec, half_size: tuple[float, float], mass: float) -> None:
    """Add a square slice, brown below, its edges round; half width and half height [m], mass [kg]."""
    width, height = half_size
    body = spec.worldbody.add_body(name="toast")
    body.add_freejoint(name="toast")
    crumb, crust, inside = (0.85, 0.68, 0.4, 1), (0.5, 0.28, 0.1, 1), width - height
    add_block(body, "toast", (inside, inside, height - 0.0002), (0, 0, 0), crumb).mass = mass
    corners = inside * np.array([(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0)])
    for k, corner in enumerate(corners):
        body.add_geom(
            name=f"toast_edge{k}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=(height, 0, 0),
            fromto=(*corner, *corners[k - 3]),
            mass=0,
            rgba=crust,
            **ContactSurface()._asdict(),
        )
    for geom in body.geoms:
        geom.solref, geom.solmix = robot.TIP_SOLREF, _HARDNESS
    side = (inside, inside, 0.0002)  # For the eye alone.
    toasted = add_block(body, "toast_side", side, (0, 0, -height + 0.0002), (0.6, 0.38, 0.16, 1))
    toasted.mass = toasted.contype = toasted.conaffinity = 0
