"""BrushSweep: take a hand brush from its stand and sweep the balls into the dustpan."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.scene import (
    add_ball,
    add_block,
    add_camera,
    add_palm_camera,
    ball_states,
    place_robot,
    robot_at_table,
)
from lerobot_dexflex.envs.stages import has_settled
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.contacts import contact_flags, contact_names, pinched

ARM_START = (0.40, -0.35, 0.0, 0.95, 0.0, 1.3, np.pi / 2 + 0.40)
"""Arm at the start of an episode [rad]: the hand hovers behind the stand, palm down."""
HANDLE_HALF_DEPTH, HANDLE_HALF_LENGTH = 0.008, 0.07
"""Half height and half length of the handle's bar [m]; its frame: z along it to the head, x up."""
HEAD_HALF_SIZE = (0.008, 0.012, 0.04)
HEAD_CENTRE = 0.11
"""Centre of the head along the handle, from the handle's centre [m]."""
BRISTLE_END, BRISTLE_HALF_DEPTH = -0.050, 0.008
"""Where the bristles end in the brush's frame, along x, and half their depth along y [m].
Fingertips pass above the pan's walls."""
PAN_HALF_WIDTH, PAN_DEPTH, PAN_HEIGHT = 0.075, 0.11, 0.02
"""The dustpan inside [m]; its frame: origin on the table in the middle of the lip, y out of it, z up."""
LIP_DEPTH, LIP_HEIGHT = 0.02, 0.0025
"""The lip rises from the table by so much over so much [m]; behind it the floor lies lower."""
PIECES_ALONG, PIECES_AHEAD = 0.05, (0.06, 0.16)
"""Where pieces lie in the pan's frame: |x| at most, and y from, to [m]."""
SHARE = 0.8
"""Share of the pieces that must lie in the pan."""

_HANDLE_SHARE = 0.6
"""Share of the mass in the handle, as the hammer's."""
_LYING = 0.03
"""A brush whose handle's centre is lower than this has been dropped [m]."""
_STAND_HEIGHT, _PAN_FLOOR, _WALL = 0.012, 0.001, 0.002
_HARD = 0.99
"""Impedance of the pieces' contacts: a brush of 2 N does not press them into the table."""
_SOFTNESS = 0.6
"""Time constant of bristles on the ground per square root of the brush's mass [s/kg^.5]:
all brushes give way alike, about 4 mm per newton on a free one."""


@dataclass(frozen=True)
class BrushEpisode:
    """Everything random about an episode; lengths [m], angles [rad]."""

    handle_half_width: float
    mass: float
    """Mass of the brush [kg]."""
    tip_friction: float
    scrape_friction: float
    """Of the bristles on table and pan."""
    stand: tuple[float, float, float]
    """Position x, y of the handle's centre and yaw: the handle points away from the robot at yaw 0."""
    brush_yaw: float
    """How the brush lies askew in its stand."""
    pan: tuple[float, float, float]
    """Position x, y and yaw of the pan: it opens to the robot's left at yaw 0."""
    piece_radius: float
    piece_mass: float
    """Mass of each piece [kg]."""
    pieces: tuple[tuple[float, float], ...]
    """Where the pieces lie in the pan's frame, x, y."""
    arm_noise: tuple[float, ...]
    """Offset of the arm from its nominal start."""


