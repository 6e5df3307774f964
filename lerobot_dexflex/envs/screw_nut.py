"""ScrewNut: right a nut that rests askew on the end of a bolt, and turn it tight with the fingers."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.nut_and_bolt import DOME_HEIGHT, TURNS, add_bolt, add_nut
from lerobot_dexflex.envs.scene import Pose2, add_camera, add_palm_camera, place_robot, robot_at_table
from lerobot_dexflex.envs.stages import furthest_progress, has_settled
from lerobot_dexflex.envs.thread import catch, has_caught, turns_in
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.arm import about_z, rotation_matrix
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched

ARM_START = (0.0, -0.1, 0.0, 0.95, 0.0, 1.05, np.pi / 2)
"""Arm at the start [rad]: palm down."""
TILT = (0.12, 0.25)
"""Range of the nut's tilt [rad]."""
CATCH_DISTANCE, CATCH_TILT = 0.0025, np.radians(5)
"""How far off the thread catches the nut [m], [rad]."""
TIGHT = 0.04
"""Turns short of the stop that count as tight: the stop is a spring."""
STROKE, STROKES = 0.04, 2
"""Turns within one hold of the nut that count as a stroke, and how many strokes it takes at least."""


@dataclass(frozen=True)
class NutEpisode:
    """Everything random about an episode; lengths [m], angles [rad]."""

    nut_radius: float
    nut_height: float
    mass: float
    """Mass of the nut [kg]."""
    tip_friction: float
    thread_friction: float
    """Torque that turns the nut on the thread [N m]."""
    bolt: Pose2
    tilt: tuple[float, float]
    """How far the nut is tilted, and toward where."""
    nut_yaw: float
    """How it is turned about its axis."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class ScrewNutEnv(HandEnv):
    """Turn the nut tight; see `HandEnv` for observations and actions.

    The nut rests askew on the domed end of the bolt, held by friction. The thread catches it once it sits
    there upright (within 2.5 mm and 5 degrees). MuJoCo has no helical contacts: a weld to a hinge and a slide
    that an equality couples stand for the thread. From then on the nut sinks 2 mm per clockwise turn, against
    dry friction of 0.01 to 0.03 N m, and is tight after half a turn.
    Success: it is tight, was turned by two strokes at least, between which it was let go, and is held by the
    thumb and a finger, for half a second.
    Dropping it on block, table or floor ends the episode.
    """

    task = "ScrewNut-v0"
    manipulated = "nut"

    def _sample_episode(self, rng: np.random.Generator) -> NutEpisode:
        return NutEpisode(
            nut_radius=rng.uniform(0.014, 0.018),
            nut_height=rng.uniform(0.020, 0.028),
            mass=rng.uniform(0.02, 0.05),
            tip_friction=rng.uniform(0.8, 1.2),
            thread_friction=rng.uniform(0.01, 0.03),
            bolt=(rng.uniform(0.46, 0.52), rng.uniform(-0.06, 0.08), rng.uniform(-0.4, 0.4)),
            tilt=(rng.uniform(*TILT), rng.uniform(-np.pi, np.pi)),
            nut_yaw=rng.uniform(-np.pi, np.pi),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: NutEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(0.90, 0.02, 0.24), target=(0.48, 0.01, 0.10), fovy=36)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70
        )
        add_bolt(spec, episode.bolt, episode.thread_friction)
        add_nut(spec, episode.nut_radius, episode.nut_height, episode.mass)
        return spec

    def _initialise(self, episode: NutEpisode) -> None:
        place_robot(self.hand, self.data, np.add(ARM_START, episode.arm_noise))
        tilt, toward = episode.tilt
        turn = rotation_matrix(np.array([-np.sin(toward), np.cos(toward), 0.0]) * tilt)
        pose = self.data.joint("nut").qpos
        pose[:3] = self.goal_position
        mujoco.mju_mat2Quat(pose[3:7], (turn @ about_z(episode.nut_yaw)).ravel())

    @property
    def nut_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) of the frame, below the hole, orientation (3, 3) with z along it; privileged."""
        return self._pose_of("nut")

    @property
    def goal_position(self) -> np.ndarray:
        """Where the nut's frame is when the thread catches it, world frame [m]."""
        return np.array([*self.episode.bolt[:2], DOME_HEIGHT])

    @property
    def caught(self) -> bool:
        """Whether the thread holds the nut."""
        return has_caught(self.model, self.data)

    @property
    def turns(self) -> float:
        """Turns by which the nut has been screwed on."""
        return turns_in(self.data)

    @property
    def tight(self) -> bool:
        """Whether the nut is tight."""
        return self.caught and self.turns > TURNS - TIGHT

    def _update(self) -> dict[str, Any]:
        if not self.caught and self._on_bolt():
            catch(self.model, self.data, self.nut_pose[1])
        touching = contact_names(self.model, self.data, "nut")
        holding = pinched(self.hand, touching)
        strokes = self._strokes(holding)
        success = has_settled(self.memory, self.tight and holding and strokes >= STROKES)
        reached = furthest_progress(self.memory, (holding, self.caught))
        turned = min(1.0, self.turns / (TURNS - TIGHT)) if self.caught else 0.0
        self.memory["turned"] = max(self.memory.get("turned", 0.0), turned)
        return {
            "is_success": success,
            "progress": 1.0 if success else reached / 3 + self.memory["turned"] / 2,
            "dropped": bool(touching & {"table", "floor", "block"}),
            "holding": holding,
            "contacts": contact_flags(self.hand, touching | {"bolt"} if self.caught else touching),
        }

    def _on_bolt(self) -> bool:
        position, rotation = self.nut_pose
        off = np.linalg.norm(position - self.goal_position)
        return bool(off < CATCH_DISTANCE and rotation[2, 2] > np.cos(CATCH_TILT))

    def _strokes(self, holding: bool) -> int:
        """Count the strokes: holds of the nut in which it has been turned on."""
        memory, turns = self.memory, self.turns
        if not (holding and self.caught):
            memory["since"] = turns
        elif memory["since"] < turns - STROKE:
            memory["strokes"] = memory.get("strokes", 0) + 1
            memory["since"] = np.inf
        return memory.get("strokes", 0)
