"""The things of AssembleTable: a leg with a stud, its rack, and a table top with a thread that catches."""

import mujoco
import numpy as np

from lerobot_dexflex.envs.scene import ContactSurface, Pose2, add_block, add_wall
from lerobot_dexflex.envs.thread import add_thread
from lerobot_dexflex.hand.poses import quaternion_of, quaternion_product

LEG_LENGTH, STUD_LENGTH, STUD_RADIUS = 0.12, 0.016, 0.0072
PITCH, TURNS = 0.004, 0.35
"""The thread: lead per turn [m], and turns until the leg is tight and the table top lights."""
THREAD_ENTRY = 0.016
"""Height of the thread's first turn above the table [m]; socket and funnel rise 4 and 18 mm above it."""
LAMP_HEIGHT = 0.0115
"""Height of the lit lamp, just above the board [m]; the dark one hides as far inside the work table."""
_SOCKET_GAP = 0.002
"""Play of the stud in the socket [m], less than `CATCH_RADIUS`: no stud stands in it uncaught."""
RACK_FLOOR, _RACK_GAP = 0.004, 0.0015
_BOARD_HALF_SIZE = (0.09, 0.07, 0.005)


def add_rack(spec: mujoco.MjSpec, pose: Pose2, lean: float, leg_radius: float) -> None:
    """Add a floor and four walls in which the leg stands on its stud, leaning about its y axis [rad]."""
    x, y, yaw = pose
    grey = (0.3, 0.3, 0.5, 1)
    turn = quaternion_of(np.array([0.0, 0.0, yaw]))
    quaternion = quaternion_product(turn, quaternion_of(np.array([0.0, lean, 0.0])))
    rack = spec.worldbody.add_body(name="rack", pos=(x, y, 0), quat=quaternion)
    add_block(rack, "rack_floor", (0.022, 0.022, RACK_FLOOR / 2), (0, 0, RACK_FLOOR / 2), grey)
    inside = leg_radius + _RACK_GAP
    for k in range(4):
        add_wall(rack, f"rack_wall{k}", k * np.pi / 2, inside, (0.004, 0.018, 0.020), grey)


def add_table_top(spec: mujoco.MjSpec, pose: Pose2) -> None:
    """Add the upturned table top: board, socket with a funnel, and a lamp that rises around it when lit."""
    x, y, yaw = pose
    top = spec.worldbody.add_body(
        name="table_top", pos=(x, y, 0), quat=(np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    )
    add_block(top, "board", _BOARD_HALF_SIZE, (0, 0, _BOARD_HALF_SIZE[2]), (0.55, 0.38, 0.22, 1))
    inside, rim = STUD_RADIUS + _SOCKET_GAP, THREAD_ENTRY + 0.004
    dark, light = (0.25, 0.25, 0.28, 1), (0.38, 0.38, 0.42, 1)
    for k in range(8):
        angle = k * np.pi / 4
        add_wall(top, f"socket{k}", angle, inside, (0.006, 0.0065, rim / 2), dark)
        add_wall(top, f"funnel{k}", angle, inside, (0.002, 0.0115, 0.010), light, rim, np.pi / 4)
    lamp = spec.worldbody.add_body(name="lamp", pos=(x, y, -LAMP_HEIGHT), mocap=True)
    lamp.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(0.045, 0.001, 0),
        contype=0,
        conaffinity=0,
        rgba=(1.0, 0.9, 0.2, 1),
    )


def add_leg(spec: mujoco.MjSpec, shaft_radius: float, mass: float) -> None:
    """Add the leg: a shaft, and a stud below it that carries the thread."""
    body = spec.worldbody.add_body(name="leg")
    body.add_freejoint(name="leg")
    for name, radius, length, centre, share, rgba in (
        ("leg_shaft", shaft_radius, LEG_LENGTH, LEG_LENGTH / 2, 0.9, (0.85, 0.55, 0.2, 1)),
        ("leg_stud", STUD_RADIUS, STUD_LENGTH, -STUD_LENGTH / 2, 0.1, (0.75, 0.75, 0.78, 1)),
    ):
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=(radius, length / 2, 0),
            pos=(0, 0, centre),
            mass=share * mass,
            rgba=rgba,
            **ContactSurface(condim=4)._asdict(),
        )


def add_leg_thread(spec: mujoco.MjSpec, position: tuple[float, float]) -> None:
    """Add the thread in the socket, with a floor for the stud that turns as it sinks.

    Friction holds 15 N of axial pull on a pitch of 4 mm.
    """
    core = add_thread(spec, (*position, THREAD_ENTRY), PITCH, TURNS, 0.01, "leg", STUD_LENGTH)
    core.add_geom(
        name="thread_floor",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(STUD_RADIUS, 0.002, 0),
        pos=(0, 0, -0.002),
        rgba=(0.9, 0.2, 0.1, 1),
        **ContactSurface()._asdict(),
    )
    spec.add_exclude(bodyname1="core", bodyname2="table_top")