class BrushSweepEnv(HandEnv):
    """Sweep the pieces into the dustpan; see `HandEnv` for observations and actions.

    The block of bristles is rigid; its soft contact with table and pan stands for bristles that bend. The
    head is in front of the hand, so that scraping twists the grasp.

    Success: at least 80 % of the pieces rest in the pan while thumb and a finger hold the brush, for half a
    second. Progress is the largest share of the pieces that have rested in the pan so far.
    Dropping the brush, or pieces off the table so that too few are left, ends the episode.
    """

    task = "BrushSweep-v0"
    manipulated = "brush"

    def _sample_episode(self, rng: np.random.Generator) -> BrushEpisode:
        return BrushEpisode(
            handle_half_width=rng.uniform(0.009, 0.014),
            mass=rng.uniform(0.05, 0.10),
            tip_friction=rng.uniform(0.8, 1.2),
            scrape_friction=rng.uniform(0.5, 0.8),
            stand=(rng.uniform(0.42, 0.45), rng.uniform(0.18, 0.21), rng.uniform(-0.3, 0.3)),
            brush_yaw=rng.normal(scale=0.02),
            pan=(rng.uniform(0.55, 0.59), rng.uniform(-0.18, -0.14), rng.uniform(-0.2, 0.2)),
            piece_radius=rng.uniform(0.004, 0.005),
            piece_mass=rng.uniform(0.0005, 0.001),
            pieces=_scatter(rng, int(rng.integers(8, 13))),
            arm_noise=tuple(rng.normal(scale=0.03, size=len(robot.ARM_JOINTS))),
        )

    def _build(self, episode: BrushEpisode) -> mujoco.MjSpec:
        spec, palm = robot_at_table(self.hand, episode.tip_friction)
        add_camera(spec, "front", position=(1.02, -0.36, 0.52), target=(0.48, -0.02, 0.05), fovy=44)
        add_palm_camera(
            self.hand, palm, "wrist", position=(-0.05, 0.13, 0.03), target=(-0.05, 0.0, -0.17), fovy=70
        )
        _add_stand(spec, episode.stand)
        _add_pan(spec, episode.pan)
        _add_brush(spec, episode)
        for k in range(len(episode.pieces)):
            piece = add_ball(spec, f"ball{k}", episode.piece_radius, episode.piece_mass)
            piece.priority, piece.solref, piece.solimp[:2] = 1, robot.TIP_SOLREF, _HARD
        return spec

    def _initialise(self, episode: BrushEpisode) -> None:
        place_robot(self.hand, self.data, np.add(ARM_START, episode.arm_noise))
        x, y, yaw = episode.stand
        handle = np.array([np.cos(yaw + episode.brush_yaw), np.sin(yaw + episode.brush_yaw), 0.0])
        rotation = np.stack([np.array([0.0, 0.0, 1.0]), np.cross(handle, [0.0, 0.0, 1.0]), handle], 1)
        pose = self.data.joint("brush").qpos
        pose[:3] = (x, y, _STAND_HEIGHT - BRISTLE_END + 0.0005)
        mujoco.mju_mat2Quat(pose[3:7], rotation.ravel())
        position, turn = self.pan_pose
        for k, (along, ahead) in enumerate(episode.pieces):
            self.data.joint(f"ball{k}").qpos[:3] = position + turn @ (along, ahead, episode.piece_radius)

    @property
    def brush_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the handle's centre in the world; privileged."""
        return self._pose_of("brush")

    @property
    def pan_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and orientation (3, 3) of the pan in the world."""
        x, y, yaw = self.episode.pan
        cosine, sine = np.cos(yaw), np.sin(yaw)
        return np.array([x, y, 0.0]), np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])

    def pieces_in_pan_frame(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the pieces' centres in the pan's frame [m] (n, 3), and which rest in it (n,)."""
        positions, speeds = ball_states(self.data, len(self.episode.pieces))
        position, rotation = self.pan_pose
        local = (positions - position) @ rotation
        within = (np.abs(local[:, 0]) < PAN_HALF_WIDTH) & (np.abs(local[:, 2]) < PAN_HEIGHT)
        within &= (local[:, 1] < -LIP_DEPTH) & (local[:, 1] > -PAN_DEPTH)
        return local, within & (speeds < 0.05)

    def _update(self) -> dict[str, Any]:
        touching = contact_names(self.model, self.data, "brush")
        holding = pinched(self.hand, touching)
        local, resting = self.pieces_in_pan_frame()
        inside, enough = int(resting.sum()), SHARE * len(resting)
        self.memory["most_inside"] = max(self.memory.get("most_inside", 0), inside)
        lying = self.brush_pose[0][2] < _LYING
        lost = int((local[:, 2] < 0).sum())
        return {
            "is_success": has_settled(self.memory, holding and inside >= enough),
            "progress": self.memory["most_inside"] / len(resting),
            "dropped": bool((lying and not holding) or "floor" in touching or len(resting) - lost < enough),
            "holding": holding,
            "contacts": contact_flags(self.hand, touching),
            "pieces_in_pan": inside,
        }


def _scatter(rng: np.random.Generator, n: int) -> tuple[tuple[float, float], ...]:
    """Draw n places in the pan's frame that are at least 12 mm apart."""
    places: list[tuple[float, float]] = []
    while len(places) < n:
        place = (rng.uniform(-PIECES_ALONG, PIECES_ALONG), rng.uniform(*PIECES_AHEAD))
        if all(np.hypot(place[0] - x, place[1] - y) > 0.012 for x, y in places):
            places.append(place)
    return tuple(places)


