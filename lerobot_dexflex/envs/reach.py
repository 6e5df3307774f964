"""Reach: move an object that the hand holds to a goal pose, without dropping it, under any gravity."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.envs.hand_env import HandEnv, Snapshot
from lerobot_dexflex.envs.rendering import tune_visuals
from lerobot_dexflex.envs.scene import add_palm_camera
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.contacts import CONTACT_FORCE, contact_flags, contact_names, fingertip_contacts
from lerobot_dexflex.hand.grasp import OBJECT, GraspSearch, hand_scene
from lerobot_dexflex.hand.grasp_candidates import GRAVITY
from lerobot_dexflex.hand.grasp_frame import palm_point, palm_turn
from lerobot_dexflex.hand.objects import ObjectSpec, add_ghost, sample_object
from lerobot_dexflex.hand.poses import pose_error
from lerobot_dexflex.hands import PALM, Hand

Array = NDArray[np.float64]

GOAL_DISTANCE = (0.015, 0.035)
"""How far a goal is from the object when it is set [m]."""
GOAL_ANGLE = (0.3, 1.0)
"""How far it is turned [rad]."""
GOAL_RADIUS = 0.035
"""Goals stay this close to where the object was first held [m]."""
TOLERANCE = (0.010, 0.25)
"""A goal is reached within this distance [m] and angle [rad] ..."""
STEADY_STEPS = 5
"""... for so many control steps in a row."""
DROP_DISTANCE = 0.08
"""The object is lost this far from the goal [m], or after `DROP_STEPS` with fewer than two fingers on it."""
DROP_STEPS = 6

_CONTROL_PERIOD = robot.TIMESTEP * robot.SUBSTEPS
_MANY_FINGERS = 0.5
"""How often a grasp with four fingers or more is sought first; about half of these searches find one."""
_GHOST = "goal"


@dataclass(frozen=True)
class ReachEpisode:
    """Everything that is fixed at the start of an episode; palm frame = world frame."""

    object_spec: ObjectSpec
    gravity: tuple[float, ...]
    """Unit direction of gravity at the start."""
    gravity_axis: tuple[float, ...]
    """Unit axis about which gravity turns, if it does."""
    hand_joints: tuple[float, ...]
    """Joints in the initial grasp [rad]."""
    joint_targets: tuple[float, ...]
    """The command that holds it: `hand_joints` and the squeeze [rad]."""
    position: tuple[float, ...]
    """Initial object position [m]."""
    quaternion: tuple[float, ...]
    """Initial object orientation (w x y z)."""

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the episode that `dataclasses.asdict` described, also after a way through JSON."""
        spec: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in values["object_spec"].items()
        }
        rest = {k: tuple(v) for k, v in values.items() if k != "object_spec"}
        return cls(ObjectSpec(**spec), **rest)


