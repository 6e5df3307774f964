"""What may go wrong around a task: a heavier object, slippery fingertips, pushes, late touch, wrong encoders.

A disturbance changes nothing else about an episode: the same seed gives the same scene with and without it.
"""

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.model import tip_geoms
from lerobot_dexflex.hand.touch import TouchConfig
from lerobot_dexflex.hands import Hand

PUSH_STEPS, PUSH_INTERVAL = 4, 40
"""Control steps that a push lasts, and from the start of one push to the next."""


@dataclass(frozen=True)
class Disturbance:
    """One way in which the world differs from the demonstrations."""

    mass: float = 1.0
    """Factor of the object's mass and inertia."""
    friction: float = 1.0
    """Factor of the fingertips' sliding friction."""
    push: float = 0.0
    """Force of a push on the object, in multiples of its undisturbed weight; its direction is random and
    horizontal."""
    latency: int = 0
    """Control steps by which touch is later than it would be."""
    calibration: float = 0.0
    """Largest error of a hand joint's encoder [rad], drawn anew for every joint and episode."""

    def touch(self, config: TouchConfig) -> TouchConfig:
        """Return the sensor with this latency."""
        return replace(config, latency_steps=config.latency_steps + self.latency)

    def change(self, hand: Hand, model: mujoco.MjModel, body: str) -> None:
        """Change a freshly compiled model.

        Args:
            hand: The hand in it.
            model: The scene; changed in place.
            body: Name of the object.
        """
        index = model.body(body).id
        model.body_mass[index] *= self.mass
        model.body_inertia[index] *= self.mass
        if self.mass != 1.0:
            mujoco.mj_setConst(model, mujoco.MjData(model))
        tips = [model.geom(name).id for name in tip_geoms(hand)]
        model.geom_friction[tips, 0] *= self.friction

    def encoder_errors(self, hand: Hand, rng: np.random.Generator) -> np.ndarray:
        """Return by how much each joint of the hand is read too far in this episode [rad]. (joints,)."""
        return rng.uniform(-self.calibration, self.calibration, hand.n_joints)

    def force(self, rng: np.random.Generator, weight: float, memory: dict[str, Any]) -> np.ndarray:
        """Return the force of this control step on the object's centre of mass, world frame [N] (3,).

        Args:
            rng: Random numbers of the pushes, of this episode alone.
            weight: The object's undisturbed weight [N].
            memory: Kept between steps, and in snapshots.
        """
        step = memory["disturbed_steps"] = memory.get("disturbed_steps", -1) + 1
        if step % PUSH_INTERVAL == 0:
            memory["push_angle"] = float(rng.uniform(0, 2 * np.pi))
            memory["push_start"] = step + int(rng.integers(0, PUSH_INTERVAL - PUSH_STEPS))
        if not memory["push_start"] <= step < memory["push_start"] + PUSH_STEPS:
            return np.zeros(3)
        angle = memory["push_angle"]
        return self.push * weight * np.array([np.cos(angle), np.sin(angle), 0.0])


DISTURBANCES = {
    "none": Disturbance(),
    "heavy": Disturbance(mass=1.5),
    "slippery": Disturbance(friction=0.6),
    "pushed": Disturbance(push=1.0),
    "late_touch": Disturbance(latency=3),
    "miscalibrated": Disturbance(calibration=0.05),
}
"""By name, as environments take them."""


def find_disturbance(name: str) -> Disturbance:
    """Return the disturbance of a name.

    Raises:
        DexFlexError: If there is none.
    """
    if name not in DISTURBANCES:
        raise DexFlexError(f"Unknown disturbance {name!r}. Valid: {', '.join(DISTURBANCES)}.")
    return DISTURBANCES[name]
