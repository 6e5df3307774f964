"""Describe, sample and build programmatic objects: box, cylinder, capsule, and tool (handle with a head).

Every object is a union of primitives around its body frame, whose z axis is the long (or handle) axis.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.model import WORLD_COLLISION
from lerobot_dexflex.hands.body import Quaternion, Vector3

Colour = tuple[float, float, float]

SIZES = {
    "box": ("half_x", "half_y", "half_z"),
    "cylinder": ("radius", "half_length"),
    "capsule": ("radius", "half_length"),
    "tool": ("handle_radius", "handle_half_length", "head_half_x", "head_half_y", "head_half_z"),
}
"""Meaning of `ObjectSpec.size` for every kind [m]. Half lengths of capsules leave out the round caps."""

TORSIONAL_FRICTION, ROLLING_FRICTION = 0.005, 0.0001
_GEOM = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}


class Part(NamedTuple):
    """One primitive of an object."""

    shape: str
    """`box`, `cylinder` or `capsule`, its axis along z."""
    size: tuple[float, ...]
    """As in `SIZES` [m]."""
    position: Vector3
    """Centre in the body frame [m]."""

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        if self.shape == "box":
            return 8 * float(np.prod(self.size))
        radius, half = self.size
        return np.pi * radius**2 * (2 * half + (4 / 3 * radius if self.shape == "capsule" else 0.0))


@dataclass(frozen=True)
class ObjectSpec:
    """A rigid object made of primitives.

    Raises:
        DexFlexError: If the kind is unknown or a number makes no physical sense.
    """

    kind: str
    """`box`, `cylinder`, `capsule` or `tool`."""
    size: tuple[float, ...]
    """Half extents and radii [m], in the order of `SIZES[kind]`."""
    mass: float
    """Total mass [kg], shared by the parts in proportion to their volume."""
    friction: float = 1.0
    """Sliding friction [1]. Fingertips override it (see `add_hand`): give it to them where they touch."""
    colour: Colour = (0.85, 0.35, 0.2)
    """Red, green, blue in [0, 1]."""
    mark_colour: Colour = (0.95, 0.9, 0.3)
    """Colour of the stripe that makes the spin about a symmetry axis visible."""

    def __post_init__(self) -> None:
        if self.kind not in SIZES:
            raise DexFlexError(f"Unknown object kind {self.kind!r}. Valid kinds: {', '.join(SIZES)}.")
        names = SIZES[self.kind]
        if len(self.size) != len(names) or not all(np.isfinite(s) and 0 < s < 1 for s in self.size):
            raise DexFlexError(
                f"`size` of a {self.kind} must be {len(names)} lengths ({', '.join(names)}) in (0, 1) m. "
                f"Got {self.size}."
            )
        if not (np.isfinite(self.mass) and self.mass > 0):
            raise DexFlexError(f"`mass` must be positive, in kg. Got {self.mass}.")
        if not (np.isfinite(self.friction) and self.friction >= 0):
            raise DexFlexError(f"`friction` must be 0 or more. Got {self.friction}.")
        for name in ("colour", "mark_colour"):
            colour = getattr(self, name)
            if len(colour) != 3 or not all(0 <= c <= 1 for c in colour):
                raise DexFlexError(f"`{name}` must be red, green, blue in [0, 1]. Got {colour}.")

    @classmethod
    def of_density(
        cls, kind: str, size: tuple[float, ...], density: float, friction: float = 1.0
    ) -> "ObjectSpec":
        """Return an object whose mass follows from its volume and `density` [kg/m^3]."""
        volume = sum(part.volume for part in cls(kind, size, 1.0).parts)
        return cls(kind, size, density * volume, friction)

    @property
    def parts(self) -> tuple[Part, ...]:
        """The primitives; a tool's frame sits in the middle of its handle, its head at the +z end."""
        if self.kind != "tool":
            return (Part(self.kind, self.size, (0.0, 0.0, 0.0)),)
        radius, half_length, *head = self.size
        top = half_length + 0.5 * radius
        return Part("capsule", (radius, half_length), (0.0, 0.0, 0.0)), Part(
            "box", tuple(head), (0.0, 0.0, top)
        )


