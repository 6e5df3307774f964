"""The closed-loop operator: an ideal user who sees everything and says where the fingertips should be.

At whatever state the hand was brought to, it turns the pose error of the object into a small rigid motion of
the touching fingertips, and a force balance into the forces that keep the object held. Who commands only
motion (a glove, a policy) passes on the first; the second is what a controller has to supply. Both are
functions of the state now, apart from the paths of lifted fingers and a little smoothing: nothing is hidden
that a learner could not see. Executing both is the benchmark's upper bound.
"""

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.experts.reach.balance import balance_forces
from lerobot_dexflex.experts.reach.fingers import FingerStates, Mode
from lerobot_dexflex.experts.reach.paths import destination, follow_paths, next_on_path, shortened
from lerobot_dexflex.experts.reach.regrasp import regrasp_points
from lerobot_dexflex.experts.reach.sensing import HandState, ObjectSenses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE, gripping_joints
from lerobot_dexflex.hand.grasp_candidates import GRAVITY
from lerobot_dexflex.hand.poses import quaternion_matrix, quaternion_of, quaternion_product, rotation_between

Array = NDArray[np.float64]

SPEED = (0.002, 0.05)
"""How fast the reference that leads the object walks to the goal [m], [rad] per control step."""
LEAD = (0.004, 0.1)
"""How far it may be ahead of the object [m], [rad]: what does not follow is asked for more."""
PRELOAD = 3.0
"""Internal squeeze per finger that is wished for [N], at least `_PRELOAD_GAIN` times the weight."""
LEAST_FORCE = 0.8
"""Smallest normal force of a finger that holds [N]."""
FRICTION_SHARE = 0.9
"""Share of the friction that the force balance uses."""
_EAGERNESS = 0.15
"""Share of the way to the goal that the reference walks per step where that is slower."""
_PULL, _LARGEST_PULL = (100.0, 0.25), (2.0, 0.05)
"""Wrench toward the goal: [N/m], [N m/rad], and at most [N], [N m]; it overcomes friction at rest."""
_PRELOAD_GAIN = 1.5
_REALIGN, _FORCE_SMOOTHING = 0.3, 0.3
_LOST_AFTER = 3
"""A finger without load for so many steps no longer carries."""
_POSTURE_WEIGHT, _HOME = 0.01, 0.1
"""Tie to the measured posture [m/rad], and the share of the way back to the first grasp's per step."""
_PATIENCE, _COOL_DOWN = 10, 15
_STALLED, _NEARER, _NEAR = 12, 0.05, (0.010, 0.25)
"""The object is stalled if it comes no nearer for so many steps; by so much, distance [m] and angle [rad]
counted in tolerances and added."""
_SURFACE_POINTS = 300


class Guidance(NamedTuple):
    """What the operator says in a control step; palm frame."""

    tips: Array
    """Where the fingertips should be after 1, 2, ... 8 control steps [m]. Shape (8, fingers, 3)."""
    forces: Array
    """Forces of the fingers on the object [N], with the margin that it takes for right. (fingers, 3)."""
    grip: Array
    """The forces that `joints` exert: as strong as this operator grips. Shape (fingers, 3)."""
    points: Array
    """Where they act [m]. Shape (fingers, 3)."""
    joints: Array
    """Joint targets that do both [rad]. Shape (joints,)."""


class OperatorState(NamedTuple):
    """Everything that decides what an operator does next, apart from the environment."""

    fingers: FingerStates
    goal: tuple[Array, Array]
    cool_down: int
    stalled: tuple[int, float]
    rng: Mapping[str, Any]


