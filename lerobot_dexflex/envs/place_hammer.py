"""PlaceHammer: pick a hammer up from its cradle, turn it upright, hang it in a holder and let go."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_dexflex.envs.hammer import (
    ARM_START,
    CRADLE_HEIGHT,
    HEAD_CENTRE,
    HEAD_HALF_SIZE,
    add_cradle,
    add_hammer,
    lay_hammer,
)
from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.scene import (
    add_block,
    add_camera,
    add_palm_camera,
    place_robot,
    robot_at_table,
)
from lerobot_dexflex.envs.stages import furthest_progress, has_settled
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched, touched_by_hand

_PRONG_OFFSET, _PRONG_HALF_WIDTH = 0.036, 0.010


@dataclass(frozen=True)
class HammerEpisode:
    """Everything random about an episode; lengths [m], angles [rad]."""

    handle_radius: float
    mass: float
    """Mass of the hammer [kg]."""
    tip_friction: float
    cradle: tuple[float, float, float]
    """Position x, y and yaw of the cradle: the handle points away from the robot at yaw 0."""
    hammer_yaw: float
    """How the hammer lies askew in its cradle."""
    holder: tuple[float, float, float]
    """Centre of the prongs' top."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class PlaceHammerEnv(HandEnv):
    """Hang the hammer in the holder; see `HandEnv` for observations and actions.

    Success: the head lies on both prongs, tilted by less than 6 degrees and at rest, and the hand has let go
    and moved away (no hand contact, fingertips more than 8 cm off the handle), for half a second.
    Dropping the hammer on table or floor ends the episode.
    """

    task = "PlaceHammer-v0"
    manipulated = "hammer"

    def _sample_episode(self, rng: np.random.Generator) -> HammerEpisode:
        return HammerEpisode(
            handle_radius=rng.uniform(0.010, 0.015),
            mass=rng.uniform(0.06, 0.16),
            tip_friction=rng.uniform(0.8, 1.2),
            cradle=(rng.uniform(0.43, 0.47), rng.uniform(-0.025, 0.025), rng.uniform(-0.4, 0.4)),
            hammer_yaw=rng.normal(scale=0.02),
            holder=(rng.uniform(0.705, 0.725), rng.uniform(-0.02, 0.02), rng.uniform(0.31, 0.33)),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: HammerEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(1.08, -0.50, 0.62), target=(0.56, 0.0, 0.19), fovy=40)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70
        )
        add_cradle(spec, episode.cradle, episode.handle_radius, HEAD_HALF_SIZE[0])
        _add_holder(spec, episode.holder)
        add_hammer(spec, episode.handle_radius, episode.mass)
        return spec

    def _initialise(self, episode: HammerEpisode) -> None:
        place_robot(self.hand, self.data, np.add(ARM_START, episode.arm_noise))
        yaw = episode.cradle[2] + episode.hammer_yaw
        handle = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        rotation = np.stack([np.array([0.0, 0.0, 1.0]), np.cross(handle, [0.0, 0.0, 1.0]), handle], 1)
        lay_hammer(self.data, episode.cradle[:2], rotation)

    @property
    def hammer_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the handle's centre in the world; privileged."""
        return self._pose_of("hammer")

    @property
    def goal_position(self) -> np.ndarray:
        """Where the handle's centre hangs when the hammer is in its holder, world frame [m]."""
        return np.add(self.episode.holder, (0.0, 0.0, HEAD_HALF_SIZE[2] - HEAD_CENTRE))

    def _update(self) -> dict[str, Any]:
        touching = contact_names(self.model, self.data, "hammer")
        position, rotation = self.hammer_pose
        by_hand = touched_by_hand(self.hand, touching)
        holding = pinched(self.hand, touching)
        upright = rotation[2, 2] > np.cos(np.radians(6))
        on_prongs = {"prong0", "prong1"} <= touching
        at_rest = np.linalg.norm(self.data.joint("hammer").qvel[:3]) < 0.02
        tips = self.data.site_xpos[self._tips]
        away = np.linalg.norm(tips - position, axis=1).min() > 0.08
        hung = on_prongs and upright and at_rest and not by_hand
        success = has_settled(self.memory, hung and away)
        lifted = position[2] > CRADLE_HEIGHT + 0.05
        near = np.linalg.norm(position - self.goal_position) < 0.05
        stages = (
            holding,
            holding and lifted,
            lifted and rotation[2, 2] > 0.9,
            near and upright,
            hung,
            success,
        )
        return {
            "is_success": success,
            "progress": furthest_progress(self.memory, stages),
            "dropped": bool(touching & {"table", "floor"}),
            "holding": holding,
            "contacts": contact_flags(self.hand, touching),
        }


def _add_holder(spec: mujoco.MjSpec, position: tuple[float, float, float]) -> None:
    """Add two prongs that carry the head, a back plate and a post."""
    holder = spec.worldbody.add_body(name="holder", pos=position)
    blue = (0.15, 0.35, 0.75, 1)
    for k, side in enumerate((-1, 1)):
        size = (0.03, _PRONG_HALF_WIDTH, 0.004)
        add_block(holder, f"prong{k}", size, (0, side * _PRONG_OFFSET, -0.004), (0.15, 0.75, 0.35, 1))
    add_block(holder, "holder_back", (0.006, 0.05, 0.03), (0.036, 0, -0.006), blue)
    half_height = position[2] / 2 - 0.01
    add_block(holder, "holder_post", (0.01, 0.01, half_height), (0.05, 0, -position[2] / 2), blue)
