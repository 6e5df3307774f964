"""What differs from episode to episode beside object and grasp: servos, sensors, pushes, slips, fixtures.

Everything is stored with the episode, so that a replay rebuilds the same simulator.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.hand.grasp import HOLD, OBJECT
from lerobot_dexflex.hand.grasp_candidates import GRAVITY
from lerobot_dexflex.hand.model import tip_geoms
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hands import Hand

_GAIN, _DAMPING = (0.85, 1.15), (0.7, 1.5)
_MASS, _MASS_RANGE = (0.6, 1.5), (0.02, 0.3)
_FRICTION, _FRICTION_RANGE = (0.75, 1.25), (0.4, 1.2)
_MAX_JOINT_NOISE = 0.004
_MAX_GRAVITY_RATE = 0.2
_PUSH_SHARE, _MAX_PUSH, _MAX_TWIST = (0.2, 1.0), 2.0, 0.03
_PUSH_STEPS, _LOAD_STEPS, _LOAD_SHARE = (2, 7), (15, 60), 0.4
"""Of blows and of lasting loads (a lever, a thread, something scraped); and the share of the latter."""
_SLIP_STEPS, _SLIP_SHARE = (4, 13), (0.3, 0.7)
_MAX_SWAY, _SWAY_PERIOD = 4.0, (15.0, 60.0)
"""Acceleration of a moving palm [m/s^2], and control steps of its period."""
_LEVER_SHARE, _MAX_LEVER, _MAX_LEVER_TORQUE = 0.5, 0.05, 0.08
"""How often the centre of mass is off, by how much [m] and by which torque of gravity [N m] at most."""
_MEAN_INTERVAL = 50
"""Control steps from one push, and from one slip, to the next."""


@dataclass(frozen=True)
class Push:
    """A force on the object's centre of mass, and a torque: a blow, or a lasting load."""

    start: int
    """Control step of the episode at which it begins."""
    steps: int
    force: tuple[float, ...]
    """In the palm frame [N]."""
    torque: tuple[float, ...]
    """In the palm frame [N m]."""


@dataclass(frozen=True)
class Slip:
    """Fingertips that grip less for a while."""

    start: int
    steps: int
    share: float
    """Of the fingertips' friction [1]."""


@dataclass
class Support:
    """A fixture that carries the object at one pose."""

    start: int
    stop: int | None
    """First control step without it; None if it stays."""
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    softness: float
    """Time constant of the fixture [s]."""


@dataclass(frozen=True)
class Hinge:
    """A bearing that carries the object throughout and lets it turn about one axis, against dry friction."""

    position: tuple[float, ...]
    """Of the object when the episode begins, through which the axis runs [m]."""
    quaternion: tuple[float, ...]
    """Orientation of the object then (w x y z)."""
    axis: tuple[float, ...]
    """Unit vector, palm frame."""
    friction: float
    """Torque that turns it [N m]."""
    softness: float
    """Time constant of the bearing [s]."""


@dataclass
class World:
    """Circumstances of one episode; control steps count from its start."""

    seed: int = 0
    """Of the sensors' noise."""
    gravity_rate: float = 0.0
    """How fast gravity turns [rad/s]."""
    gains: tuple[float, ...] | None = None
    """Share of the servos' position gain, per joint of the hand; None leaves them as they are."""
    damping: float = 1.0
    """Share of the joints' damping."""
    joint_noise: float = 0.0
    """Standard deviation of measured joints [rad]."""
    sway: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Amplitude of the palm's acceleration, which the object feels [m/s^2], palm frame."""
    sway_period: float = 1.0
    """Of that [control steps]."""
    lever: tuple[float, ...] = (0.0, 0.0, 0.0)
    """How far the object's centre of mass is moved, as a tool's head does [m], object frame."""
    pushes: list[Push] = field(default_factory=list)
    slips: list[Slip] = field(default_factory=list)
    supports: list[Support] = field(default_factory=list)
    hinge: Hinge | None = None
    """Carries the object instead of supports."""

    @classmethod
    def sample(cls, hand: Hand, rng: np.random.Generator, turning: float = 0.5) -> "World":
        """Draw a hand's servos and sensors; gravity turns in a share `turning` of the episodes."""
        rate = rng.uniform(-_MAX_GRAVITY_RATE, _MAX_GRAVITY_RATE) if rng.random() < turning else 0.0
        return cls(
            seed=int(rng.integers(2**31)),
            gravity_rate=float(rate),
            gains=tuple(rng.uniform(*_GAIN, hand.n_joints).tolist()),
            damping=float(rng.uniform(*_DAMPING)),
            joint_noise=float(rng.uniform(0, _MAX_JOINT_NOISE)),
        )

    def disturb(self, rng: np.random.Generator, steps: int, mass: float) -> None:
        """Let the palm move, the centre of mass be off; add wrenches and slips within `steps` steps.

        Args:
            rng: Source of randomness.
            steps: Length of the episode [control steps].
            mass: Of the object [kg].
        """
        weight = max(mass * GRAVITY, 1.0)
        if rng.random() < 0.5:
            self.sway = tuple((rng.uniform(0, _MAX_SWAY) * _direction(rng)).tolist())
            self.sway_period = float(rng.uniform(*_SWAY_PERIOD))
        if rng.random() < _LEVER_SHARE:
            arm = min(_MAX_LEVER, _MAX_LEVER_TORQUE / (mass * GRAVITY))
            self.lever = tuple((rng.uniform(0, arm) * _direction(rng)).tolist())
        for start in _starts(rng, steps):
            force = min(rng.uniform(*_PUSH_SHARE) * weight, _MAX_PUSH) * _direction(rng)
            torque = rng.uniform(0, _MAX_TWIST) * _direction(rng)
            length = _LOAD_STEPS if rng.random() < _LOAD_SHARE else _PUSH_STEPS
            self.pushes.append(
                Push(start, int(rng.integers(*length)), tuple(force.tolist()), tuple(torque.tolist()))
            )
        for start in _starts(rng, steps):
            self.slips.append(Slip(start, int(rng.integers(*_SLIP_STEPS)), float(rng.uniform(*_SLIP_SHARE))))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "World":
        """Return the world that `to_dict` described."""
        events = {
            "gains": tuple(values["gains"]) if values["gains"] else None,
            "sway": tuple(values["sway"]),
            "lever": tuple(values["lever"]),
            "pushes": [Push(**entry) for entry in values["pushes"]],
            "slips": [Slip(**entry) for entry in values["slips"]],
            "supports": [Support(**entry) for entry in values["supports"]],
            "hinge": Hinge(**values["hinge"]) if values["hinge"] else None,
        }
        return cls(**{**values, **events})


