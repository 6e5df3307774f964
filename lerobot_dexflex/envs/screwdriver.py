"""Screwdriver: take a screwdriver out of its stand, set its bit into a screw, turn the screw tight."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.envs.driver_and_screw import (
    BIT_LENGTH,
    STAND_HEIGHT,
    TURNS,
    add_driver,
    add_screw,
    add_stand,
)
from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.scene import Pose2, add_camera, add_palm_camera, place_robot, robot_at_table
from lerobot_dexflex.envs.stages import furthest_progress, has_settled
from lerobot_dexflex.envs.thread import turns_in
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.arm import about_z, rotation_matrix
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched

ARM_START = (0.0, 0.05, 0.05, 0.3, 3.2, 1.35, -1.6)
"""Arm at the start [rad]: the flange points forward."""
LEAN = (-0.25, 0.25)
"""Range of the stand's lean to the side [rad]."""
SEATED_DISTANCE, SEATED_TILT = 0.002, np.radians(10)
"""How far the tip of a seated bit is from the middle of the recess's floor [m], and its tilt [rad]."""
TIGHT = 0.04
"""Turns short of the stop that count as tight: the stop is a spring."""


@dataclass(frozen=True)
class DriverEpisode:
    """Everything random about an episode; lengths [m], angles [rad]."""

    handle_radius: float
    mass: float
    """Mass of the driver [kg]."""
    tip_friction: float
    stand: Pose2
    lean: float
    """How far stand and driver lean, about the x axis of the stand."""
    driver_yaw: float
    """How the driver is turned in its stand."""
    screw: Pose2
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class ScrewdriverEnv(HandEnv):
    """Turn the screw tight; see `HandEnv` for observations and actions.

    The screw needs 0.02 N m, sinks 2 mm per clockwise turn and stops after half a turn. The bit turns it by
    torsional friction on the floor of the recess alone, up to 0.02 N m per newton that presses it down; it
    is seated within 2 mm and 10 degrees.
    Success: the screw is tight and the driver held by the thumb and a finger, for half a second.
    Dropping the driver, or tilting it by more than 60 degrees, ends the episode.
    """

    task = "Screwdriver-v0"
    manipulated = "driver"

    def _sample_episode(self, rng: np.random.Generator) -> DriverEpisode:
        return DriverEpisode(
            handle_radius=rng.uniform(0.011, 0.014),
            mass=rng.uniform(0.04, 0.08),
            tip_friction=rng.uniform(0.8, 1.2),
            stand=(rng.uniform(0.53, 0.56), rng.uniform(-0.12, -0.08), rng.uniform(-0.15, 0.15)),
            lean=rng.uniform(*LEAN),
            driver_yaw=rng.uniform(-np.pi, np.pi),
            screw=(rng.uniform(0.53, 0.55), rng.uniform(0.07, 0.10), rng.uniform(-np.pi, np.pi)),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: DriverEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(1.08, -0.30, 0.42), target=(0.50, 0.0, 0.12), fovy=33)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70
        )
        add_stand(spec, episode.stand, episode.lean)
        add_screw(spec, episode.screw)
        add_driver(spec, episode.handle_radius, episode.mass)
        return spec

    def _initialise(self, episode: DriverEpisode) -> None:
        place_robot(self.hand, self.data, np.add(ARM_START, episode.arm_noise))
        x, y, yaw = episode.stand
        stand = about_z(yaw) @ rotation_matrix(np.array([episode.lean, 0.0, 0.0]))
        pose = self.data.joint("driver").qpos
        pose[:3] = np.array([x, y, 0.0]) + (STAND_HEIGHT + 0.0005) * stand[:, 2]
        mujoco.mju_mat2Quat(pose[3:7], (stand @ about_z(episode.driver_yaw)).ravel())

    @property
    def driver_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) of the handle's lower end, orientation (3, 3) with z along it; privileged."""
        return self._pose_of("driver")

    @property
    def goal_position(self) -> np.ndarray:
        """Where the handle's lower end is when the bit is seated upright, world frame [m]."""
        return self.data.body("screw").xpos + np.array([0.0, 0.0, BIT_LENGTH])

    @property
    def turns(self) -> float:
        """Turns by which the screw has been turned in."""
        return turns_in(self.data, "screw")

    @property
    def tight(self) -> bool:
        """Whether the screw is tight."""
        return self.turns > TURNS - TIGHT

    @property
    def seated(self) -> bool:
        """Whether the tip of the bit is on the floor of the recess and the driver upright."""
        position, rotation = self.driver_pose
        tip = position - BIT_LENGTH * rotation[:, 2]
        off = np.linalg.norm(tip - self.data.body("screw").xpos)
        return bool(off < SEATED_DISTANCE and rotation[2, 2] > np.cos(SEATED_TILT))

    def _update(self) -> dict[str, Any]:
        touching = contact_names(self.model, self.data, "driver")
        position, rotation = self.driver_pose
        holding = pinched(self.hand, touching)
        success = has_settled(self.memory, self.tight and holding)
        lifted = position[2] > STAND_HEIGHT + 0.04
        stages = (holding, holding and lifted, self.seated and "screw" in touching)
        reached = furthest_progress(self.memory, stages)
        turned = min(1.0, self.turns / (TURNS - TIGHT)) if reached == 1 else 0.0
        self.memory["turned"] = max(self.memory.get("turned", 0.0), turned)
        progress = 1.0 if success else reached / 2 + self.memory["turned"] / 3
        return {
            "is_success": success,
            "progress": progress,
            "dropped": bool(touching & {"table", "floor"} or rotation[2, 2] < 0.5),
            "holding": holding,
            "contacts": contact_flags(self.hand, touching),
        }
