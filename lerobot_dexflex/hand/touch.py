"""Touch: a grid of taxels on the flat pad of each fingertip, as a FlexiTac sensor would give them.

Three steps. MuJoCo's tactile sensor gives the *shape*: how deep each vertex of a hidden plate, raised
above the pad by a virtual skin, lies inside the touching object. Its contact sensor gives the *force* on the
palmar half of the tip. A Winkler foundation (independent springs, one per taxel) joins them: the skin is
pressed by the one common offset at which the springs carry exactly that force. Sensor effects come last.
"""

import math
from collections import deque
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.poses import quaternion_matrix
from lerobot_dexflex.hand.touch_image import touch_strip as touch_strip
from lerobot_dexflex.hand.winkler import blur_matrix, winkler_loads
from lerobot_dexflex.hands import Hand

_PLATE = "taxels"
_PLATE_HALF_THICKNESS = 0.001
_HIDDEN_GROUP = 5
_UNSHAPED_SPREAD = 0.0025
_FIELDS = (
    mujoco.mjtConDataField.mjCONDATA_FOUND,
    mujoco.mjtConDataField.mjCONDATA_FORCE,
    mujoco.mjtConDataField.mjCONDATA_POS,
)
_NET_FORCE = 3  # `reduce` mode of the contact sensor


@dataclass(frozen=True)
class TouchConfig:
    """The skin and the electronics of the fingertip sensors.

    Skin and range are plausible values, not fitted to a real FlexiTac.
    """

    skin: float = 0.0015
    """Thickness of the virtual skin above the rigid pad [m]; simulated tips alone penetrate only 30 um/N."""
    stiffness: float = 60.0
    """Stiffness of the skin under one taxel [N/m]: about 5 N flatten the whole skin."""
    blur: float = 0.001
    """Standard deviation of the spread of force inside the skin [m]; softens the steps of thin contacts."""
    noise_std: float = 0.004
    """Standard deviation of a taxel's noise [N]: one count of FlexiTac's 8 bits over `saturation`."""
    threshold: float = 0.01
    """Readings below are reported as zero [N]: 2.5 standard deviations of the noise."""
    saturation: float = 1.0
    """Largest force one taxel can report [N], 0.12 MPa."""
    latency_steps: int = 0
    """Control steps by which readings lag the physics (FlexiTac sends about 90 frames per second)."""

    def __post_init__(self) -> None:
        for name in ("skin", "stiffness", "saturation"):
            if getattr(self, name) <= 0:
                raise DexFlexError(f"`{name}` must be positive. Got {getattr(self, name)}.")
        for name in ("blur", "noise_std", "threshold", "latency_steps"):
            if getattr(self, name) < 0:
                raise DexFlexError(f"`{name}` must not be negative. Got {getattr(self, name)}.")

    @classmethod
    def ideal(cls) -> "TouchConfig":
        """Return the same skin with perfect electronics: no noise, threshold, saturation or latency."""
        return cls(noise_std=0.0, threshold=0.0, saturation=float("inf"), latency_steps=0)


def add_touch(spec: mujoco.MjSpec, hand: Hand, config: TouchConfig | None = None) -> None:
    """Add taxels and a contact force sensor to every fingertip.

    Everything added is invisible (geom group 5, site group 5), massless and without collisions.

    Args:
        spec: A spec that the hand was added to.
        hand: The hand.
        config: Where to place the taxels; only `skin` is used.
    """
    skin = (config or TouchConfig()).skin
    plate = spec.add_mesh(name=_PLATE)
    plate.make_plate(list(hand.taxels))
    along, across = (pitch * n / 2 for pitch, n in zip(hand.taxel_pitch, hand.taxels, strict=True))
    plate.scale = (along, across, _PLATE_HALF_THICKNESS)
    for finger, distal in zip(hand.prefixes, hand.distal_links, strict=True):
        body, pad = spec.body(distal), spec.site(f"{finger}_pad")
        to_pad = quaternion_matrix(np.asarray(pad.quat) / np.linalg.norm(pad.quat))
        # The sensing vertices are the plate's lower face.
        body.add_geom(
            name=f"{finger}_skin",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=_PLATE,
            pos=pad.pos + to_pad[:, 2] * (skin + _PLATE_HALF_THICKNESS),
            quat=pad.quat,
            contype=0,
            conaffinity=0,
            mass=0,
            group=_HIDDEN_GROUP,
        )
        body.add_site(
            name=f"{finger}_palmar",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=pad.pos + to_pad @ hand.palmar.position,
            quat=pad.quat,
            size=hand.palmar.half_size,
            group=_HIDDEN_GROUP,
        )
        spec.add_sensor(
            name=f"{finger}_taxels",
            type=mujoco.mjtSensor.mjSENS_TACTILE,
            objtype=mujoco.mjtObj.mjOBJ_MESH,
            objname=_PLATE,
            reftype=mujoco.mjtObj.mjOBJ_GEOM,
            refname=f"{finger}_skin",
        )
        force = spec.add_sensor(
            name=f"{finger}_force",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=f"{finger}_palmar",
            reftype=mujoco.mjtObj.mjOBJ_BODY,
            refname=distal,
        )
        force.intprm[:3] = (sum(1 << int(field) for field in _FIELDS), _NET_FORCE, 1)