class Operator:
    """Lead the object to goals by the fingertips; privileged.

    Args:
        senses: True state of a running task whose object is held, or about to be (`expect`).
        rng: Source of randomness, for regrasps only.
        strength: Factor of the internal squeeze that it executes.
    """

    def __init__(self, senses: ObjectSenses, rng: np.random.Generator, strength: float = 1.0) -> None:
        self.senses, self.hand, self._rng = senses, senses.hand, rng
        self.speed, self.ahead, self.preload, self.strength = SPEED, LEAD, PRELOAD, strength
        self.friction_share = FRICTION_SHARE
        self.load: Array = np.zeros(6)
        """Expected force [N] and torque [N m] of the world on the object, palm frame. Shape (6,)."""
        self.surface = senses.surface(_SURFACE_POINTS)
        now = senses.read()
        self.fingers = FingerStates(
            mode=np.where(now.loads > CONTACT_FORCE, int(Mode.HOLD), int(Mode.PARKED)),
            anchor=(now.tips - now.position) @ now.rotation,
            inward=now.inward @ now.rotation,
            joints=now.joints,
            park=now.tips.copy(),
        )
        self.goal = (now.position, now.quaternion)
        self._cool_down = 0
        self._stalled, self._least = 0, np.inf

    def reseed(self, seed: int | tuple[int, ...]) -> None:
        """Let the choices from here on depend on `seed` alone."""
        self._rng = np.random.default_rng(seed)

    def set_goal(self, position: Array, quaternion: Array) -> None:
        """Aim at an object pose in the palm frame: position [m] (3,), orientation (w x y z)."""
        self.goal = (np.asarray(position, float), np.asarray(quaternion, float))
        self.fingers.reference = None
        self._stalled, self._least = 0, np.inf

    @property
    def gaiting(self) -> bool:
        """Whether a finger is off to a new place."""
        return bool((self.fingers.mode > 0).any())

    def state(self) -> OperatorState:
        """Return a snapshot."""
        return OperatorState(
            copy.deepcopy(self.fingers),
            self.goal,
            self._cool_down,
            (self._stalled, self._least),
            self._rng.bit_generator.state,
        )

    def set_state(self, state: OperatorState) -> None:
        """Return to a snapshot."""
        self.fingers, self.goal = copy.deepcopy(state.fingers), state.goal
        self._cool_down = state.cool_down
        self._stalled, self._least = state.stalled
        self._rng.bit_generator.state = state.rng

    def guide(self, now: HandState | None = None) -> Guidance:
        """Return what to do in this control step; call exactly once per step.

        Args:
            now: The state, if it has been read already.
        """
        now = now or self.senses.read()
        self._update_contacts(now)
        self._replace_lost_finger(now)
        self._gait_if_stalled(now)
        self._advance_reference(now)
        carrying = self._carrying()
        points = np.where(carrying[:, None], now.points, now.tips)
        forces, grip = self._forces(now, points, carrying)
        joints, motion = self._first_step(now, points, carrying)
        tips = self._ahead(now, points, carrying, motion)
        joints = gripping_joints(self.hand, joints, now.joints, points, grip)
        return Guidance(tips, forces, grip, points, joints)

    def expect(self, inward: Array, now: HandState) -> None:
        """Take idle fingers for holding where they will touch, along contact normals in the palm frame.

        Args:
            inward: Unit normals into the object; zero for fingers that stay idle. Shape (fingers, 3).
            now: The state.
        """
        fingers = self.fingers
        idle = (fingers.mode == Mode.PARKED) & (np.abs(inward).max(1) > 0)
        fingers.mode[idle], fingers.timer[idle] = Mode.HOLD, _LOST_AFTER
        fingers.inward[idle] = inward[idle] @ now.rotation

    def regrasp(self, finger: int, anchor: Array, inward: Array, now: HandState) -> None:
        """Send a finger to a new anchor [m] (3,) with contact normal `inward` (3,), in the object's frame."""
        fingers = self.fingers
        lifted = now.loads[finger] <= CONTACT_FORCE
        fingers.mode[finger] = Mode.SWING if lifted else Mode.LIFT
        fingers.timer[finger] = 0
        fingers.free[finger] = (now.tips[finger] - now.position) @ now.rotation
        fingers.next_anchor[finger], fingers.next_inward[finger] = anchor, inward

    def try_gait(self) -> bool:
        """Send a finger to a better place, the idle one if there is one; say whether one goes.

        The others must be able to hold the object.
        """
        now = self.senses.read()
        loaded = now.loads > 2 * CONTACT_FORCE
        if self.gaiting or loaded.sum() < 3:
            return False
        for finger in self._rng.permutation(len(loaded)) if loaded.all() else np.flatnonzero(~loaded):
            found = regrasp_points(self, now, int(finger), self.surface, self._rng, firm=True)
            if found:
                self.regrasp(int(finger), *found[0], now)
                return True
        return False

    def _replace_lost_finger(self, now: HandState) -> None:
        """Find a new place for a finger that has been off the object for long."""
        self._cool_down = max(0, self._cool_down - 1)
        fingers = self.fingers
        if self._cool_down or self.gaiting or (now.loads > CONTACT_FORCE).sum() != 2:
            return
        lost = (fingers.mode == Mode.PARKED) | ((fingers.mode == Mode.HOLD) & (fingers.timer > _PATIENCE))
        if lost.any():
            finger = int(self._rng.choice(np.flatnonzero(lost)))
            found = regrasp_points(self, now, finger, self.surface, self._rng)
            if found:
                self.regrasp(finger, *found[0], now)
            self._cool_down = _COOL_DOWN

    def _gait_if_stalled(self, now: HandState) -> None:
        """Send a finger to a better place where the object has not come nearer to the goal for long."""
        way, turn = self._way(now)
        error = float(np.linalg.norm(way) / _NEAR[0] + np.linalg.norm(turn) / _NEAR[1])
        nearer = error < self._least - _NEARER
        self._least = min(self._least, error) if nearer else self._least
        self._stalled = 0 if nearer else self._stalled + 1
        if self._stalled > _STALLED and error > 1.0:
            self._stalled = 0
            self.try_gait()

    def _update_contacts(self, now: HandState) -> None:
        """Follow rolling contacts; adopt parked and placed fingers that touch."""
        fingers = self.fingers
        tips, inward = (now.tips - now.position) @ now.rotation, now.inward @ now.rotation
        for k in range(self.hand.n_fingers):
            load = now.loads[k]
            found = fingers.mode[k] == Mode.PARKED and load > 2 * CONTACT_FORCE
            placed = fingers.mode[k] == Mode.PLACE and load > 3 * CONTACT_FORCE
            if found or placed:
                fingers.mode[k], fingers.timer[k] = Mode.HOLD, 0
                fingers.inward[k] = fingers.next_inward[k] if placed else inward[k]
            if fingers.mode[k] != Mode.HOLD:
                continue
            if load > CONTACT_FORCE:
                fingers.timer[k] = 0
                fingers.anchor[k] = tips[k]
                normal = fingers.inward[k] + _REALIGN * (inward[k] - fingers.inward[k])
                fingers.inward[k] = normal / max(float(np.linalg.norm(normal)), 1e-9)
            else:
                fingers.timer[k] += 1

    def _carrying(self) -> NDArray[np.bool_]:
        """Return which fingers take part in the force balance. Shape (fingers,)."""
        return (self.fingers.mode == Mode.HOLD) & (self.fingers.timer < _LOST_AFTER)

    def _way(self, now: HandState) -> tuple[Array, Array]:
        """Return the pose error to the goal [m], [rad] as vectors."""
        return self.goal[0] - now.position, rotation_between(now.quaternion, self.goal[1])

    def _advance_reference(self, now: HandState) -> None:
        """Walk the reference to the goal, never far ahead of the object."""
        position, quaternion = self.fingers.reference or (now.position, now.quaternion)
        pace = self._pace(now)
        position = position + shortened(_EAGERNESS * (self.goal[0] - position), pace * self.speed[0])
        turn = shortened(_EAGERNESS * rotation_between(quaternion, self.goal[1]), pace * self.speed[1])
        quaternion = quaternion_product(quaternion_of(turn), quaternion)
        offset = shortened(position - now.position, self.ahead[0])
        turned = shortened(rotation_between(now.quaternion, quaternion), self.ahead[1])
        self.fingers.reference = (
            now.position + offset,
            quaternion_product(quaternion_of(turned), now.quaternion),
        )

    def _ahead_of(self, now: HandState) -> tuple[Array, Array]:
        """Return how far the reference is ahead of the object [m], [rad], as vectors."""
        assert self.fingers.reference is not None
        position, quaternion = self.fingers.reference
        return position - now.position, rotation_between(now.quaternion, quaternion)

    def _pace(self, now: HandState) -> float:
        """Return 0 while fewer than two fingers hold the object: it is not to be pushed away; else 1."""
        return float((now.loads > CONTACT_FORCE).sum() >= 2)

    def _forces(self, now: HandState, points: Array, carrying: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the smoothed forces [N] (fingers, 3) that fingers should exert, and those it lets them."""
        fingers, senses = self.fingers, self.senses
        wanted = np.zeros((2, *points.shape))
        holding = np.flatnonzero(carrying)
        if len(holding):
            way, turn = self._way(now)
            pull = shortened(_PULL[0] * way, _LARGEST_PULL[0])
            twist = shortened(_PULL[1] * turn, _LARGEST_PULL[1])
            weight = senses.mass * senses.gravity
            lever = np.cross(now.centre - now.position, weight)
            wrench = np.concatenate([pull - weight, twist - lever]) - self.load
            preload = max(self.preload, _PRELOAD_GAIN * senses.mass * GRAVITY)
            inward = fingers.inward[holding] @ now.rotation.T
            friction = self.friction_share * senses.friction
            for k, strength in enumerate((1.0, self.strength)):
                wanted[k, holding], _ = balance_forces(
                    points[holding],
                    inward,
                    now.position,
                    wrench,
                    friction,
                    strength * preload,
                    strength * LEAST_FORCE,
                )
        seeking = (fingers.mode == Mode.HOLD) & ~carrying  # They press on, to feel the object again.
        wanted[:, seeking] = LEAST_FORCE * (fingers.inward @ now.rotation.T)[seeking]
        before = wanted if fingers.forces is None else fingers.forces
        fingers.forces = before + _FORCE_SMOOTHING * (wanted - before)
        fingers.forces[:, fingers.mode > 0] = 0.0
        right, executed = fingers.forces
        return right.copy(), executed.copy()

    def _first_step(self, now: HandState, points: Array, carrying: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the joints after this step [rad] (joints,) and how tips move to there [m] (fingers, 3)."""
        fingers = self.fingers
        moved, turned = self._ahead_of(now)
        follow_paths(fingers, now)
        asked = np.zeros(points.shape)
        for k in range(self.hand.n_fingers):
            if carrying[k]:
                asked[k] = moved + np.cross(turned, points[k] - now.position)
            else:
                place, speed = destination(fingers, now, k)
                asked[k] = shortened(place - now.tips[k], speed)
        joints = self._solve(now.joints, points, asked, carrying)
        return joints, kernels.fingertips(self.hand.tables, joints) - now.tips

    def _solve(self, joints: Array, points: Array, asked: Array, carrying: NDArray[np.bool_]) -> Array:
        """Return joints [rad] (joints,) that move contact points, or free fingers' tips, as asked [m]."""
        origins, axes, _ = kernels.frames(self.hand.tables, joints)
        solved = joints.copy()
        weight = _POSTURE_WEIGHT**2
        for k, part in enumerate(self.hand.finger_joints):
            n = part.stop - part.start
            jacobian = np.cross(axes[k, :n], points[k] - origins[k, :n])  # (joints of the finger, 3)
            pull = _HOME * weight * (self.fingers.joints[part] - joints[part]) if carrying[k] else 0.0
            step = np.linalg.solve(jacobian @ jacobian.T + weight * np.eye(n), jacobian @ asked[k] + pull)
            solved[part] += step
        return np.clip(solved, self.hand.joint_lower, self.hand.joint_upper)

    def _ahead(
        self,
        now: HandState,
        points: Array,
        carrying: NDArray[np.bool_],
        motion: Array,
    ) -> Array:
        """Return where tips should be over the next steps [m], (8, fingers, 3), if all goes as planned."""
        fingers, pace, n = self.fingers, self._pace(now), self.hand.n_fingers
        tips = np.empty((DRAFT_HORIZON, n, 3))
        paths = {k: (fingers.free[k], int(fingers.mode[k]), int(fingers.timer[k])) for k in range(n)}
        offset, turned = self._ahead_of(now)
        way, turn = self._way(now)
        first = np.zeros((n, 3))
        for step in range(DRAFT_HORIZON):
            if step:
                offset = offset + shortened(way - offset, pace * self.speed[0])
                turned = turned + shortened(turn - turned, pace * self.speed[1])
            rotation = quaternion_matrix(quaternion_of(turned))
            carried = (points - now.position) @ rotation.T + now.position + offset - points
            if step == 0:
                first = carried
            position, whole = now.position + offset, rotation @ now.rotation
            for k in range(n):
                if carrying[k]:  # The tip goes with its contact; its first step is known exactly.
                    tips[step, k] = now.tips[k] + motion[k] + carried[k] - first[k]
                elif fingers.mode[k] > 0:
                    if step:
                        free, mode, timer = paths[k]
                        paths[k] = next_on_path(fingers, k, free, mode, timer + 1)
                    tips[step, k] = position + whole @ paths[k][0]
                else:
                    place, speed = destination(fingers, now, k)
                    tips[step, k] = now.tips[k] + shortened(place - now.tips[k], (step + 1) * speed)
        tips[0] = now.tips + motion
        return tips
