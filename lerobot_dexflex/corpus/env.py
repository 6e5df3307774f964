"""Reach under the circumstances of an episode of the corpus, begun or resumed from stored values."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.corpus.world import World, WorldPhysics, add_hinge
from lerobot_dexflex.envs.hand_env import Snapshot
from lerobot_dexflex.envs.reach import ReachEnv, ReachEpisode
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.model import SUBSTEPS, TIMESTEP
from lerobot_dexflex.hand.touch import TouchConfig
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

_CONTROL_PERIOD = TIMESTEP * SUBSTEPS


class CorpusEnv(ReachEnv):
    """`ReachEnv` without images whose servos, sensors and disturbances are those of a `World`.

    Args:
        hand: The hand.
        touch: Sensor effects.
    """

    def __init__(self, hand: Hand, touch: TouchConfig | None = None) -> None:
        super().__init__(render_mode=None, cameras=(), touch=touch, hand=hand)
        self.world = World()

    def draw(self, seed: int) -> ReachEpisode:
        """Return the object and the grasp that `reset(seed=seed)` draws."""
        return self._sample_episode(np.random.default_rng(seed))

    @property
    def clock(self) -> int:
        """Control steps since the episode's start."""
        return self.memory.get("clock", 0)

    @property
    def supported(self) -> bool:
        """Whether something else than the hand carries the object now."""
        return self.world.hinge is not None or self._world_physics.support_at(self.clock) is not None

    def start(self, episode: ReachEpisode, world: World) -> dict[str, Any]:
        """Start an episode; returns the first observation."""
        self.world, self._gravity_rate = world, world.gravity_rate
        return self.begin(episode, world.seed)

    def rewind(self, clock: int, physics: Array, command: Array) -> dict[str, Any]:
        """Go to a kept state of the running episode, bit for bit; returns its observation with new noise.

        Args:
            clock: Control steps from the episode's start to the kept state.
            physics: MuJoCo's integration state.
            command: Joint command before the step [rad]. Shape (joints,).

        Raises:
            DexFlexError: If the state is not one of this model.
        """
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION)
        if physics.shape != (size,):
            raise DexFlexError(
                f"The kept simulator state must have shape ({size},). Got {physics.shape}: it was made by "
                "another version of the hand or of MuJoCo; generate the corpus again."
            )
        memory = {key: value for key, value in self.memory.items() if key != "turned"} | {"clock": clock}
        rate = self.world.gravity_rate
        for _ in range(clock if rate else 0):  # Added up as in `advance`, for the same last bits.
            memory["turned"] = memory.get("turned", 0.0) + rate * _CONTROL_PERIOD
        self.restore(self.snapshot()._replace(physics=physics, command=command, memory=memory))
        return self.observe()

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of this episode, bit for bit."""
        self._world_physics.apply(self.data, max(snapshot.memory.get("clock", 0) - 1, 0))
        super().restore(snapshot)

    def advance(self, action: NDArray) -> None:
        """Execute joint targets [rad] for one control step under the world's disturbances."""
        self._world_physics.apply(self.data, self.clock)
        super().advance(action)
        self.memory["clock"] = self.clock + 1

    def _load(self, episode: ReachEpisode) -> None:
        super()._load(episode)
        self._world_physics = WorldPhysics(self.hand, self.model, self.world)

    def _build(self, episode: ReachEpisode) -> mujoco.MjSpec:
        spec = super()._build(episode)
        add_hinge(spec)
        return spec

    def _initialise(self, episode: ReachEpisode) -> None:
        super()._initialise(episode)
        self._world_physics.apply(self.data, 0)

    def observe(self) -> dict[str, Any]:
        """Return the observation of the state now, with the world's noise on the joints."""
        observation = super().observe()
        if self.world.joint_noise:
            noise = self.world.joint_noise * self.np_random.standard_normal(self.hand.n_joints)
            joints = observation["agent_pos"] + noise
            observation["agent_pos"] = joints.astype(np.float32)
            tips = kernels.fingertips(self.hand.tables, joints)
            observation["fingertips"] = tips.astype(np.float32).reshape(-1)
        return observation
