"""HammerNail: take a hammer out of its cradle and drive a nail in with it, blow by blow."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.envs.hammer import (
    ARM_START,
    CRADLE_BROWN,
    HEAD_CENTRE,
    HEAD_HALF_SIZE,
    add_cradle,
    add_hammer,
    lay_hammer,
)
from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.scene import (
    ContactSurface,
    add_block,
    add_camera,
    add_palm_camera,
    place_robot,
    robot_at_table,
)
from lerobot_dexflex.envs.stages import has_settled
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched

NAIL_DEPTH, TOLERANCE = 0.030, 0.002
"""How far the nail stands out at first, and how far it may when it is in [m]."""
NAIL_HEAD = (0.012, 0.0025)
"""Radius and half thickness of the nail's head [m]."""
_NAIL_RADIUS, _NAIL_MASS = 0.004, 0.02
_STIFF = (2 * robot.TIMESTEP, 1.0)
"""Of steel on steel, and of wood around a nail: MuJoCo's defaults let both creep."""


@dataclass(frozen=True)
class NailEpisode:
    """Everything random about an episode; lengths [m], angles [rad]."""

    handle_radius: float
    mass: float
    """Mass of the hammer [kg]."""
    tip_friction: float
    cradle: tuple[float, float, float]
    """Position x, y and yaw of the cradle: the handle points away from the robot at yaw 0."""
    hammer_yaw: float
    """How the hammer lies askew in its cradle."""
    nail: tuple[float, float, float]
    """Where the nail goes into the board: centre of the board's top."""
    nail_friction: float
    """Force that the nail resists with [N]."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class HammerNailEnv(HandEnv):
    """Drive the nail in with the hammer; see `HandEnv` for observations and actions.

    The nail slides in the board against dry friction, more than fingertips can press with at the end of a
    handle: it takes the momentum of blows, and every blow turns the hammer in the fingers and lets it slip.
    Progress is the greatest depth so far.
    Success: the nail is in to within 2 mm, and the hammer is held by thumb and a finger, off the palm, for
    half a second. Dropping the hammer on table or floor ends the episode.
    """

    task = "HammerNail-v0"
    manipulated = "hammer"

    def _sample_episode(self, rng: np.random.Generator) -> NailEpisode:
        return NailEpisode(
            handle_radius=rng.uniform(0.010, 0.015),
            mass=rng.uniform(0.09, 0.16),
            tip_friction=rng.uniform(0.8, 1.2),
            cradle=(rng.uniform(0.43, 0.47), rng.uniform(0.075, 0.125), rng.uniform(-0.3, 0.3)),
            hammer_yaw=rng.normal(scale=0.02),
            nail=(rng.uniform(0.53, 0.55), rng.uniform(-0.16, -0.12), rng.uniform(0.04, 0.06)),
            nail_friction=rng.uniform(5.0, 8.0),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: NailEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(1.08, -0.50, 0.50), target=(0.50, -0.02, 0.15), fovy=38)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70
        )
        cradle = add_cradle(spec, episode.cradle, episode.handle_radius, HEAD_HALF_SIZE[1])
        for side in (-1, 1):
            place = (HEAD_CENTRE, side * (HEAD_HALF_SIZE[0] + 0.005), 0.015)
            add_block(cradle, f"cradle_cheek{side}", (0.014, 0.004, 0.015), place, CRADLE_BROWN)
        _add_nail(spec, episode.nail, episode.nail_friction)
        add_hammer(spec, episode.handle_radius, episode.mass)
        return spec

    def _initialise(self, episode: NailEpisode) -> None:
        place_robot(self.hand, self.data, np.add(ARM_START, episode.arm_noise))
        yaw = episode.cradle[2] + episode.hammer_yaw
        up, handle = np.array([0.0, 0.0, 1.0]), np.array([np.cos(yaw), np.sin(yaw), 0.0])
        lay_hammer(self.data, episode.cradle[:2], np.stack([np.cross(up, handle), up, handle], 1))

    @property
    def hammer_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the handle's centre in the world; privileged."""
        return self._pose_of("hammer")

    @property
    def nail_depth(self) -> float:
        """How far the nail has been driven in [m]; privileged."""
        return float(self.data.joint("nail").qpos[0])

    @property
    def nail_top(self) -> np.ndarray:
        """Centre of the nail head's upper face, world frame [m]. Shape (3,); privileged."""
        return np.add(self.episode.nail, (0.0, 0.0, NAIL_DEPTH - self.nail_depth + 2 * NAIL_HEAD[1]))

    def _update(self) -> dict[str, Any]:
        touching = contact_names(self.model, self.data, "hammer")
        holding = pinched(self.hand, touching)
        by_palm = any(name.startswith("palm") for name in touching)
        share = self.nail_depth / (NAIL_DEPTH - TOLERANCE)
        self.memory["share"] = max(self.memory.get("share", 0.0), min(share, 1.0))
        return {
            "is_success": has_settled(self.memory, share >= 1.0 and holding and not by_palm),
            "progress": self.memory["share"],
            "dropped": bool(touching & {"table", "floor"}),
            "holding": holding,
            "contacts": contact_flags(self.hand, touching),
        }


def _add_nail(spec: mujoco.MjSpec, position: tuple[float, float, float], friction: float) -> None:
    """Add a board with a nail in its top, that slides down by `NAIL_DEPTH` against `friction` [N].

    Gravity does not act on it: MuJoCo's dry friction creeps under constant load (by micrometres per second).
    """
    x, y, height = position
    board = spec.worldbody.add_body(name="board", pos=(x, y, 0))
    add_block(board, "board", (0.04, 0.04, height / 2), (0, 0, height / 2), (0.55, 0.38, 0.22, 1))
    nail = board.add_body(name="nail", pos=(0, 0, height), gravcomp=1)
    slide = nail.add_joint(name="nail", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, -1))
    slide.range, slide.limited, slide.solref_limit = (0, NAIL_DEPTH), True, _STIFF
    slide.frictionloss, slide.solref_friction, slide.solimp_friction[:2] = friction, _STIFF, (0.999, 0.999)
    steel = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "rgba": (0.75, 0.75, 0.78, 1)}
    nail.add_geom(
        name="nail_head",
        size=(*NAIL_HEAD, 0),
        pos=(0, 0, NAIL_DEPTH + NAIL_HEAD[1]),
        mass=_NAIL_MASS,
        solref=_STIFF,
        priority=1,
        **steel,
        **ContactSurface()._asdict(),
    )
    half = NAIL_DEPTH / 2
    nail.add_geom(size=(_NAIL_RADIUS, half, 0), pos=(0, 0, half), mass=0, contype=0, conaffinity=0, **steel)
