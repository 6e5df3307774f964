"""The tactile hand as a plain Gymnasium environment; tasks fill in the scene and the success test."""

import copy
import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import gymnasium
import mujoco
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from lerobot_dexflex.envs.disturbance import find_disturbance
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.envs.rendering import Camera
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hand.touch import TouchConfig, TouchSensor, add_touch
from lerobot_dexflex.hands import Hand, get_hand

CAMERAS = ("front", "wrist")


class Snapshot(NamedTuple):
    """Everything that decides the future of an episode, bit for bit."""

    hand: str
    """Name of the hand."""
    episode: Any
    physics: NDArray[np.float64]
    command: NDArray[np.float64]
    touch: Any
    rng: Mapping[str, Any]
    memory: dict[str, Any]


class HandEnv(gymnasium.Env):
    """Control a hand (and its arm) by absolute joint targets at 20 Hz.

    A task implements `_sample_episode`, `_build`, `_initialise`, `_update` and names its `task`.

    Observation (all float32 but the images):
        pixels: one uint8 image (image_size, image_size, 3) per camera, `front` and `wrist`.
        agent_pos: measured joint positions, 7 of an arm if there is one, the hand's [rad]. Shape (joints,).
        tactile: taxel normal forces, flat [N]. Shape (fingers x taxels along x taxels across,).
        fingertips: measured fingertip points in the palm frame, flat [m]. Shape (3 fingers,).
        gravity: unit gravity direction in the palm frame. Shape (3,).

    Action: absolute joint targets [rad], same joints as `agent_pos`; values outside the joint limits are
    clipped. Targets are interpolated linearly over the control step.

    Args:
        render_mode: `rgb_array` or None.
        cameras: Cameras that are rendered into `pixels`; empty for fast runs without images.
        image_size: Width and height of the observed images [pixel].
        render_size: Width and height of `render()`'s image [pixel].
        touch: Sensor effects; `TouchConfig.ideal()` switches them off.
        disturbance: What differs from the demonstrations: a name of `disturbance.DISTURBANCES`.
        hand: The hand, or its name as `get_hand` takes it.
    """

    metadata: ClassVar[dict[str, Any]] = {  # pyright: ignore[reportIncompatibleVariableOverride]
        "render_modes": ["rgb_array"],
        "render_fps": 20,
    }
    task: ClassVar[str]
    """Name in `TASKS`."""
    manipulated: ClassVar[str]
    """Name of the body that the hand is to move."""

    model: mujoco.MjModel
    data: mujoco.MjData
    episode: Any

    def __init__(
        self,
        render_mode: str | None = "rgb_array",
        cameras: Sequence[str] = CAMERAS,
        image_size: int = 96,
        render_size: int = 256,
        touch: TouchConfig | None = None,
        disturbance: str = "none",
        hand: str | Hand = "leap",
    ) -> None:
        unknown = set(cameras) - set(CAMERAS)
        if unknown:
            raise DexFlexError(f"Unknown cameras {sorted(unknown)}. Valid cameras: {list(CAMERAS)}.")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise DexFlexError(f"`render_mode` must be 'rgb_array' or None. Got {render_mode!r}.")
        self.hand = get_hand(hand) if isinstance(hand, str) else hand
        self.render_mode = render_mode
        self.task_description = TASKS[self.task].description
        self.seeing = True
        """Whether cameras are rendered; if not, observations repeat the last images. `reset` looks again."""
        self._cameras = tuple(cameras)
        self._image_size, self._render_size = image_size, render_size
        self._disturbance = find_disturbance(disturbance)
        self._touch_config = self._disturbance.touch(touch or TouchConfig())
        limits = {link.joint: link.joint_range for link in (*robot.xarm7.LINKS, *self.hand.links)}
        low, high = np.array([limits[name] for name in self.joints]).T
        self._low, self._high = low, high
        self.action_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self.observation_space = spaces.Dict(self._observation_spaces())

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, the arm's before the hand's."""
        return TASKS[self.task].joints(self.hand)

    def _observation_spaces(self) -> dict[str, spaces.Space]:
        hand = self.hand
        image = spaces.Box(0, 255, (self._image_size, self._image_size, 3), np.uint8)
        found: dict[str, spaces.Space] = {}
        if self._cameras:
            found["pixels"] = spaces.Dict(dict.fromkeys(self._cameras, image))
        return found | {
            "agent_pos": spaces.Box(-np.inf, np.inf, (len(self.joints),), np.float32),
            "tactile": spaces.Box(0, np.inf, (hand.n_fingers * math.prod(hand.taxels),), np.float32),
            "fingertips": spaces.Box(-np.inf, np.inf, (3 * hand.n_fingers,), np.float32),
            "gravity": spaces.Box(-1.001, 1.001, (3,), np.float32),
        }

    @abstractmethod
    def _sample_episode(self, rng: np.random.Generator) -> Any:
        """Draw everything that is random about an episode."""

    @abstractmethod
    def _build(self, episode: Any) -> mujoco.MjSpec:
        """Return robot, cameras and scene of an episode; touch is added to every task alike."""

    @abstractmethod
    def _initialise(self, episode: Any) -> None:
        """Set `data.qpos` and `data.ctrl` to the start of the episode."""

    @abstractmethod
    def _update(self) -> dict[str, Any]:
        """Judge the state after a control step.

        Returns at least `is_success`, `progress` in [0, 1], and `contacts`, the `contact_flags` of the
        manipulated body.

        What it must remember between steps belongs into `self.memory`, which snapshots carry.
        """

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start the episode that `seed` alone decides."""
        super().reset(seed=seed)
        del options
        self.seeing = True
        return self._start(self._sample_episode(self.np_random))

    def _start(self, episode: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        self._load(episode)
        self.memory: dict[str, Any] = {}
        if self._disturbance.calibration:
            self.memory["encoder_errors"] = self._disturbance.encoder_errors(self.hand, self.np_random)
        self._set_encoders()
        self._initialise(episode)
        mujoco.mj_forward(self.model, self.data)
        self._command = self.data.ctrl.copy()
        return self.observe(), self._update()

    def step(self, action: NDArray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Run one control step of 50 ms; success and an unrecoverable drop end the episode.

        Raises:
            DexFlexError: If the action has another shape or holds NaN or infinity; nothing is executed.
        """
        self.advance(action)
        info = self._update()
        done = bool(info["is_success"] or info.get("dropped", False))
        return self.observe(), float(info["is_success"]), done, False, info

    def advance(self, action: NDArray) -> None:
        """Execute joint targets [rad] for one control step without observing."""
        target = np.asarray(action, dtype=np.float64)
        if target.shape != self.action_space.shape:
            raise DexFlexError(
                f"The action of {self.task} must have shape {self.action_space.shape} "
                f"(joint targets [rad]: {', '.join(self.joints)}). Got shape {target.shape}."
            )
        if not np.isfinite(target).all():
            bad = [self.joints[k] for k in np.flatnonzero(~np.isfinite(target))]
            raise DexFlexError(f"The action holds NaN or infinity at {bad}; send finite joint targets [rad].")
        target = np.clip(target, self._low, self._high)
        if self._disturbance.push:
            push = self._disturbance.force(self.np_random, self._weight, self.memory)
            self.data.xfrc_applied[self._object, :3] = push
        model, data, start = self.model, self.data, self._command
        stride = (target - start) / robot.SUBSTEPS
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        for k in range(1, robot.SUBSTEPS + 1):
            data.ctrl[:] = start + k * stride
            mujoco.mj_step(model, data)
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        # Contacts and sensors of the state itself, not of 2 ms earlier: a restored snapshot sees the same.
        mujoco.mj_forward(model, data)
        self._command = target

    def _pose_of(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return position [m] (3,) and orientation (3, 3) of a body's frame in the world."""
        body = self.data.body(name)
        return body.xpos.copy(), body.xmat.reshape(3, 3).copy()

    def physics_state(self) -> NDArray[np.float64]:
        """Return MuJoCo's integration state, the part of a snapshot that is of the simulator."""
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        physics = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, self.data, physics, kind)
        return physics

    def snapshot(self) -> Snapshot:
        """Return the full state of the running episode; the time limit's wrapper keeps its own counter."""
        return Snapshot(
            self.hand.name,
            self.episode,
            self.physics_state(),
            self._command.copy(),
            self._touch.state(),
            copy.deepcopy(self.np_random.bit_generator.state),
            copy.deepcopy(self.memory),
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of this or another environment of the same task and hand, bit for bit.

        Raises:
            DexFlexError: If the snapshot is of another hand.
        """
        if snapshot.hand != self.hand.name:
            raise DexFlexError(
                f"The snapshot is of the hand '{snapshot.hand}', this environment has '{self.hand.name}'. "
                f"Restore it in one made with `hand='{snapshot.hand}'`."
            )
        if snapshot.episode != getattr(self, "episode", None):
            self._load(snapshot.episode)
        self.memory = copy.deepcopy(snapshot.memory)
        self._set_encoders()
        mujoco.mj_setState(self.model, self.data, snapshot.physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self.model, self.data)
        self._command = snapshot.command.copy()
        self._touch.set_state(snapshot.touch)
        self.np_random.bit_generator.state = copy.deepcopy(snapshot.rng)

    def render(self) -> NDArray[np.uint8] | None:
        """Return the front camera's image, shape (render_size, render_size, 3), uint8."""
        if self.render_mode is None:
            return None
        return self._film.render(self.data)

    @property
    def command(self) -> NDArray[np.float64]:
        """The joint targets that were executed last [rad]."""
        return self._command.copy()

    @property
    def pad_forces(self) -> NDArray[np.float64]:
        """True contact normal force on each fingertip [N]. Shape (fingers,)."""
        return self._touch.normal_forces(self.data)

    def _load(self, episode: Any) -> None:
        self.episode = episode
        spec = self._build(episode)
        add_touch(spec, self.hand, self._touch_config)
        self.model = spec.compile()
        self._object = self.model.body(self.manipulated).id
        self._weight = float(self.model.body_mass[self._object] * np.linalg.norm(self.model.opt.gravity))
        self._disturbance.change(self.hand, self.model, self.manipulated)
        self.data = mujoco.MjData(self.model)
        self._touch = TouchSensor(self.model, self.hand, self._touch_config)
        self._film = Camera(self.model, "front", self._render_size, self._render_size)
        self._views = {c: Camera(self.model, c, self._image_size, self._image_size) for c in self._cameras}
        addresses = [self.model.joint(name).qposadr[0] for name in self.joints]
        self._joint_addresses = np.array(addresses)
        self._palm = self.model.body("palm").id
        self._tips = np.array([self.model.site(f"{f}_tip").id for f in self.hand.prefixes])

    def _set_encoders(self) -> None:
        """Turn the links of the hand away from what their encoders say.

        Positions and commands stay what the encoders say: MuJoCo turns a link by `qpos - qpos0`.
        """
        hand = self._joint_addresses[-self.hand.n_joints :]
        self.model.qpos0[hand] = self.memory.get("encoder_errors", 0.0)

    def observe(self) -> dict[str, Any]:
        """Return the observation of the state now; call once per control step, since touch has a memory."""
        data = self.data
        palm = data.xmat[self._palm].reshape(3, 3)
        joints = data.qpos[self._joint_addresses]
        if self._disturbance.calibration:  # A hand knows its fingertips from its encoders.
            tips = fingertips(self.hand, torch.from_numpy(joints[-self.hand.n_joints :])).numpy()
        else:
            tips = (data.site_xpos[self._tips] - data.xpos[self._palm]) @ palm
        gravity = self.model.opt.gravity / np.linalg.norm(self.model.opt.gravity)
        observation: dict[str, Any] = {}
        if self._cameras:
            if self.seeing:
                self._pixels = {name: view.render(data) for name, view in self._views.items()}
            observation["pixels"] = dict(self._pixels)
        return observation | {
            "agent_pos": joints.astype(np.float32),
            "tactile": self._touch.read(data, self.np_random).astype(np.float32).reshape(-1),
            "fingertips": tips.astype(np.float32).reshape(-1),
            "gravity": (palm.T @ gravity).astype(np.float32),
        }
