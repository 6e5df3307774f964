"""The things of Screwdriver: a driver with a ball-ended bit, its stand, and a screw in a block."""

import mujoco
import numpy as np

from lerobot_dexflex.envs.scene import ContactSurface, Pose2, add_block, add_wall
from lerobot_dexflex.envs.thread import add_lead
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.poses import quaternion_of, quaternion_product

HANDLE_LENGTH, BIT_LENGTH, BIT_RADIUS = 0.13, 0.055, 0.003
STAND_HEIGHT = 0.060
"""Height of the stand, on which the handle rests, along its lean [m]."""
PITCH, TURNS = 0.002, 0.5
"""The screw: lead per turn [m], and turns until its head is down on the block."""
SEAT = 0.036
"""Height of the recess's floor above the table, the screw still loose [m]; its rim is 15 mm above that."""
SCREW_FRICTION = 0.02
"""Torque that turns the screw [N m]."""
BITE = 0.02
"""Torque that the bit passes on per force that presses it into the screw [N m/N]: less, and it slips out."""
_RECESS_GAP, _RECESS_DEPTH = 0.0003, 0.012
_STAND_GAP = 0.0012
_BLOCK_HALF_SIZE = (0.04, 0.04, 0.015)
_HANDLE_SHARE = 0.8
"""Share of the mass in the handle."""


def add_stand(spec: mujoco.MjSpec, pose: Pose2, lean: float) -> None:
    """Add four walls in which the shaft hangs, leaning about their x axis [rad]; the handle rests on them."""
    x, y, yaw = pose
    turn = quaternion_of(np.array([0.0, 0.0, yaw]))
    quaternion = quaternion_product(turn, quaternion_of(np.array([lean, 0.0, 0.0])))
    stand = spec.worldbody.add_body(name="stand", pos=(x, y, 0), quat=quaternion)
    size = (0.004, 0.010, STAND_HEIGHT / 2)
    for k in range(4):
        add_wall(stand, f"stand{k}", k * np.pi / 2, BIT_RADIUS + _STAND_GAP, size, (0.3, 0.3, 0.5, 1))


def add_screw(spec: mujoco.MjSpec, pose: Pose2) -> None:
    """Add a block and a screw that stands in it, sinks as it is turned clockwise, and stops when tight.

    The bit turns it by torsional friction alone, hence only while it is pressed onto the floor of the recess,
    and slips above `BITE` times that force. The recess is round: it keeps the bit upright to 8 degrees.
    """
    x, y, yaw = pose
    quaternion = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    block = spec.worldbody.add_body(name="block", pos=(x, y, 0), quat=quaternion)
    add_block(block, "block", _BLOCK_HALF_SIZE, (0, 0, _BLOCK_HALF_SIZE[2]), (0.55, 0.38, 0.22, 1))
    screw = spec.worldbody.add_body(name="screw", pos=(x, y, SEAT), quat=quaternion, gravcomp=1)
    turn = add_lead(spec, screw, "screw", PITCH, TURNS, SCREW_FRICTION, 0.05)
    turn.solref_friction = (2 * robot.TIMESTEP, 1)  # The default creeps below the friction's torque.
    _add_head(screw)
    spec.add_exclude(bodyname1="screw", bodyname2="block")


def _add_head(screw: mujoco.MjsBody) -> None:
    """Add the floor of the recess, walls with a chamfer above, and a neck; a red wall shows the turn."""
    dark, light = (0.35, 0.35, 0.4, 1), (0.6, 0.6, 0.65, 1)
    inside = BIT_RADIUS + _RECESS_GAP
    geoms = [
        screw.add_geom(
            name="screw_floor",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=(inside + 0.007, 0.002, 0),
            pos=(0, 0, -0.002),
            rgba=dark,
            **ContactSurface(condim=4, friction=(0.6, BITE, 0.0001))._asdict(),
        )
    ]
    for k in range(8):
        angle = k * np.pi / 4
        colour = (0.95, 0.2, 0.1, 1) if k == 0 else dark
        size = (0.0035, 0.0035, _RECESS_DEPTH / 2)
        geoms.append(add_wall(screw, f"recess{k}", angle, inside, size, colour))
        size = (0.0015, 0.005, 0.003)
        geoms.append(add_wall(screw, f"chamfer{k}", angle, inside, size, light, _RECESS_DEPTH, np.pi / 4))
    for geom in geoms:  # Steel: the default would let the bit sink in by millimetres.
        geom.priority, geom.solref = 1, robot.TIP_SOLREF
    for wall in geoms[1:]:  # A bit that is wedged in askew is not to turn the screw.
        wall.friction[0] = 0.2
    add_block(screw, "screw_neck", (0.003, 0.003, 0.004), (0, 0, -0.008), dark)


def add_driver(spec: mujoco.MjSpec, handle_radius: float, mass: float) -> None:
    """Add the driver: its frame is at the handle's lower end, z along the handle, the bit below."""
    body = spec.worldbody.add_body(name="driver")
    body.add_freejoint(name="driver")
    half_bit = (BIT_LENGTH - BIT_RADIUS) / 2
    for name, kind, size, height, share, rgba in (
        (
            "driver_handle",
            mujoco.mjtGeom.mjGEOM_CYLINDER,
            (handle_radius, HANDLE_LENGTH / 2, 0),
            HANDLE_LENGTH / 2,
            _HANDLE_SHARE,
            (0.9, 0.7, 0.15, 1),
        ),
        (
            "driver_bit",
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            (BIT_RADIUS, half_bit, 0),
            -half_bit,
            1 - _HANDLE_SHARE,
            (0.75, 0.75, 0.78, 1),
        ),
    ):
        body.add_geom(
            name=name,
            type=kind,
            size=size,
            pos=(0, 0, height),
            mass=share * mass,
            rgba=rgba,
            **ContactSurface(condim=4)._asdict(),
        )
    body.add_geom(
        name="driver_mark",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.0015, 0.003, 0.4 * HANDLE_LENGTH),
        pos=(handle_radius - 0.001, 0, HANDLE_LENGTH / 2),
        contype=0,
        conaffinity=0,
        mass=0,
        rgba=(0.1, 0.1, 0.1, 1),
    )
