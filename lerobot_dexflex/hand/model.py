"""Build the robot as an `MjSpec` from tables of numbers: primitives only, no mesh files."""

from collections.abc import Sequence

import mujoco
import numpy as np

from lerobot_dexflex.hand import leap, xarm7
from lerobot_dexflex.hand.body import Inertia, Link, Quaternion, Vector3

FINGERS = leap.FINGERS
ARM_JOINTS = tuple(link.joint for link in xarm7.LINKS)
HAND_JOINTS = tuple(link.joint for link in leap.LINKS)
JOINTS = ARM_JOINTS + HAND_JOINTS

TIMESTEP = 0.002
"""Physics step [s]."""
SUBSTEPS = 25
"""Physics steps per control step: 20 Hz control."""

PALM_MOUNT_POSITION = (0.065, -0.04, 0.0)
"""Palm origin in the flange frame [m]."""
PALM_MOUNT_QUATERNION = (0, 1, 0, 0)

# Collision groups: (contype, conaffinity). Links touch the world and fingertips, never each other.
WORLD_COLLISION = (1, 7)
LINK_COLLISION = (2, 0)
TIP_COLLISION = (4, 6)

HAND_RELAXED = (0.7, 0.0, 0.37, -0.3) * 3 + (1.2, 0.0, 0.39, -0.38)
"""Fingers at rest, stretched forward [rad]."""
TIP_FRICTION = (1.0, 0.005, 0.0001)
TIP_SOLREF = (2 * TIMESTEP, 1.0)
"""Stiff tips: contact slip under arm motion grows with this time constant."""

_ARM_COLOR = (0.88, 0.88, 0.9, 1)
_HAND_COLOR = (0.2, 0.2, 0.22, 1)
_TIP_COLOR = (0.95, 0.95, 0.93, 1)


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
        body = bodies[link.name] = _add_link(bodies[link.parent], link, xarm7.JOINT_AXIS)
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
    position: Vector3 = PALM_MOUNT_POSITION,
    quaternion: Quaternion = PALM_MOUNT_QUATERNION,
    tip_friction: Sequence[float] = TIP_FRICTION,
) -> mujoco.MjsBody:
    """Add the LEAP hand to `parent` and return the body `palm`.

    Args:
        spec: The spec to extend.
        parent: Body that carries the palm (the flange, or the world for a hand-only model).
        position: Palm origin in the parent frame [m].
        quaternion: Palm orientation in the parent frame (w x y z).
        tip_friction: Sliding [1], torsional [m] and rolling [m] friction of the fingertips, which win
            over whatever they touch.
    """
    bodies = {"palm": _add_body(parent, "palm", position, quaternion, leap.PALM_INERTIA)}
    _add_boxes(bodies["palm"], leap.PALM_COLLISION)
    for link in leap.LINKS:
        body = bodies[link.name] = _add_link(bodies[link.parent], link, leap.JOINT_AXIS)
        _set_joint(body, leap.ARMATURE, leap.DAMPING, leap.FRICTION_LOSS)
        _add_servo(spec, link, leap.KP, leap.KV, leap.TORQUE)
        _add_boxes(body, leap.COLLISION[link.name])
    for finger in FINGERS:
        _add_fingertip(bodies[f"{finger}_ds"], finger, tip_friction)
        for link in ("bs", "mp") if finger == "th" else ("px", "bs"):
            spec.add_exclude(bodyname1=f"{finger}_ds", bodyname2=f"{finger}_{link}")
    return bodies["palm"]


def _add_body(
    parent: mujoco.MjsBody, name: str, position: Vector3, quaternion: Quaternion, inertia: Inertia
) -> mujoco.MjsBody:
    unit = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    body = parent.add_body(name=name, pos=position, quat=unit)
    body.mass, body.ipos, body.iquat, body.inertia = inertia
    body.explicitinertial = True
    body.gravcomp = 1.0
    return body


def _add_link(parent: mujoco.MjsBody, link: Link, axis: Vector3) -> mujoco.MjsBody:
    body = _add_body(parent, link.name, link.position, link.quaternion, link.inertia)
    body.add_joint(
        name=link.joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, range=link.joint_range, limited=True
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


def _add_boxes(body: mujoco.MjsBody, boxes: Sequence[leap.Box]) -> None:
    contype, conaffinity = LINK_COLLISION
    for k, box in enumerate(boxes):
        body.add_geom(
            name=f"{body.name}_c{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=box.half_size,
            pos=box.position,
            contype=contype,
            conaffinity=conaffinity,
            friction=(0.3, 0.005, 0.0001),
            mass=0,
            rgba=_HAND_COLOR,
        )


def _add_fingertip(body: mujoco.MjsBody, finger: str, friction: Sequence[float]) -> None:
    """Add a flat pad block with a rounded nose, the tip site and the pad frame."""
    x, y, z = leap.PAD_POSITION[finger]
    centre_x = x + leap.TIP_THICKNESS
    half_along, half_across = leap.PAD_HALF_SIZE
    contype, conaffinity = TIP_COLLISION
    surface = {
        "contype": contype,
        "conaffinity": conaffinity,
        "condim": 4,
        "priority": 1,
        "friction": friction,
        "solref": TIP_SOLREF,
        "mass": 0,
        "rgba": _TIP_COLOR,
    }
    body.add_geom(
        name=f"{finger}_tip",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(leap.TIP_THICKNESS, half_along - 0.001, half_across),
        pos=(centre_x, y + 0.001, z),
        **surface,
    )
    body.add_geom(
        name=f"{finger}_nose",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=(0.0085, 0.004, 0),
        pos=(centre_x, y - 0.0085, z),
        **surface,
    )
    body.add_site(name=f"{finger}_tip", pos=leap.TIP_POSITION[finger], group=4)
    body.add_site(name=f"{finger}_pad", pos=(x, y, z), quat=leap.PAD_QUATERNION, group=4)
