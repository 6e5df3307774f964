"""PourCup: take a pitcher by its handle, pour the balls into the bowl, set the pitcher down and let go."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.scene import (
    ContactSurface,
    add_ball,
    add_block,
    add_camera,
    add_palm_camera,
    ball_states,
    place_robot,
    robot_at_table,
)
from lerobot_dexflex.envs.stages import furthest_progress, has_settled
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched, touched_by_hand

ARM_START = (0.278, 0.134, 0.160, 0.248, 3.662, 1.481, -1.647)
"""Arm at the start of an episode [rad]: the flange points forward, the hand is behind the handle."""
PITCHER_RADIUS, PITCHER_HEIGHT = 0.040, 0.160
"""Inner radius and height of the pitcher [m]; its frame: origin at the bottom, z up, x to the handle."""
HANDLE_HALF_DEPTH, HANDLE_HALF_HEIGHT = 0.008, 0.067
HANDLE_CENTRE = (0.087, 0.0, 0.083)
"""Centre of the handle's bar in the pitcher's frame [m]: room for the fingertips between it and the wall."""
BOWL_RADIUS, BOWL_HEIGHT = 0.075, 0.055
"""Radius and height of the bowl's rim [m]."""
BALL_RADIUS = 0.0075
SHARE = 0.8
"""Share of the balls that must lie in the bowl."""

_WALL = 0.003
_WALLS, _BOWL_WALLS, _BOWL_FLARE = 12, 16, 0.45
_HANDLE_SHARE = 0.3
"""Share of the pitcher's mass in the handle."""
_PER_LAYER = 6
_SETTLE_STEPS = 300
"""Physics steps in which the balls come to rest before the episode."""


