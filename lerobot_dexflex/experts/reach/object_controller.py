"""Move an object inside the hand: tips follow a slow reference pose, forces keep it held, fingers gait.

The tips of a grasp are anchored in the object's frame. A reference pose walks slowly to the goal and never
far ahead of the true pose; every tip's target is its anchor under the reference, plus the joint displacement
with which the position servos exert balanced contact forces.
"""

import copy
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.balance import balance_forces
from lerobot_dexflex.experts.reach.sensing import HandState, Senses
from lerobot_dexflex.hand import kernels, leap
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.grasp_candidates import GRAVITY
from lerobot_dexflex.hand.poses import quaternion_matrix, quaternion_of, quaternion_product, rotation_between

Array = NDArray[np.float64]

LIFT_STEPS, LIFT_HEIGHT = 8, 0.018
"""A gaiting finger lifts off so far [m] in so many control steps."""
SWING_SPEED, SWING_STEPS, APPROACH = 0.006, 30, 0.012
"""Speed of a swing to above the new place [m] per step, its longest duration, and its end above it [m]."""
PLACE_SPEED, PRESS, PLACE_STEPS = 0.003, 0.004, 14
"""Speed of the placing [m] per step, how deep it may push [m] and how long it may take."""
LEAD = (0.010, 0.25)
"""How far the reference may be ahead of the object [m], [rad]."""
_LOWER, _UPPER = kernels.LOWER.ravel(), kernels.UPPER.ravel()
_REANCHOR, _REALIGN = 0.15, 0.3
_INTEGRAL_GAIN, _INTEGRAL_LIMIT = 0.05, np.array([0.004] * 3 + [0.1] * 3)
_FORCE_SMOOTHING = 0.4
_FRICTION_SHARE, _PRELOAD, _PRELOAD_GAIN = 0.6, 1.8, 1.5
_MAX_TORQUE = 0.45
_PUSH_STEP, _FORCE_GAIN, _PUSH_LIMITS = 0.0015, 0.0001, (-0.004, 0.012)


class Mode(IntEnum):
    """What a finger is doing."""

    PARKED = -1
    HOLD = 0
    LIFT = 1
    SWING = 2
    PLACE = 3


@dataclass
class FingerStates:
    """Everything the controller remembers; deep copies are snapshots."""

    mode: NDArray[np.int64]
    """`Mode` of each finger. Shape (4,)."""
    anchor: Array
    """Tips in the object's frame [m]. Shape (4, 3)."""
    inward: Array
    """Contact normals into the object, in its frame. Shape (4, 3)."""
    joints: Array
    """Posture behind the tip targets [rad]. Shape (16,)."""
    park: Array
    """Where parked tips stay [m]. Shape (4, 3)."""
    timer: NDArray[np.int64] = field(default_factory=lambda: np.zeros(4, np.int64))
    """Steps in the current mode; for a holding finger, steps without load."""
    next_anchor: Array = field(default_factory=lambda: np.zeros((4, 3)))
    next_inward: Array = field(default_factory=lambda: np.zeros((4, 3)))
    push: Array = field(default_factory=lambda: np.zeros(4))
    """How far anchors are pushed inward, to servo the force and to find lost contact [m]. Shape (4,)."""
    free: Array = field(default_factory=lambda: np.zeros((4, 3)))
    """Where swinging tips have got to, in the object's frame [m]. Shape (4, 3)."""
    forces: Array = field(default_factory=lambda: np.zeros((4, 3)))
    integral: Array = field(default_factory=lambda: np.zeros(6))
    reference: tuple[Array, Array] | None = None
    """Reference pose; None begins at the object's."""


