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
    add_rack,
    add_table_top,
    add_thread,
)
from lerobot_dexflex.envs.scene import add_camera, add_wrist_camera, place_robot, robot_at_table
from lerobot_dexflex.envs.stages import furthest_progress, has_settled
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.contacts import contact_names, pinched, touched_by_hand

ARM_START = (0.0, -0.1, 0.0, 0.95, 0.0, 1.05, -3 * np.pi / 2)
"""Arm at the start [rad]: palm down, joint 7 wound back so that it can screw a full turn without regrasp."""
HAND_OPEN = (
    *(0.988, -0.570, 0.656, -0.019),
    *(1.578, -0.597, -0.496, 0.349),
    *(0.600, -0.300, 0.300, 0.300),
    *(1.371, -0.075, 0.928, -1.276),
)
"""Open hand around the leg [rad]: pads 16 mm away from it, ring finger parked."""

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
    leg_rotation: tuple[float, float, float]
    """Rotation vector of the leg in its rack: yaw and a slight tilt."""
    socket: tuple[float, float, float]
    """Position x, y of the socket and yaw of the table top around it."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class AssembleTableEnv(HandEnv):
    """Screw the leg into the table top; see `HandEnv` for observations and actions.

    The thread catches a stud that stands in the socket (within 2.5 mm, 3 mm and 6 degrees); from then on the
    leg sinks 4 mm per clockwise turn and cannot be pulled out. After one turn it is tight and the table top
    lights.
    Success: lit, tilted by less than 5 degrees, and the hand has let go and moved away (no hand contact,
    fingertips more than 8 cm off the leg's centre), for half a second.
    Dropping the leg, or tilting it by more than 60 degrees, ends the episode.
    """

    task = "AssembleTable-v0"
    manipulated = "leg"

    def _sample_episode(self, rng: np.random.Generator) -> LegEpisode:
        tilt, direction = rng.uniform(0, 0.03), rng.uniform(-np.pi, np.pi)
        return LegEpisode(
            leg_radius=rng.uniform(0.0115, 0.0125),
            mass=rng.uniform(0.04, 0.10),
            tip_friction=rng.uniform(0.7, 1.2),
            rack=(rng.uniform(0.39, 0.45), rng.uniform(-0.16, -0.08), rng.uniform(-0.4, 0.4)),
            leg_rotation=(tilt * np.cos(direction), tilt * np.sin(direction), rng.uniform(-np.pi, np.pi)),
            socket=(rng.uniform(0.50, 0.54), rng.uniform(0.07, 0.13), rng.uniform(-0.4, 0.4)),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: LegEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(episode.tip_friction)
        add_camera(spec, "front", position=(0.98, -0.42, 0.38), target=(0.47, 0.0, 0.11), fovy=33)
        add_wrist_camera(palm, position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70)
        add_rack(spec, episode.rack, episode.leg_radius)
        add_table_top(spec, episode.socket)
        add_thread(spec, episode.socket[:2])
        add_leg(spec, episode.leg_radius, episode.mass)
        return spec

    def _initialise(self, episode: LegEpisode) -> None:
        place_robot(self.data, np.add(ARM_START, episode.arm_noise), HAND_OPEN)
        yaw = rotation_matrix(np.array([0.0, 0.0, episode.leg_rotation[2]]))
        tilt = rotation_matrix(np.array([*episode.leg_rotation[:2], 0.0]))
        pose = self.data.joint("leg").qpos
        pose[:3] = (*episode.rack[:2], RACK_FLOOR + STUD_LENGTH + 0.0005)
        mujoco.mju_mat2Quat(pose[3:7], (tilt @ yaw).ravel())

    @property
    def leg_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) of the shaft's lower end and orientation (3, 3), z along the leg; privileged."""
        body = self.data.body("leg")
        return body.xpos.copy(), body.xmat.reshape(3, 3).copy()

    @property
    def goal_position(self) -> np.ndarray:
        """Where the shaft's lower end is when the thread catches the stud, world frame [m]."""
        return np.array([*self.episode.socket[:2], THREAD_ENTRY + STUD_LENGTH])

    @property
    def caught(self) -> bool:
        """Whether the thread holds the stud."""
        return bool(self.data.eq_active[self.model.equality("thread_catch").id])

    @property
    def turns(self) -> float:
        """Turns by which the leg has been screwed in."""
        return max(0.0, -float(self.data.joint("thread_turn").qpos[0]) / (2 * np.pi))

    @property
    def lit(self) -> bool:
        """Whether the leg is tight, to 0.05 turns."""
        return self.caught and self.turns > TURNS - 0.05

    def _update(self) -> dict[str, Any]:
        if not self.caught and self._stud_in_thread():
            self._catch_stud()
        self.data.mocap_pos[self._mocap("lamp"), 2] = LAMP_HEIGHT if self.lit else -LAMP_HEIGHT
        touched = contact_names(self.model, self.data, "leg")
        position, rotation = self.leg_pose
        centre = position + rotation[:, 2] * LEG_LENGTH / 2
        by_hand = touched_by_hand(touched)
        holding = pinched(touched, ("if", "mf"))
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
        }

    def _mocap(self, body: str) -> int:
        return self.model.body(body).mocapid[0]

    def _stud_in_thread(self) -> bool:
        position, rotation = self.leg_pose
        tip = position - STUD_LENGTH * rotation[:, 2]
        beside = np.linalg.norm(tip[:2] - self.episode.socket[:2])
        above = abs(tip[2] - THREAD_ENTRY)
        return bool(beside < CATCH_RADIUS and above < CATCH_HEIGHT and rotation[2, 2] > np.cos(CATCH_TILT))

    def _catch_stud(self) -> None:
        """Turn the thread to the leg's yaw and weld the leg to it: all of it state that snapshots carry."""
        data = self.data
        _, rotation = self.leg_pose
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
        data.mocap_quat[self._mocap("thread")] = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
        data.joint("thread_turn").qpos[:] = data.joint("thread_turn").qvel[:] = 0
        data.joint("thread_slide").qpos[:] = data.joint("thread_slide").qvel[:] = 0
        data.eq_active[self.model.equality("thread_catch").id] = 1
        mujoco.mj_forward(self.model, data)
