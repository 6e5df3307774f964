"""The closed-loop operator of the degraded-command benchmark: an ideal user who sees everything.

It says where the commanded fingertips should go next, at whatever state the hand was brought to: the motion
of its object controller's own target, plus a slow correction of the lag (design section 9)::

    u*_t = (x*_t - x*_{t-1}) + 0.2 (x*_{t-1} - c_t)
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.object_controller import Mode, ObjectController
from lerobot_dexflex.experts.reach.regrasp import regrasp_points
from lerobot_dexflex.experts.reach.sensing import HandState, Senses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.surfaces import surface_samples

Array = NDArray[np.float64]

CORRECTION = 0.2
"""Share of the lag between target and executed command that is made up per step. A gain of 1 is an unstable
loop under delay."""
_MAX_STEP = 0.006
"""Fastest motion of a target [m] per step."""
_PATIENCE, _COOL_DOWN = 10, 15
_SURFACE_POINTS = 300


class OperatorState(NamedTuple):
    """Everything that decides what an operator does next, apart from the environment."""

    controller: Any
    target: Array | None
    cool_down: int
    rng: Mapping[str, Any]


class Operator:
    """Command the fingertips so that the object goes to the goal; privileged.

    Args:
        senses: True state of a running `ReachEnv` whose object is held.
        rng: Source of randomness, for regrasps only.
    """

    def __init__(self, senses: Senses, rng: np.random.Generator) -> None:
        self.senses, self._rng = senses, rng
        self.controller = ObjectController(senses)
        spec = senses.env.episode.object_spec
        self.surface = surface_samples(spec, _SURFACE_POINTS, np.random.default_rng(0))
        self._target: Array | None = None
        self._cool_down = 0

    def reseed(self, seed: int | tuple[int, ...]) -> None:
        """Let the choices from here on depend on `seed` alone."""
        self._rng = np.random.default_rng(seed)

    def set_goal(self, position: Array, quaternion: Array) -> None:
        """Aim at an object pose in the palm frame: position [m] (3,), orientation (w x y z)."""
        self.controller.set_goal(position, quaternion)

    def displacement(self, command: Array, now: HandState | None = None) -> Array:
        """Return the clean command u* [m] (4, 3); call exactly once per control step.

        Args:
            command: Commanded fingertips before the step [m]. Shape (4, 3).
            now: The state, if it has been read already.
        """
        now = now or self.senses.read()
        target = kernels.fingertips(self.controller.joint_targets(now))
        previous = command if self._target is None else self._target
        step = target - previous
        length = np.linalg.norm(step, axis=1, keepdims=True)
        target = previous + step * np.minimum(1.0, _MAX_STEP / np.maximum(length, 1e-9))
        self._target = target
        self._replace_lost_finger(now)
        return target - previous + CORRECTION * (previous - command)

    def try_gait(self) -> bool:
        """Send a finger to a better place, the idle one if there is one; say whether one goes.

        The other three must be able to hold the object.
        """
        now, controller = self.senses.read(), self.controller
        loaded = now.loads > 2 * CONTACT_FORCE
        if controller.gaiting or loaded.sum() < 3:
            return False
        for finger in self._rng.permutation(4) if loaded.all() else np.flatnonzero(~loaded):
            found = regrasp_points(controller, now, int(finger), self.surface, self._rng, firm=True)
            if found:
                controller.regrasp(int(finger), *found[0])
                return True
        return False

    def state(self) -> OperatorState:
        """Return a snapshot."""
        return OperatorState(
            self.controller.snapshot(), self._target, self._cool_down, self._rng.bit_generator.state
        )

    def set_state(self, state: OperatorState) -> None:
        """Return to a snapshot."""
        self.controller.restore(state.controller)
        self._target, self._cool_down = state.target, state.cool_down
        self._rng.bit_generator.state = state.rng

    def _replace_lost_finger(self, now: HandState) -> None:
        """Find a new place for a finger that has been off the object for long."""
        self._cool_down = max(0, self._cool_down - 1)
        controller = self.controller
        fingers = controller.fingers
        if self._cool_down or controller.gaiting or (now.loads > CONTACT_FORCE).sum() != 2:
            return
        lost = (fingers.mode == Mode.PARKED) | ((fingers.mode == Mode.HOLD) & (fingers.timer > _PATIENCE))
        if lost.any():
            finger = int(self._rng.choice(np.flatnonzero(lost)))
            found = regrasp_points(controller, now, finger, self.surface, self._rng)
            if found:
                controller.regrasp(finger, *found[0])
            self._cool_down = _COOL_DOWN
