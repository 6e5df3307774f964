"""AssembleTable: take a table leg out of its rack, screw it into the table top until it lights, let go."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.leg_and_socket import (
    LAMP_HEIGHT,
    LEG_LENGTH,
    RACK_FLOOR,
    STUD_LENGTH,
    THREAD_ENTRY,
    TURNS,
    add_leg,
    add_leg_thread,
    add_rack,
    add_table_top,
)
from lerobot_dexflex.envs.scene import add_camera, add_palm_camera, place_robot, robot_at_table
from lerobot_dexflex.envs.stages import furthest_progress, has_settled
from lerobot_dexflex.envs.thread import catch, has_caught, turns_in
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.arm import about_z, rotation_matrix
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched, touched_by_hand

ARM_START = (0.0, -0.1, 0.0, 0.95, 0.0, 1.05, np.pi / 2)
"""Arm at the start [rad]: palm down."""

LEAN = (-0.35, 0.35)
"""Range of the rack's lean [rad]."""
CATCH_RADIUS, CATCH_HEIGHT, CATCH_TILT = 0.0025, 0.003, np.radians(6)
"""How far off the thread catches the stud: beside [m], above [m], and askew [rad]."""


@dataclass(frozen=True)
class LegEpisode:
    """Everything random about an episode; lengths [m], angles [rad]."""

    leg_radius: float
    mass: float
    """Mass of the leg [kg]."""
    tip_friction: float
    rack: tuple[float, float, float]
    """Position x, y and yaw of the rack."""
    lean: float
    """How far rack and leg lean, about the y axis of the rack."""
    leg_yaw: float
    """How the leg is turned in its rack."""
    socket: tuple[float, float, float]
    """Position x, y of the socket and yaw of the table top around it."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class AssembleTableEnv(HandEnv):
    """Screw the leg into the table top; see `HandEnv` for observations and actions.

    The thread catches a stud that stands in the socket (within 2.5 mm, 3 mm and 6 degrees); from then on the
    leg sinks 4 mm per clockwise turn and cannot be pulled out. After 0.35 turns it is tight and the table
    top lights; what was lit stays lit, also if the fingers turn it back on leaving.
    Success: lit, tilted by less than 5 degrees, and the hand has let go and moved away (no hand contact,
    fingertips more than 8 cm off the leg's centre), for half a second.
    Dropping the leg, or tilting it by more than 60 degrees, ends the episode.
    """

    task = "AssembleTable-v0"
    manipulated = "leg"

    def _sample_episode(self, rng: np.random.Generator) -> LegEpisode:
        return LegEpisode(
            leg_radius=rng.uniform(0.0115, 0.015),
            mass=rng.uniform(0.03, 0.07),
            tip_friction=rng.uniform(0.8, 1.2),
            rack=(rng.uniform(0.405, 0.435), rng.uniform(-0.14, -0.10), rng.uniform(-0.15, 0.15)),
            lean=rng.uniform(*LEAN),
            leg_yaw=rng.uniform(-np.pi, np.pi),
            socket=(rng.uniform(0.51, 0.53), rng.uniform(0.085, 0.115), rng.uniform(-0.4, 0.4)),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: LegEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(0.98, -0.42, 0.38), target=(0.47, 0.0, 0.11), fovy=33)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70
        )
        add_rack(spec, episode.rack, episode.lean, episode.leg_radius)
        add_table_top(spec, episode.socket)
        add_leg_thread(spec, episode.socket[:2])
        add_leg(spec, episode.leg_radius, episode.mass)
        return spec

    def _initialise(self, episode: LegEpisode) -> None:
        place_robot(self.hand, self.data, np.add(ARM_START, episode.arm_noise))
        x, y, yaw = episode.rack
        rack = about_z(yaw) @ rotation_matrix(np.array([0.0, episode.lean, 0.0]))
        pose = self.data.joint("leg").qpos
        pose[:3] = np.array([x, y, 0.0]) + (RACK_FLOOR + STUD_LENGTH + 0.0005) * rack[:, 2]
        mujoco.mju_mat2Quat(pose[3:7], (rack @ about_z(episode.leg_yaw)).ravel())

    @property
    def leg_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) of the shaft's lower end and orientation (3, 3), z along the leg; privileged."""
        return self._pose_of("leg")

    @property
    def goal_position(self) -> np.ndarray:
        """Where the shaft's lower end is when the thread catches the stud, world frame [m]."""
        return np.array([*self.episode.socket[:2], THREAD_ENTRY + STUD_LENGTH])

    @property
    def caught(self) -> bool:
        """Whether the thread holds the stud."""
        return has_caught(self.model, self.data)

    @property
    def turns(self) -> float:
        """Turns by which the leg has been screwed in."""
        return turns_in(self.data)

    @property
    def lit(self) -> bool:
        """Whether the leg has been tight, to 0.05 turns: what is tight stays lit."""
        return self.memory.get("lit", False)

    def _update(self) -> dict[str, Any]:
        if not self.caught and self._stud_in_thread():
            catch(self.model, self.data, self.leg_pose[1])
        self.memory["lit"] = self.lit or (self.caught and self.turns > TURNS - 0.05)
        lamp = self.model.body("lamp").mocapid[0]
        self.data.mocap_pos[lamp, 2] = LAMP_HEIGHT if self.lit else -LAMP_HEIGHT
        touched = contact_names(self.model, self.data, "leg")
        position, rotation = self.leg_pose
        centre = position + rotation[:, 2] * LEG_LENGTH / 2
        by_hand = touched_by_hand(self.hand, touched)
        holding = pinched(self.hand, touched)
        upright = rotation[2, 2] > np.cos(np.radians(5))
        away = np.linalg.norm(self.data.site_xpos[self._tips] - centre, axis=1).min() > 0.08
        released = self.lit and upright and away and not by_hand
        success = has_settled(self.memory, released)
        lifted = position[2] > RACK_FLOOR + STUD_LENGTH + 0.04
        over = np.linalg.norm((position - self.goal_position)[:2]) < 0.03
        stages = (holding, holding and lifted, holding and over and upright, self.caught, self.lit, success)
        return {
            "is_success": success,
            "progress": furthest_progress(self.memory, stages),
            "dropped": bool(touched & {"table", "floor"} or rotation[2, 2] < 0.5),
            "holding": holding,
            "contacts": contact_flags(self.hand, touched),
        }

    def _stud_in_thread(self) -> bool:
        position, rotation = self.leg_pose
        tip = position - STUD_LENGTH * rotation[:, 2]
        beside = np.linalg.norm(tip[:2] - self.episode.socket[:2])
        above = abs(tip[2] - THREAD_ENTRY)
        return bool(beside < CATCH_RADIUS and above < CATCH_HEIGHT and rotation[2, 2] > np.cos(CATCH_TILT))