def vary_object(spec: ObjectSpec, rng: np.random.Generator) -> ObjectSpec:
    """Return the object with another mass and friction, which nobody sees."""
    mass = np.clip(spec.mass * rng.uniform(*_MASS), *_MASS_RANGE)
    friction = np.clip(spec.friction * rng.uniform(*_FRICTION), *_FRICTION_RANGE)
    return replace(spec, mass=float(mass), friction=float(friction))


def add_hinge(spec: mujoco.MjSpec) -> None:
    """Add the bearing that a `World` with a hinge welds its object to; without one it carries nothing."""
    core = spec.worldbody.add_body(name="hinge").add_body(name="hinge_core")
    core.mass, core.inertia, core.explicitinertial, core.gravcomp = 0.01, (1e-5, 1e-5, 1e-5), True, 1.0
    joint = core.add_joint(name="hinge_turn", type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 0, 1))
    joint.armature, joint.damping[0] = 2e-4, 0.002
    weld = spec.add_equality(name="hinge_weld", type=mujoco.mjtEq.mjEQ_WELD, name1="hinge_core", name2=OBJECT)
    weld.objtype = mujoco.mjtObj.mjOBJ_BODY
    weld.active = False


class WorldPhysics:
    """Apply a world to the model of an episode, freshly compiled.

    Args:
        hand: The hand in the scene.
        model: Model of the scene; servos and damping are changed once, here.
        world: What to apply; supports may be added while it runs.
    """

    def __init__(self, hand: Hand, model: mujoco.MjModel, world: World) -> None:
        self._model, self._world = model, world
        joints = slice(hand.n_joints)
        if world.gains is not None:
            model.actuator_gainprm[joints, 0] *= np.array(world.gains)
            model.actuator_biasprm[joints, 1] *= np.array(world.gains)
        model.dof_damping[joints] *= world.damping
        self._tips = [model.geom(name).id for name in tip_geoms(hand)]
        self._friction = model.geom_friction[self._tips, 0].copy()
        self._object, self._weld = model.body(OBJECT).id, model.equality(HOLD).id
        if any(world.lever):
            model.body_ipos[self._object] += world.lever
            model.body_sameframe[self._object] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self._bearing = model.equality("hinge_weld").id
        if world.hinge is not None:
            self._mount(world.hinge)

    def _mount(self, hinge: Hinge) -> None:
        """Put the bearing where it belongs; the object is welded to it as it lies."""
        model, frame, inverse, held = self._model, np.empty(4), np.empty(4), np.empty(4)
        mujoco.mju_quatZ2Vec(frame, np.array(hinge.axis))
        mujoco.mju_negQuat(inverse, frame)
        mujoco.mju_mulQuat(held, inverse, np.array(hinge.quaternion))
        body = model.body("hinge").id
        model.body_pos[body], model.body_quat[body] = hinge.position, frame
        model.dof_frictionloss[model.joint("hinge_turn").dofadr[0]] = hinge.friction
        model.eq_data[self._bearing] = 0.0
        model.eq_data[self._bearing, 6:11] = (*held, 1.0)
        model.eq_solref[self._bearing] = (hinge.softness, 1.0)

    def apply(self, data: mujoco.MjData, step: int) -> None:
        """Set forces, friction and support of a control step; call before every step."""
        world, model = self._world, self._model
        wave = np.sin(2 * np.pi * step / world.sway_period)
        wrench = np.zeros(6)
        wrench[:3] = model.body_mass[self._object] * wave * np.array(world.sway)
        for push in world.pushes:
            if push.start <= step < push.start + push.steps:
                wrench += (*push.force, *push.torque)
        data.xfrc_applied[self._object] = wrench
        share = min((s.share for s in world.slips if s.start <= step < s.start + s.steps), default=1.0)
        model.geom_friction[self._tips, 0] = share * self._friction
        data.eq_active[self._bearing] = world.hinge is not None
        support = self.support_at(step)
        data.eq_active[self._weld] = support is not None
        if support is not None:
            model.eq_data[self._weld] = 0.0
            model.eq_data[self._weld, 3:11] = (*support.position, *support.quaternion, 1.0)
            model.eq_solref[self._weld] = (support.softness, 1.0)

    def support_at(self, step: int) -> Support | None:
        """Return what carries the object in a control step."""
        for support in self._world.supports:
            if support.start <= step and (support.stop is None or step < support.stop):
                return support
        return None


def _starts(rng: np.random.Generator, steps: int) -> list[int]:
    return sorted(rng.integers(0, steps, rng.poisson(steps / _MEAN_INTERVAL)).tolist())


def _direction(rng: np.random.Generator) -> np.ndarray:
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)
