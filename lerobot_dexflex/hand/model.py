"""Build the robot as an `MjSpec` from tables of numbers: primitives only, no mesh files."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.hand import xarm7
from lerobot_dexflex.hands import PALM, Finger, Hand
from lerobot_dexflex.hands.body import Box, Inertia, Link, Quaternion, Shape, Vector3

ARM_JOINTS = tuple(link.joint for link in xarm7.LINKS)

TIMESTEP = 0.002
"""Physics step [s]."""
SUBSTEPS = 25
"""Physics steps per control step: 20 Hz control."""

# Collision groups: (contype, conaffinity). Links touch the world and fingertips, never each other.
WORLD_COLLISION = (1, 7)
LINK_COLLISION = (2, 0)
TIP_COLLISION = (4, 6)

TIP_FRICTION = (1.0, 0.005, 0.0001)
TIP_SOLREF = (2 * TIMESTEP, 1.0)
"""Stiff tips: contact slip under arm motion grows with this time constant."""

_ARM_COLOR = (0.88, 0.88, 0.9, 1)
_HAND_COLOR = (0.2, 0.2, 0.22, 1)
_TIP_COLOR = (0.95, 0.95, 0.93, 1)


def robot_joints(hand: Hand) -> tuple[str, ...]:
    """Return the names of all joints of the arm with a hand, in the model's order: the arm's come first."""
    return (*ARM_JOINTS, *hand.joint_names)


def tip_geoms(hand: Hand) -> tuple[str, ...]:
    """Return the names of the geoms that fingertips touch with."""
    return tuple(
        f"{finger.prefix}_{part}"
        for finger in hand.fingers
        for part in (("tip",) if finger.nose is None else ("tip", "nose"))
    )


def base_spec() -> mujoco.MjSpec:
    """Return an empty spec with the one physics setting that holds a grasp (elliptic cone, Newton)."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 30
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations = 100
    option.tolerance = 1e-8
    return spec


def add_arm(spec: mujoco.MjSpec, position: Vector3 = (0.0, 0.0, 0.0)) -> mujoco.MjsBody:
    """Add the xArm7 with its base at `position` [m] and return the flange body `link7`."""
    bodies = {"link_base": _add_body(spec.worldbody, "link_base", position, (1, 0, 0, 0), xarm7.BASE_INERTIA)}
    for link, drive in zip(xarm7.LINKS, xarm7.DRIVES, strict=True):
        body = bodies[link.name] = _add_link(bodies[link.parent], link)
        _set_joint(body, xarm7.ARMATURE, drive.damping, xarm7.FRICTION_LOSS)
        _add_servo(spec, link, drive.kp, drive.kv, drive.torque)
    contype, conaffinity = LINK_COLLISION
    for name, capsules in xarm7.COLLISION.items():
        for k, capsule in enumerate(capsules):
            bodies[name].add_geom(
                name=f"{name}_c{k}",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=(*capsule.start, *capsule.end),
                size=(capsule.radius, 0, 0),
                contype=contype,
                conaffinity=conaffinity,
                mass=0,
                rgba=_ARM_COLOR,
            )
    bodies["link7"].add_site(name="attachment_site", group=4)
    return bodies["link7"]


def add_hand(
    spec: mujoco.MjSpec,
    parent: mujoco.MjsBody,
    hand: Hand,
    position: Vector3 | None = None,
    quaternion: Quaternion | None = None,
    tip_friction: Sequence[float] = TIP_FRICTION,
) -> mujoco.MjsBody:
    """Add a hand to `parent` and return the body `palm`.

    Args:
        spec: The spec to extend.
        parent: Body that carries the palm (the flange, or the world for a hand-only model).
        hand: The hand.
        position: Palm origin in the parent frame [m]; by default as the hand is mounted on the flange.
        quaternion: Palm orientation in the parent frame (w x y z); by default as the hand is mounted.
        tip_friction: Sliding [1], torsional [m] and rolling [m] friction of the fingertips, which win
            over whatever they touch.
    """
    position = hand.mount_position if position is None else position
    quaternion = hand.mount_quaternion if quaternion is None else quaternion
    bodies = {PALM: _add_body(parent, PALM, position, quaternion, hand.palm_inertia)}
    _add_shapes(bodies[PALM], hand.palm_collision)
    for finger in hand.fingers:
        for link, motor, shapes in zip(finger.links, finger.motors, finger.collision, strict=True):
            body = bodies[link.name] = _add_link(bodies[link.parent], link)
            _set_joint(body, motor.armature, motor.damping, motor.friction_loss)
            _add_servo(spec, link, motor.position_gain, motor.velocity_gain, motor.torque)
            _add_shapes(body, shapes)
    for finger in hand.fingers:
        _add_fingertip(bodies[finger.distal], finger, tip_friction)
    for first, second in hand.excluded:
        spec.add_exclude(bodyname1=first, bodyname2=second)
    return bodies[PALM]