@dataclass(frozen=True)
class PourEpisode:
    """Everything random about an episode; lengths [m], angles [rad]."""

    mass: float
    """Mass of the empty pitcher [kg]."""
    balls: int
    ball_mass: float
    """Mass of each ball [kg]."""
    ball_turn: float
    """Where the first layer of balls starts around the pitcher's axis."""
    handle_half_width: float
    tip_friction: float
    pitcher: tuple[float, float, float]
    """Position x, y and yaw of the pitcher: the handle points to the robot at yaw 0."""
    bowl: tuple[float, float]
    """Position x, y of the bowl."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class PourCupEnv(HandEnv):
    """Pour the balls into the bowl; see `HandEnv` for observations and actions.

    Success: at least 80 % of the balls rest in the bowl, the pitcher stands on the table, tilted by less than
    6 degrees and at rest, and the hand has let go and moved away (no hand contact, fingertips more than 5 cm
    off the handle's centre), for half a second.
    Knocking the pitcher over, or spilling so many balls that too few are left, ends the episode.
    """

    task = "PourCup-v0"
    manipulated = "pitcher"

    def _sample_episode(self, rng: np.random.Generator) -> PourEpisode:
        return PourEpisode(
            mass=rng.uniform(0.05, 0.10),
            balls=int(rng.integers(12, 17)),
            ball_mass=rng.uniform(0.001, 0.002),
            ball_turn=rng.uniform(-np.pi, np.pi),
            handle_half_width=rng.uniform(0.008, 0.013),
            tip_friction=rng.uniform(0.8, 1.2),
            pitcher=(rng.uniform(0.615, 0.645), rng.uniform(0.04, 0.08), rng.uniform(-0.2, 0.2)),
            bowl=(rng.uniform(0.34, 0.36), rng.uniform(-0.22, -0.19)),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: PourEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(1.15, -0.15, 0.50), target=(0.47, -0.08, 0.15), fovy=38)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.10, 0.02), target=(-0.05, -0.02, -0.17), fovy=75
        )
        _add_bowl(spec, episode.bowl)
        _add_pitcher(spec, episode.mass, episode.handle_half_width)
        for k in range(episode.balls):
            add_ball(spec, f"ball{k}", BALL_RADIUS, episode.ball_mass)
        return spec

    def _initialise(self, episode: PourEpisode) -> None:
        data = self.data
        place_robot(self.hand, data, np.add(ARM_START, episode.arm_noise))
        x, y, yaw = episode.pitcher
        half = (yaw + np.pi) / 2
        data.joint("pitcher").qpos = (x, y, 0.0005, np.cos(half), 0, 0, np.sin(half))
        for k in range(episode.balls):
            layer, place = divmod(k, _PER_LAYER)
            angle = episode.ball_turn + 2 * np.pi * (place / _PER_LAYER) + 0.3 * layer
            start = (x + 0.023 * np.cos(angle), y + 0.023 * np.sin(angle), 0.016 + 0.017 * layer)
            data.joint(f"ball{k}").qpos[:3] = start
        mujoco.mj_step(self.model, data, _SETTLE_STEPS)
        data.time = 0.0

    @property
    def pitcher_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the pitcher's bottom in the world; privileged."""
        return self._pose_of("pitcher")

    @property
    def ball_positions(self) -> NDArray[np.float64]:
        """Centres of the balls in the world [m], shape (balls, 3); privileged."""
        return ball_states(self.data, self.episode.balls)[0]

    def _update(self) -> dict[str, Any]:
        touching = contact_names(self.model, self.data, "pitcher")
        position, rotation = self.pitcher_pose
        by_hand = touched_by_hand(self.hand, touching)
        holding = pinched(self.hand, touching)
        inside, lost = self._count_balls()
        enough = SHARE * self.episode.balls
        poured = inside >= enough
        on_table = "table" in touching
        at_rest = np.linalg.norm(self.data.joint("pitcher").qvel[:3]) < 0.02
        standing = on_table and at_rest and rotation[2, 2] > np.cos(np.radians(6)) and position[2] < 0.01
        handle = position + rotation @ np.array(HANDLE_CENTRE)
        away = np.linalg.norm(self.data.site_xpos[self._tips] - handle, axis=1).min() > 0.05
        released = poured and standing and not by_hand
        success = has_settled(self.memory, released and away)
        lifted = holding and position[2] > 0.05
        lip = position + rotation @ np.array([-PITCHER_RADIUS, 0.0, PITCHER_HEIGHT])
        over = np.linalg.norm(lip[:2] - self.episode.bowl) < BOWL_RADIUS
        stages = (holding, lifted, lifted and over, poured, poured and standing, success)
        fallen = on_table and rotation[2, 2] < 0.5
        return {
            "is_success": success,
            "progress": furthest_progress(self.memory, stages),
            "dropped": bool(fallen or "floor" in touching or self.episode.balls - lost < enough),
            "holding": holding,
            "contacts": contact_flags(self.hand, touching),
            "balls_in_bowl": inside,
        }

    def _count_balls(self) -> tuple[int, int]:
        """Return how many balls rest in the bowl, and how many lie on the table or below."""
        balls, speeds = ball_states(self.data, self.episode.balls)
        position, rotation = self.pitcher_pose
        from_bowl = np.linalg.norm(balls[:, :2] - self.episode.bowl, axis=1)
        in_bowl = (from_bowl < BOWL_RADIUS) & (balls[:, 2] < BOWL_HEIGHT)
        local = (balls - position) @ rotation
        in_pitcher = (np.linalg.norm(local[:, :2], axis=1) < PITCHER_RADIUS) & (local[:, 2] > 0)
        lost = ~in_bowl & ~in_pitcher & (balls[:, 2] < 2 * BALL_RADIUS)
        return int((in_bowl & (speeds < 0.1)).sum()), int(lost.sum())


def _add_bowl(spec: mujoco.MjSpec, position: tuple[float, float]) -> None:
    """Add a bowl of flared boxes, fixed to the table."""
    bowl = spec.worldbody.add_body(name="bowl", pos=(*position, 0))
    yellow = (0.9, 0.75, 0.4, 1)
    foot = BOWL_RADIUS - BOWL_HEIGHT * np.tan(_BOWL_FLARE)
    middle = (BOWL_RADIUS + foot) / 2
    half_size = (_WALL / 2, BOWL_RADIUS * np.tan(np.pi / _BOWL_WALLS), BOWL_HEIGHT / np.cos(_BOWL_FLARE) / 2)
    for k in range(_BOWL_WALLS):
        angle = 2 * np.pi * k / _BOWL_WALLS
        place = (middle * np.cos(angle), middle * np.sin(angle), BOWL_HEIGHT / 2)
        wall = add_block(bowl, f"bowl_wall{k}", half_size, place, yellow)
        turn, flare = angle / 2, _BOWL_FLARE / 2  # About z, then about the wall's own y.
        wall.quat = (
            np.cos(turn) * np.cos(flare),
            -np.sin(turn) * np.sin(flare),
            np.cos(turn) * np.sin(flare),
            np.sin(turn) * np.cos(flare),
        )
    _add_disc(bowl, "bowl_bottom", foot + 0.004, yellow)


def _add_pitcher(spec: mujoco.MjSpec, mass: float, handle_half_width: float) -> None:
    """Add a round of walls, a bottom, and a straight bar on two struts as its handle."""
    body = spec.worldbody.add_body(name="pitcher")
    body.add_freejoint(name="pitcher")
    light, dark = (0.55, 0.75, 0.95, 1), (0.15, 0.35, 0.75, 1)
    distance = PITCHER_RADIUS + _WALL / 2
    half_width = PITCHER_RADIUS * np.tan(np.pi / _WALLS) + _WALL / 2
    parts = []
    for k in range(_WALLS):
        angle = 2 * np.pi * k / _WALLS
        place = (distance * np.cos(angle), distance * np.sin(angle), PITCHER_HEIGHT / 2)
        wall = add_block(body, f"pitcher_wall{k}", (_WALL / 2, half_width, PITCHER_HEIGHT / 2), place, light)
        wall.quat = (np.cos(angle / 2), 0, 0, np.sin(angle / 2))
        parts.append(wall)
    parts.append(_add_disc(body, "pitcher_bottom", PITCHER_RADIUS + _WALL, dark))
    half_size = (HANDLE_HALF_DEPTH, handle_half_width, HANDLE_HALF_HEIGHT)
    handle = [add_block(body, "pitcher_handle", half_size, HANDLE_CENTRE, dark)]
    x, _, z = HANDLE_CENTRE
    start, end = PITCHER_RADIUS + _WALL, x + HANDLE_HALF_DEPTH
    for side in (-1, 1):
        place = ((start + end) / 2, 0, z + side * (HANDLE_HALF_HEIGHT + 0.004))
        handle.append(add_block(body, f"pitcher_strut{side}", ((end - start) / 2, 0.006, 0.004), place, dark))
    for geoms, share in ((parts, 1 - _HANDLE_SHARE), (handle, _HANDLE_SHARE)):
        for geom in geoms:
            geom.mass, geom.condim = share * mass / len(geoms), 4


def _add_disc(body: mujoco.MjsBody, name: str, radius: float, rgba: Any) -> mujoco.MjsGeom:
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(radius, _WALL, 0),
        pos=(0, 0, _WALL),
        rgba=rgba,
        **ContactSurface()._asdict(),
    )