def _add_stand(spec: mujoco.MjSpec, place: tuple[float, float, float]) -> None:
    """Add a foot under the bristles and a rail under the handle's end."""
    x, y, yaw = place
    brown = (0.45, 0.3, 0.18, 1)
    stand = spec.worldbody.add_body(
        name="stand", pos=(x, y, 0), quat=(np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    )
    foot, rail = _STAND_HEIGHT / 2, (_STAND_HEIGHT - BRISTLE_END - HANDLE_HALF_DEPTH) / 2
    add_block(stand, "stand_foot", (0.04, 0.022, foot), (HEAD_CENTRE, 0, foot), brown)
    for side in (-1, 1):
        where = (HEAD_CENTRE, side * (BRISTLE_HALF_DEPTH + 0.003), foot + 0.004)
        add_block(stand, f"stand_cheek{side}", (0.03, 0.002, foot + 0.004), where, brown)
    add_block(stand, "stand_rail", (0.005, 0.022, rail), (-0.063, 0, rail), brown)


def _add_pan(spec: mujoco.MjSpec, place: tuple[float, float, float]) -> None:
    """Add a floor, a lip that rises like a ramp and three walls, fixed to the table."""
    x, y, yaw = place
    green, dark = (0.25, 0.65, 0.45, 1), (0.1, 0.4, 0.3, 1)
    pan = spec.worldbody.add_body(name="pan", pos=(x, y, 0), quat=(np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)))
    depth, height, width = PAN_DEPTH / 2, PAN_HEIGHT / 2, PAN_HALF_WIDTH + _WALL
    floor, back = (0, -depth - LIP_DEPTH / 2, _PAN_FLOOR / 2), (0, -PAN_DEPTH - _WALL, height)
    add_block(pan, "pan_floor", (PAN_HALF_WIDTH, depth - LIP_DEPTH / 2, _PAN_FLOOR / 2), floor, green)
    slope, half = np.arctan2(LIP_HEIGHT, LIP_DEPTH), np.hypot(LIP_HEIGHT, LIP_DEPTH) / 2
    sheet = _PAN_FLOOR / 2 * np.array([0.0, np.sin(slope), np.cos(slope)])
    middle = np.array([0.0, -LIP_DEPTH / 2, LIP_HEIGHT / 2]) - sheet
    lip = add_block(pan, "pan_lip", (PAN_HALF_WIDTH, half, _PAN_FLOOR / 2), middle, green)
    lip.quat = (np.cos(slope / 2), -np.sin(slope / 2), 0, 0)
    for side in (-1, 1):
        add_block(pan, f"pan_side{side}", (_WALL, depth, height), (side * width, -depth, height), dark)
    add_block(pan, "pan_back", (width + _WALL, _WALL, height), back, dark)


def _add_brush(spec: mujoco.MjSpec, episode: BrushEpisode) -> None:
    """Add a bar as the handle, the head at its end, and under the head a block of bristles."""
    body = spec.worldbody.add_body(name="brush")
    body.add_freejoint(name="brush")
    bar = (HANDLE_HALF_DEPTH, episode.handle_half_width, HANDLE_HALF_LENGTH)
    handle = add_block(body, "brush_handle", bar, (0, 0, 0), (0.85, 0.55, 0.2, 1))
    head = add_block(body, "brush_head", HEAD_HALF_SIZE, (0, 0, HEAD_CENTRE), (0.75, 0.15, 0.15, 1))
    half = (-BRISTLE_END - HEAD_HALF_SIZE[0]) / 2
    block, middle = (half, BRISTLE_HALF_DEPTH, HEAD_HALF_SIZE[2]), (BRISTLE_END + half, 0, HEAD_CENTRE)
    bristles = add_block(body, "brush_bristles", block, middle, (0.9, 0.85, 0.6, 1))
    rest = (1 - _HANDLE_SHARE) / 2
    for geom, share in ((handle, _HANDLE_SHARE), (head, rest), (bristles, rest)):
        geom.mass, geom.condim = share * episode.mass, 4
    for ground in ("table", "pan_floor", "pan_lip"):
        pair = spec.add_pair(geomname1="brush_bristles", geomname2=ground, condim=3)
        pair.friction[:2] = episode.scrape_friction
        pair.solref = (_SOFTNESS * np.sqrt(episode.mass), 1.0)