class ObjectController:
    """Track goals for the object in one running `ReachEnv`, from a grasp that already holds.

    Args:
        senses: The environment's true state.
        speed: How fast the reference walks [m] and [rad] per control step.
        preload: Internal squeeze per finger [N].
    """

    def __init__(
        self, senses: Senses, speed: tuple[float, float] = (0.002, 0.05), preload: float = _PRELOAD
    ) -> None:
        self.senses, self.speed, self.preload = senses, speed, preload
        now = senses.read()
        touching = now.loads > CONTACT_FORCE
        self.fingers = FingerStates(
            mode=np.where(touching, int(Mode.HOLD), int(Mode.PARKED)),
            anchor=(now.tips - now.position) @ now.rotation,
            inward=now.inward @ now.rotation,
            joints=now.joints,
            park=now.tips.copy(),
        )
        self.goal = (now.position, now.quaternion)

    def set_goal(self, position: Array, quaternion: Array) -> None:
        """Aim at an object pose in the palm frame: position [m] (3,), orientation (w x y z)."""
        self.goal = (np.asarray(position, float), np.asarray(quaternion, float))
        self.fingers.reference = None

    @property
    def gaiting(self) -> bool:
        """Whether a finger is off to a new place."""
        return bool((self.fingers.mode > 0).any())

    def snapshot(self) -> tuple[FingerStates, tuple[Array, Array]]:
        """Return everything that decides what comes next, apart from the environment."""
        return copy.deepcopy(self.fingers), self.goal

    def restore(self, snapshot: tuple[FingerStates, tuple[Array, Array]]) -> None:
        """Return to a snapshot."""
        self.fingers, self.goal = copy.deepcopy(snapshot[0]), snapshot[1]

    def regrasp(self, finger: int, anchor: Array, inward: Array) -> None:
        """Send a finger to a new anchor [m] (3,) with contact normal `inward` (3,), in the object's frame."""
        fingers, now = self.fingers, self.senses.read()
        lifted = now.loads[finger] <= CONTACT_FORCE
        fingers.mode[finger] = Mode.SWING if lifted else Mode.LIFT
        fingers.timer[finger], fingers.push[finger] = 0, 0.0
        fingers.free[finger] = (now.tips[finger] - now.position) @ now.rotation
        fingers.next_anchor[finger], fingers.next_inward[finger] = anchor, inward

    def joint_targets(self, now: HandState) -> Array:
        """Return joint targets [rad] (16,) for the state now; call once per control step."""
        fingers = self.fingers
        self._update_contacts(now)
        offset, turn = self._advance_reference(now)
        position = now.position + offset
        rotation = quaternion_matrix(quaternion_of(turn)) @ now.rotation
        targets = self._tip_targets(now, position, rotation)
        fingers.joints = kernels.solve_fingertips(targets, fingers.joints)
        torques = kernels.contact_torques(fingers.joints, now.points, self._forces(now))
        return np.clip(fingers.joints + np.clip(torques, -_MAX_TORQUE, _MAX_TORQUE) / leap.KP, _LOWER, _UPPER)

    def _update_contacts(self, now: HandState) -> None:
        """Follow rolling contacts, adopt parked fingers that touch, push lost ones inward."""
        fingers = self.fingers
        tips, inward = (now.tips - now.position) @ now.rotation, now.inward @ now.rotation
        for k in range(4):
            load = now.loads[k]
            if fingers.mode[k] == Mode.PARKED and load > 2 * CONTACT_FORCE:
                self._hold(k, tips[k], inward[k])
            if fingers.mode[k] != Mode.HOLD:
                continue
            fingers.timer[k] = 0 if load > CONTACT_FORCE else fingers.timer[k] + 1
            missing = float(np.linalg.norm(fingers.forces[k])) - load
            push = _PUSH_STEP if fingers.timer[k] >= 2 else _FORCE_GAIN * missing
            fingers.push[k] = np.clip(fingers.push[k] + push, *_PUSH_LIMITS)
            if load > 2 * CONTACT_FORCE:
                fingers.anchor[k] += _REANCHOR * (tips[k] - fingers.anchor[k])
                normal = fingers.inward[k] + _REALIGN * (inward[k] - fingers.inward[k])
                fingers.inward[k] = normal / max(float(np.linalg.norm(normal)), 1e-9)

    def _hold(self, finger: int, anchor: Array, inward: Array) -> None:
        fingers = self.fingers
        fingers.mode[finger], fingers.timer[finger], fingers.push[finger] = Mode.HOLD, 0, 0.0
        fingers.anchor[finger], fingers.inward[finger] = anchor, inward

    def _pace(self, now: HandState) -> float:
        """Return the share of the reference's speed that the contacts allow."""
        fingers = self.fingers
        loaded = now.loads > CONTACT_FORCE
        if loaded.sum() < 2:
            return 0.0
        lost = (fingers.mode == Mode.HOLD) & (fingers.timer >= 2)
        return 0.25 if self.gaiting or lost.any() or loaded.sum() < 3 else 1.0

    def _advance_reference(self, now: HandState) -> tuple[Array, Array]:
        """Walk the reference to the goal; return its offset [m] and turn [rad] from the true pose."""
        fingers, (goal, goal_quaternion) = self.fingers, self.goal
        position, quaternion = fingers.reference or (now.position, now.quaternion)
        pace = self._pace(now)
        way, turn = goal - position, rotation_between(quaternion, goal_quaternion)
        position = position + _shorten(way, pace * self.speed[0])
        quaternion = quaternion_product(quaternion_of(_shorten(turn, pace * self.speed[1])), quaternion)
        offset = _shorten(position - now.position, LEAD[0])
        turned = _shorten(rotation_between(now.quaternion, quaternion), LEAD[1])
        fingers.reference = (
            now.position + offset,
            quaternion_product(quaternion_of(turned), now.quaternion),
        )
        error = np.concatenate([offset, turned])
        fingers.integral = np.clip(
            0.98 * fingers.integral + _INTEGRAL_GAIN * error, -_INTEGRAL_LIMIT, _INTEGRAL_LIMIT
        )
        return offset + fingers.integral[:3], turned + fingers.integral[3:]

    def _tip_targets(self, now: HandState, position: Array, rotation: Array) -> Array:
        fingers = self.fingers
        targets = np.empty((4, 3))
        for k in range(4):
            mode, anchor, inward = fingers.mode[k], fingers.anchor[k], fingers.inward[k]
            if mode == Mode.HOLD:
                targets[k] = position + rotation @ (anchor + fingers.push[k] * inward)
                continue
            if mode == Mode.PARKED:
                targets[k] = fingers.park[k]
                continue
            fingers.timer[k] += 1
            timer = fingers.timer[k]
            if mode == Mode.LIFT:
                local = anchor - LIFT_HEIGHT * min(1.0, timer / LIFT_STEPS) * inward
                done = timer >= LIFT_STEPS
            elif mode == Mode.SWING:
                way = fingers.next_anchor[k] - APPROACH * fingers.next_inward[k] - fingers.free[k]
                local = fingers.free[k] + _shorten(way, SWING_SPEED)
                done = timer >= SWING_STEPS or np.linalg.norm(way) <= SWING_SPEED
            else:
                depth = min(PRESS, -APPROACH + PLACE_SPEED * timer)
                local = fingers.next_anchor[k] + depth * fingers.next_inward[k]
                done = False
                if now.loads[k] > 3 * CONTACT_FORCE:
                    self._hold(k, (now.tips[k] - now.position) @ now.rotation, fingers.next_inward[k].copy())
                elif timer > PLACE_STEPS:
                    fingers.mode[k] = Mode.PARKED
                    fingers.park[k] = now.tips[k] - 0.015 * now.rotation @ fingers.next_inward[k]
            fingers.free[k] = local
            if done:
                fingers.mode[k], fingers.timer[k] = mode + 1, 0
            targets[k] = now.position + now.rotation @ local
        return targets

    def _forces(self, now: HandState) -> Array:
        """Return the smoothed forces [N] (4, 3) that the holding fingers should exert."""
        fingers = self.fingers
        wanted = np.zeros((4, 3))
        holding = np.flatnonzero(fingers.mode == Mode.HOLD)
        if len(holding):
            inward = fingers.inward[holding] @ now.rotation.T
            gravity = self.senses.gravity
            wrench = np.concatenate([-self.senses.mass * gravity, np.zeros(3)])
            preload = max(self.preload, _PRELOAD_GAIN * self.senses.mass * GRAVITY)
            wanted[holding], _ = balance_forces(
                now.points[holding],
                inward,
                now.position,
                wrench,
                _FRICTION_SHARE * self.senses.friction,
                preload,
            )
        fingers.forces = fingers.forces + _FORCE_SMOOTHING * (wanted - fingers.forces)
        return fingers.forces


def _shorten(vector: Array, limit: float) -> Array:
    """Return the vector, or one of length `limit` in its direction if it is longer."""
    length = float(np.linalg.norm(vector))
    return vector if length <= limit else vector * (limit / length)