def sample_object(rng: np.random.Generator, kind: str | None = None) -> ObjectSpec:
    """Draw a hand-sized object: 3 to 8 cm, 30 to 250 g (log-uniform), friction 0.5 to 1.2.

    Tools have handles 2.6 to 4 cm thick and 7 to 11 cm long, with heads of 3 to 5 cm.

    Args:
        rng: Source of randomness; the same state draws the same object.
        kind: Kind to draw, or None for any.
    """
    kind = str(rng.choice(list(SIZES))) if kind is None else kind
    if kind == "box":
        size = rng.uniform(0.015, [0.033, 0.040, 0.040])
    elif kind == "cylinder":
        size = rng.uniform([0.015, 0.020], [0.034, 0.040])
    elif kind == "capsule":
        size = rng.uniform([0.015, 0.008], [0.030, 0.025])
    else:
        size = rng.uniform([0.013, 0.022, *[0.015] * 3], [0.020, 0.035, *[0.025] * 3])
    mass = float(np.exp(rng.uniform(np.log(0.03), np.log(0.25))))
    friction = float(rng.uniform(0.5, 1.2))
    hue = rng.random()
    return ObjectSpec(kind, tuple(map(float, size)), mass, friction, _bright(hue), _bright(hue + 0.45))


def add_object(
    spec: mujoco.MjSpec,
    object_spec: ObjectSpec,
    name: str,
    position: Vector3 = (0.0, 0.0, 0.0),
    quaternion: Quaternion = (1, 0, 0, 0),
) -> mujoco.MjsBody:
    """Add a freely moving object and return its body; its joint is `{name}_free`, its geoms `{name}_0`, ...

    Args:
        spec: The spec to extend.
        object_spec: What to build.
        name: Name of the body.
        position: Initial position in the world [m].
        quaternion: Initial orientation in the world (w x y z).
    """
    body = spec.worldbody.add_body(name=name, pos=position, quat=quaternion)
    body.add_freejoint(name=f"{name}_free")
    contype, conaffinity = WORLD_COLLISION
    volume = sum(part.volume for part in object_spec.parts)
    for k, part in enumerate(object_spec.parts):
        _add_part(
            body,
            part,
            f"{name}_{k}",
            mass=object_spec.mass * part.volume / volume,
            friction=(object_spec.friction, TORSIONAL_FRICTION, ROLLING_FRICTION),
            condim=4,
            contype=contype,
            conaffinity=conaffinity,
            rgba=(*object_spec.colour, 1),
        )
    _add_mark(body, object_spec, f"{name}_mark", 1.0)
    return body


def add_ghost(
    spec: mujoco.MjSpec, object_spec: ObjectSpec, name: str, opacity: float = 0.35
) -> mujoco.MjsBody:
    """Add a translucent, intangible copy of an object as a mocap body: the picture of a goal pose."""
    body = spec.worldbody.add_body(name=name, mocap=True)
    for k, part in enumerate(object_spec.parts):
        rgba = (*object_spec.colour, opacity)
        _add_part(body, part, f"{name}_{k}", mass=0, contype=0, conaffinity=0, rgba=rgba)
    _add_mark(body, object_spec, f"{name}_mark", opacity)
    return body


def _bright(hue: float) -> Colour:
    """Return a saturated colour of a hue in turns."""
    red, green, blue = (float(0.55 + 0.4 * np.cos(2 * np.pi * (hue - k / 3))) for k in range(3))
    return red, green, blue


def _add_part(body: mujoco.MjsBody, part: Part, name: str, **options: Any) -> None:
    size = [*part.size, 0.0, 0.0][:3]
    body.add_geom(name=name, type=_GEOM[part.shape], size=size, pos=part.position, **options)


def _add_mark(body: mujoco.MjsBody, object_spec: ObjectSpec, name: str, opacity: float) -> None:
    """Lay a stripe along the +x side: pictures alone would not show how a cylinder is turned."""
    part = object_spec.parts[0]
    reach, half_length = part.size[0], part.size[-1]
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.0015, 0.004, 0.85 * half_length),
        pos=(reach - 0.001, 0.0, 0.0),
        contype=0,
        conaffinity=0,
        mass=0,
        rgba=(*object_spec.mark_colour, opacity),
    )
