"""Pieces that scenes share: the robot at its table, light, floor, blocks and cameras."""

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_dexflex.envs.rendering import add_lights, tune_visuals
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.arm import arm_for
from lerobot_dexflex.hand.grasp_frame import palm_point, palm_turn
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.hands.body import Vector3

Pose2 = tuple[float, float, float]
"""Position x, y on the table [m] and yaw [rad]."""
_BALL_DAMPING = 5e-7
"""Rolling resistance [N m s/rad]: a ball of 15 mm and 1.5 g loses its speed in about 0.2 s."""


class ContactSurface(NamedTuple):
    """Contact settings of a scene's geoms, by MuJoCo's names."""

    contype: int = robot.WORLD_COLLISION[0]
    conaffinity: int = robot.WORLD_COLLISION[1]
    condim: int = 3
    friction: Vector3 = (0.6, 0.005, 0.0001)
    """Sliding [1], torsional [m] and rolling [m]; fingertips overrule it."""


def robot_at_table(hand: Hand, tip_friction: float) -> tuple[mujoco.MjSpec, mujoco.MjsBody]:
    """Return a lit scene of floor, table and robot, and the robot's palm.

    Args:
        hand: The hand on the arm.
        tip_friction: Sliding friction of the fingertips [1].
    """
    spec = robot.base_spec()
    _add_studio(spec)
    _add_table(spec)
    friction = (tip_friction, *robot.TIP_FRICTION[1:])
    palm = robot.add_hand(spec, robot.add_arm(spec), hand, tip_friction=friction)
    return spec, palm


def place_robot(hand: Hand, data: mujoco.MjData, arm: ArrayLike) -> None:
    """Put the robot of `robot_at_table`, and its servos' targets, at rest.

    Args:
        hand: The hand on the arm, which relaxes.
        data: Changed in place.
        arm: Joints of the arm as tasks are written, see `arm_for` [rad]. Shape (7,).
    """
    joints = np.concatenate([arm_for(hand, arm), hand.relaxed_joints])
    data.qpos[: len(joints)] = data.ctrl[:] = joints


def _add_studio(spec: mujoco.MjSpec) -> None:
    """Add lights, render settings and the floor half a metre below the robot's base."""
    tune_visuals(spec)
    add_lights(spec)
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(2, 2, 0.1),
        pos=(0, 0, -0.5),
        contype=1,
        conaffinity=1,
        rgba=(0.3, 0.3, 0.35, 1),
    )


def _add_table(spec: mujoco.MjSpec) -> None:
    """Add a table whose top is the plane z = 0."""
    contype, conaffinity = robot.WORLD_COLLISION
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.45, 0.6, 0.02),
        pos=(0.45, 0, -0.02),
        contype=contype,
        conaffinity=conaffinity,
        friction=(0.8, 0.005, 0.0001),
        rgba=(0.62, 0.6, 0.56, 1),
    )


def add_block(body: mujoco.MjsBody, name: str, half_size: Any, position: Any, rgba: Any) -> mujoco.MjsGeom:
    """Add a box of the scene, half size and position in the body's frame [m]."""
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half_size,
        pos=position,
        rgba=rgba,
        **ContactSurface()._asdict(),
    )


def add_ball(spec: mujoco.MjSpec, name: str, radius: float, mass: float) -> mujoco.MjsGeom:
    """Add a free ball that soon stops rolling, radius [m] and mass [kg]."""
    ball = spec.worldbody.add_body(name=name)
    joint = ball.add_freejoint(name=name)
    joint.damping[0] = _BALL_DAMPING
    return ball.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(radius, 0, 0),
        mass=mass,
        rgba=(0.95, 0.25, 0.15, 1),
        **ContactSurface(friction=(0.3, 0.001, 0.0001))._asdict(),
    )


def ball_states(data: mujoco.MjData, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centres [m] (n, 3) and speeds [m/s] (n,) of the balls `ball0`, `ball1`, ... in the world."""
    positions = np.stack([data.body(f"ball{k}").xpos for k in range(n)])
    return positions, np.array([float(np.linalg.norm(data.joint(f"ball{k}").qvel[:3])) for k in range(n)])


def add_wall(
    body: mujoco.MjsBody,
    name: str,
    angle: float,
    inside: float,
    size: tuple[float, float, float],
    rgba: Any,
    base: float = 0.0,
    lean: float = 0.0,
) -> mujoco.MjsGeom:
    """Add a block beside the body's z axis, its inner lower edge `inside` [m] off it and `base` [m] up.

    It stands toward `angle` about z [rad] and leans outward by `lean` [rad].
    """
    sin, cos = np.sin(lean), np.cos(lean)
    distance = inside + size[2] * sin + size[0] * cos
    height = base + size[2] * cos - size[0] * sin
    wall = add_block(body, name, size, (distance * np.cos(angle), distance * np.sin(angle), height), rgba)
    wall.quat = (
        np.cos(angle / 2) * np.cos(lean / 2),
        -np.sin(angle / 2) * np.sin(lean / 2),
        np.cos(angle / 2) * np.sin(lean / 2),
        np.sin(angle / 2) * np.cos(lean / 2),
    )
    return wall


def add_camera(spec: mujoco.MjSpec, name: str, position: Vector3, target: Vector3, fovy: float) -> None:
    """Add a fixed camera at `position` looking at `target` (world frame [m]), field of view [deg]."""
    _look_at(spec.worldbody, name, position, target, (0.0, 0.0, 1.0), fovy)


def add_palm_camera(
    hand: Hand,
    palm: mujoco.MjsBody,
    name: str,
    position: Vector3,
    target: Vector3,
    fovy: float,
    up: Vector3 = (0.0, 1.0, 0.0),
) -> None:
    """Add a camera that sees every hand alike, its pose as tasks are written, see `palm_point`.

    Args:
        hand: Whose palm.
        palm: Body of the palm, or a body with its frame.
        name: The camera's name.
        position: Where it is, palm frame [m].
        target: What it looks at, palm frame [m].
        fovy: Field of view [deg].
        up: Direction that is up in the image, palm frame.
    """
    there, goal = (palm_point(hand, point) for point in (position, target))
    _look_at(palm, name, there, goal, palm_turn(hand) @ up, fovy)


def _look_at(body: Any, name: str, position: Any, target: Any, up: Any, fovy: float) -> None:
    backward = np.subtract(position, target)
    right = np.cross(up, backward)
    upward = np.cross(backward, right)
    body.add_camera(name=name, pos=position, xyaxes=(*right, *upward), fovy=fovy)