class TouchSensor:
    """Read the taxels of all fingers from simulation data.

    A finger's *normal force* is the component along the inward pad normal of the net contact force on the
    palmar half of its tip, whoever touches it: objects, the world or another finger. Pushing on the very
    end, the sides or the back of a tip is therefore not felt. Force at the rounded nose is felt through its
    component along the pad normal; where it reaches no taxel through the skin, the taxels nearest to the
    contact carry it, so that the taxels of a finger always sum to its normal force. A sharp edge is thinner
    than the pitch: sliding across the pad it jumps from one line of taxels to the next.

    Values come from `data.sensordata`, hence from the state at the start of the latest physics step: call
    `mujoco.mj_forward` (or step) after setting a state by hand.
    """

    def __init__(self, model: mujoco.MjModel, hand: Hand, config: TouchConfig | None = None) -> None:
        """Look up the sensors that `add_touch` made.

        Args:
            model: The compiled model.
            hand: The hand given to `add_touch`.
            config: Skin and electronics; `skin` must be the one given to `add_touch`.

        Raises:
            DexFlexError: If the model has no touch sensors.
        """
        self.config = config or TouchConfig()
        self._taxels, self._pitch = hand.taxels, hand.taxel_pitch
        addresses = [_sensor_address(model, f"{finger}_taxels") for finger in hand.prefixes]
        self._depth = np.add.outer(addresses, np.arange(math.prod(hand.taxels)))  # (fingers, taxels)
        addresses = [_sensor_address(model, f"{finger}_force") for finger in hand.prefixes]
        self._force = np.add.outer(addresses, np.arange(1, 4))  # (fingers, 3), after the number of contacts
        self._point = self._force + 3
        self._pads = np.array([model.site(f"{finger}_pad").id for finger in hand.prefixes])
        self._spread = [
            blur_matrix(n, self.config.blur / p) for n, p in zip(self._taxels, self._pitch, strict=True)
        ]
        self._pending: deque[NDArray[np.float32]] = deque()

    def normal_forces(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the compressive normal force on each pad. Shape (fingers,), [N], never negative."""
        normals = data.site_xmat[self._pads].reshape(-1, 3, 3)[:, :, 2]
        return np.maximum(-(data.sensordata[self._force] * normals).sum(axis=1), 0.0)

    def true_taxels(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the force on every taxel before sensor effects. Shape (fingers, along, across), [N].

        The taxels of a finger sum to its `normal_forces`.
        """
        forces = self.normal_forces(data)
        taxels = np.zeros((len(self._pads), *self._taxels))
        touched = np.flatnonzero(forces)
        if touched.size == 0:
            return taxels
        depths = data.sensordata[self._depth[touched]]
        loads = winkler_loads(depths, forces[touched], self.config.stiffness)
        for row in np.flatnonzero(depths.max(axis=1) <= 0.0):
            loads[row] = self._nearest(data, int(touched[row])) * forces[touched[row]]
        along, across = self._spread
        taxels[touched] = along @ loads.reshape(-1, *self._taxels) @ across
        return taxels

    def read(self, data: mujoco.MjData, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return what the sensor reports, once per control step. Shape (fingers, along, across), [N].

        Args:
            data: Simulation data.
            rng: Source of the noise; not drawn from if `noise_std` is zero.
        """
        config = self.config
        reading = self.true_taxels(data).astype(np.float32)
        if config.noise_std > 0:
            reading += config.noise_std * rng.standard_normal(reading.shape, dtype=np.float32)
        reading[reading < config.threshold] = 0.0
        np.minimum(reading, config.saturation, out=reading)
        if config.latency_steps == 0:
            return reading
        self._pending.append(reading)
        if len(self._pending) <= config.latency_steps:
            return self._pending[0].copy()
        return self._pending.popleft()

    def reset(self) -> None:
        """Forget delayed readings; until the delay has passed, the first new reading is repeated."""
        self._pending.clear()

    def state(self) -> NDArray[np.float32]:
        """Return the delayed readings, oldest first. Shape (pending, fingers, along, across), [N]."""
        return np.array(self._pending, np.float32).reshape(-1, len(self._pads), *self._taxels)

    def set_state(self, state: NDArray[np.float32]) -> None:
        """Continue exactly from a `state`."""
        self._pending = deque(reading.copy() for reading in state)

    def _nearest(self, data: mujoco.MjData, finger: int) -> NDArray[np.float64]:
        """Return each taxel's share of a force that reaches none through the skin: (taxels,), sum 1."""
        pad = self._pads[finger]
        offset = data.sensordata[self._point[finger]] - data.site_xpos[pad]
        centre = offset @ data.site_xmat[pad].reshape(3, 3)  # pad frame
        shares = []
        for n, pitch, x in zip(self._taxels, self._pitch, centre, strict=False):
            position = (np.arange(n) - (n - 1) / 2) * pitch
            distance = position - np.clip(x, position[0], position[-1])
            shares.append(np.exp(-0.5 * (distance / _UNSHAPED_SPREAD) ** 2))
        share = np.outer(*shares).ravel()
        return share / share.sum()


def _sensor_address(model: mujoco.MjModel, name: str) -> int:
    sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    if sensor < 0:
        raise DexFlexError(
            f"The model has no sensor '{name}'. Call `add_touch(spec, hand)` before compiling it."
        )
    return int(model.sensor_adr[sensor])