class ReachEnv(HandEnv):
    """Bring the object in the hand to the goal pose that a ghost shows; see `HandEnv` for the spaces.

    There is no arm: the palm frame is the world frame, the joint targets of the hand are the action, and the
    direction of gravity is random instead of the palm's. An episode starts in a grasp that holds under its
    constant command (`command`): a policy that starts from the *measured* joints opens the hand.

    The goal is seen in the images only. The true poses are `object_pose` and `goal_pose`; privileged.

    Args:
        goals: How many goals to reach in a row; success ends the episode after the last one.
        gravity_rate: How fast gravity turns about a random axis [rad/s].
        **options: As of `HandEnv`.
    """

    task = "Reach-v0"
    manipulated = OBJECT

    def __init__(self, goals: int = 1, gravity_rate: float = 0.0, **options: Any) -> None:
        if goals < 1:
            raise DexFlexError(f"`goals` must be at least 1. Got {goals}.")
        if not np.isfinite(gravity_rate):
            raise DexFlexError(f"`gravity_rate` must be finite, in rad/s. Got {gravity_rate}.")
        super().__init__(**options)
        self._goals, self._gravity_rate = goals, gravity_rate

    def begin(self, episode: ReachEpisode, seed: int) -> dict[str, Any]:
        """Start a given episode instead of drawing one; `seed` decides goals and touch noise.

        Returns:
            The observation.
        """
        self.np_random = np.random.default_rng(seed)
        return self._start(episode)[0]

    @property
    def object_pose(self) -> tuple[Array, Array]:
        """Position [m] (3,) and orientation (w x y z) of the object in the palm frame; privileged."""
        pose = self.data.joint(f"{OBJECT}_free").qpos
        return pose[:3].copy(), pose[3:].copy()

    @property
    def goal_pose(self) -> tuple[Array, Array]:
        """Position [m] (3,) and orientation (w x y z) of the goal in the palm frame; privileged."""
        return self.data.mocap_pos[0].copy(), self.data.mocap_quat[0].copy()

    def advance(self, action: NDArray) -> None:
        """Execute joint targets [rad] for one control step without observing; gravity turns, if it does."""
        super().advance(action)
        if self._gravity_rate:
            self.memory["turned"] = self.memory.get("turned", 0.0) + self._gravity_rate * _CONTROL_PERIOD
            self._turn_gravity()

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of this or another environment of the same task, bit for bit."""
        super().restore(snapshot)
        self._turn_gravity()
        mujoco.mj_forward(self.model, self.data)

    def _sample_episode(self, rng: np.random.Generator) -> ReachEpisode:
        while True:
            object_spec = sample_object(rng)
            gravity, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
            fingers, tries = (4, 100) if rng.random() < _MANY_FINGERS else (3, 200)
            fingers = min(fingers, self.hand.n_fingers)
            try:
                grasp = GraspSearch(self.hand, object_spec, gravity).find(rng, fingers, tries)
            except DexFlexError:  # This object cannot be held so; the next one may.
                continue
            return ReachEpisode(object_spec, tuple(gravity), tuple(axis), *map(tuple, grasp[:4]))

    def _build(self, episode: ReachEpisode) -> mujoco.MjSpec:
        spec = hand_scene(self.hand, episode.object_spec)
        spec.option.gravity = GRAVITY * np.array(episode.gravity)
        add_ghost(spec, episode.object_spec, _GHOST)
        tune_visuals(spec)
        _light_both_sides(self.hand, spec)
        front, up = {"position": (0.16, -0.24, -0.30), "target": (-0.02, -0.02, -0.09), "fovy": 40}, (0, 0, 1)
        add_palm_camera(self.hand, spec.worldbody, "front", up=up, **front)
        wrist = {"position": (-0.05, 0.13, 0.03), "target": (-0.05, 0.0, -0.17), "fovy": 70}
        add_palm_camera(self.hand, spec.body(PALM), "wrist", **wrist)
        return spec

    def _initialise(self, episode: ReachEpisode) -> None:
        start = (*episode.hand_joints, *episode.position, *episode.quaternion)
        self.data.qpos[: len(start)] = start
        self.data.ctrl[:] = episode.joint_targets

    def _update(self) -> dict[str, Any]:
        if "reached" not in self.memory:
            self.memory.update(reached=0, loose=0)
            self._set_goal()
        distance, angle = pose_error(*self.object_pose, *self.goal_pose)
        inside = distance < TOLERANCE[0] and angle < TOLERANCE[1]
        memory = self.memory
        memory["steady"] = memory["steady"] + 1 if inside else 0
        error = distance / TOLERANCE[0] + angle / TOLERANCE[1]
        memory["least_error"] = min(memory["least_error"], error)
        loads = fingertip_contacts(self.hand, self.model, self.data, OBJECT).loads
        memory["loose"] = 0 if (loads > CONTACT_FORCE).sum() >= 2 else memory["loose"] + 1
        dropped = distance > DROP_DISTANCE or memory["loose"] >= DROP_STEPS
        if memory["steady"] >= STEADY_STEPS:
            memory["reached"] += 1
            if memory["reached"] < self._goals:
                self._set_goal()
        share = 1.0 - memory["least_error"] / memory["first_error"]
        success = memory["reached"] >= self._goals
        progress = 1.0 if success else (memory["reached"] + share) / self._goals
        return {
            "is_success": bool(success),
            "progress": float(np.clip(progress, 0.0, 1.0)),
            "dropped": bool(dropped and not success),
            "contacts": contact_flags(self.hand, contact_names(self.model, self.data, OBJECT)),
            "goals_reached": memory["reached"],
        }

    def _set_goal(self) -> None:
        """Draw a goal near the object and show it."""
        rng = self.np_random
        position, quaternion = self.object_pose
        home = np.array(self.episode.position)
        while True:
            direction, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
            goal = position + rng.uniform(*GOAL_DISTANCE) * direction
            if np.linalg.norm(goal - home) < GOAL_RADIUS or np.linalg.norm(position - home) > GOAL_RADIUS:
                break
        turn, turned = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, axis, rng.uniform(*GOAL_ANGLE))
        mujoco.mju_mulQuat(turned, turn, quaternion)
        self.data.mocap_pos[0], self.data.mocap_quat[0] = goal, turned
        mujoco.mj_forward(self.model, self.data)
        distance, angle = pose_error(position, quaternion, goal, turned)
        error = distance / TOLERANCE[0] + angle / TOLERANCE[1]
        self.memory.update(steady=0, first_error=error, least_error=error)

    def _turn_gravity(self) -> None:
        turn, direction = np.zeros(4), np.zeros(3)
        angle = self.memory.get("turned", 0.0)
        mujoco.mju_axisAngle2Quat(turn, np.array(self.episode.gravity_axis), angle)
        mujoco.mju_rotVecQuat(direction, np.array(self.episode.gravity), turn)
        self.model.opt.gravity = GRAVITY * direction


def _light_both_sides(hand: Hand, spec: mujoco.MjSpec) -> None:
    """Let the key light shine on the palm's side, the fill light on the back, before bright panels."""
    turn = palm_turn(hand)
    key, fill = spec.light("key"), spec.light("fill")
    key.dir, fill.dir = turn @ (key.dir[0], key.dir[1], -key.dir[2]), turn @ fill.dir
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    for name, height in (("ceiling", 0.15), ("floor", -0.6)):
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(2, 2, 0.005),
            pos=palm_point(hand, (0, 0, height)),
            quat=quaternion,
            contype=0,
            conaffinity=0,
            rgba=(0.55, 0.57, 0.6, 1),
        )
