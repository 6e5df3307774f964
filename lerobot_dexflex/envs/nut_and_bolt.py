"""The things of ScrewNut: a round knurled nut with a hole, and a bolt whose domed end it rests on."""

import mujoco
import numpy as np

from lerobot_dexflex.envs.scene import ContactSurface, Pose2, add_block, add_wall
from lerobot_dexflex.envs.thread import add_thread
from lerobot_dexflex.hand import model as robot

PITCH, TURNS = 0.002, 0.5
"""The thread: lead per turn [m], and turns until the nut is tight."""
DOME_RADIUS, HOLE_RADIUS = 0.009, 0.0075
"""The bolt's end is round and wider than the hole: on it the nut rests at any tilt."""
DOME_HEIGHT = 0.055
"""Height of the middle of the dome above the table, the nut still loose [m]."""
RIM = float(np.sqrt(DOME_RADIUS**2 - HOLE_RADIUS**2))
"""How far above the middle of the dome the lower rim of the hole is [m]."""
_BLOCK_HALF_SIZE = (0.04, 0.04, 0.010)
_SHAFT_RADIUS = 0.0085
_BORE = 8
"""Bit of the collisions between hole and dome: the nut itself is a full cylinder to everything else."""


def add_bolt(spec: mujoco.MjSpec, pose: Pose2, friction: float) -> None:
    """Add a block, and on it the bolt with its thread [N m]; its dome turns and sinks with the nut."""
    x, y, yaw = pose
    quaternion = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    block = spec.worldbody.add_body(name="block", pos=(x, y, 0), quat=quaternion)
    height = _BLOCK_HALF_SIZE[2]
    add_block(block, "block", _BLOCK_HALF_SIZE, (0, 0, height), (0.55, 0.38, 0.22, 1))
    half = DOME_HEIGHT / 2 - height
    block.add_geom(
        name="bolt",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(_SHAFT_RADIUS, half, 0),
        pos=(0, 0, 2 * height + half),
        rgba=(0.6, 0.6, 0.65, 1),
        **ContactSurface()._asdict(),
    )
    core = add_thread(spec, (x, y, DOME_HEIGHT), PITCH, TURNS, friction, "nut", 0.0)
    touched = robot.LINK_COLLISION[0] | robot.TIP_COLLISION[0]
    surface = ContactSurface(_BORE, _BORE | touched, friction=(0.8, 0.005, 0.0001))
    core.add_geom(
        name="dome",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(DOME_RADIUS, 0, 0),
        rgba=(0.75, 0.75, 0.78, 1),
        priority=1,
        solref=robot.TIP_SOLREF,  # On softer contacts friction at rest creeps: the nut would tilt over.
        **surface._asdict(),
    )
    spec.add_exclude(bodyname1="core", bodyname2="block")


def add_nut(spec: mujoco.MjSpec, radius: float, height: float, mass: float) -> None:
    """Add the nut: its frame is in the middle of the dome it rests on, z along its hole.

    Args:
        spec: The scene.
        radius: Half of its width [m].
        height: How long it is [m].
        mass: [kg].
    """
    body = spec.worldbody.add_body(name="nut")
    body.add_freejoint(name="nut")
    middle = RIM + height / 2
    body.add_geom(
        name="nut",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(radius, height / 2, 0),
        pos=(0, 0, middle),
        mass=mass,
        rgba=(0.85, 0.65, 0.25, 1),
        **ContactSurface(condim=4)._asdict(),
    )
    dark, size = (0.15, 0.15, 0.15, 1), (0.002, HOLE_RADIUS / 2, height / 2)
    for k in range(8):
        wall = add_wall(body, f"bore{k}", k * np.pi / 4, HOLE_RADIUS, size, dark, RIM)
        wall.contype = wall.conaffinity = _BORE
        wall.mass = 0
    sight = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "contype": 0, "conaffinity": 0, "mass": 0}
    size = (HOLE_RADIUS, 0.0003, 0)
    body.add_geom(name="nut_bore", size=size, pos=(0, 0, RIM + height + 0.0003), rgba=dark, **sight)
    for k in range(12):
        angle = k * np.pi / 6
        body.add_geom(
            name=f"knurl{k}",
            size=(0.0012, 0.48 * height, 0),
            pos=((radius - 0.0008) * np.cos(angle), (radius - 0.0008) * np.sin(angle), middle),
            rgba=(0.9, 0.2, 0.1, 1) if k == 0 else (0.6, 0.45, 0.15, 1),
            **sight,
        )