def _add_body(
    parent: mujoco.MjsBody, name: str, position: Vector3, quaternion: Quaternion, inertia: Inertia
) -> mujoco.MjsBody:
    unit = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    body = parent.add_body(name=name, pos=position, quat=unit)
    body.mass, body.ipos, body.iquat, body.inertia = inertia
    body.explicitinertial = True
    body.gravcomp = 1.0
    return body


def _add_link(parent: mujoco.MjsBody, link: Link) -> mujoco.MjsBody:
    body = _add_body(parent, link.name, link.position, link.quaternion, link.inertia)
    body.add_joint(
        name=link.joint,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=link.axis,
        range=link.joint_range,
        limited=True,
    )
    return body


def _set_joint(body: mujoco.MjsBody, armature: float, damping: float, friction_loss: float) -> None:
    joint = body.joints[0]
    joint.armature = armature
    joint.damping[0] = damping
    joint.frictionloss = friction_loss


def _add_servo(spec: mujoco.MjSpec, link: Link, kp: float, kv: float, torque: float) -> None:
    actuator = spec.add_actuator(name=link.joint, target=link.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_position(kp=kp, kv=kv)
    actuator.ctrlrange, actuator.ctrllimited = link.joint_range, True
    actuator.forcerange, actuator.forcelimited = (-torque, torque), True


def _add_shapes(body: mujoco.MjsBody, shapes: Sequence[Shape]) -> None:
    contype, conaffinity = LINK_COLLISION
    for k, shape in enumerate(shapes):
        body.add_geom(
            name=f"{body.name}_c{k}",
            **_geometry(shape),
            contype=contype,
            conaffinity=conaffinity,
            friction=(0.3, 0.005, 0.0001),
            mass=0,
            rgba=_HAND_COLOR,
        )


def _add_fingertip(body: mujoco.MjsBody, finger: Finger, friction: Sequence[float]) -> None:
    """Add the shape behind the pad and its nose, the tip site and the pad frame."""
    contype, conaffinity = TIP_COLLISION
    for part, shape in (("tip", finger.tip), ("nose", finger.nose)):
        if shape is not None:
            body.add_geom(
                name=f"{finger.prefix}_{part}",
                **_geometry(shape),
                contype=contype,
                conaffinity=conaffinity,
                condim=4,
                priority=1,
                friction=friction,
                solref=TIP_SOLREF,
                mass=0,
                rgba=_TIP_COLOR,
            )
    body.add_site(name=f"{finger.prefix}_tip", pos=finger.tip_position, group=4)
    pad = np.asarray(finger.pad_quaternion, float) / np.linalg.norm(finger.pad_quaternion)
    body.add_site(name=f"{finger.prefix}_pad", pos=finger.pad_position, quat=pad, group=4)


def _geometry(shape: Shape) -> dict[str, Any]:
    """Return what `add_geom` needs to know of a shape's form and place."""
    if isinstance(shape, Box):
        return {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": shape.half_size, "pos": shape.position}
    return {
        "type": mujoco.mjtGeom.mjGEOM_CAPSULE,
        "size": (shape.radius, shape.half_length, 0),
        "pos": shape.position,
        "quat": np.asarray(shape.quaternion, float) / np.linalg.norm(shape.quaternion),
    }
