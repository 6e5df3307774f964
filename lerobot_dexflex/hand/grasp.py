"""Sample stable precision grasps of an object in the free-standing hand, proven in the simulator.

The palm frame is the world frame and the direction of gravity is free. A candidate is found by geometry
(pads on surface points, opposition, spacing, force closure); it counts once the hand has closed on the
object, carried it, and kept it while gravity was tilted and increased: with a constant joint command.
"""

from typing import NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.contacts import fingertip_contacts, solve_pads
from lerobot_dexflex.hand.grasp_candidates import GRAVITY, Candidate, balance_weight, grasp_candidates
from lerobot_dexflex.hand.kernels import contact_torques
from lerobot_dexflex.hand.model import SUBSTEPS, TIP_FRICTION, add_hand, base_spec, tip_geoms
from lerobot_dexflex.hand.objects import ObjectSpec, add_object
from lerobot_dexflex.hand.poses import pose_error
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

OBJECT = "object"
HOLD = "hold"

_APPROACH = 0.02
_PRESS = 0.008
_MAX_TORQUE = 0.45
_LOADED = 0.15
_MAX_REST_SPEED = 0.02


class Grasp(NamedTuple):
    """A held object at rest. Frames: palm."""

    hand_joints: Array
    """Measured joints [rad]. Shape (joints,)."""
    joint_targets: Array
    """The constant joint command that holds it [rad]. Shape (joints,)."""
    position: Array
    """Object position [m]. Shape (3,)."""
    quaternion: Array
    """Object orientation (w x y z). Shape (4,)."""
    touching: NDArray[np.bool_]
    """Which fingertips carry load, 0.15 N or more. Shape (fingers,)."""


def hand_scene(hand: Hand, object_spec: ObjectSpec) -> mujoco.MjSpec:
    """Return the hand alone, palm frame = world frame, an object, and the inactive weld `hold` that fixes it.

    The object's friction is given to the fingertips, whose friction rules their contacts.
    """
    spec = base_spec()
    add_hand(spec, spec.worldbody, hand, (0, 0, 0), (1, 0, 0, 0), (object_spec.friction, *TIP_FRICTION[1:]))
    add_object(spec, object_spec, OBJECT)
    weld = spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, name=HOLD, name1="world", name2=OBJECT)
    weld.objtype = mujoco.mjtObj.mjOBJ_BODY
    weld.active = False
    return spec


class GraspSearch:
    """Find grasps of one object under one direction of gravity.

    Args:
        hand: The hand that grasps.
        object_spec: What to grasp.
        gravity: Direction of gravity in the palm frame; normalised. Shape (3,).
    """

    HOLD_STEPS, SHAKE_STEPS, REST_STEPS = 24, 8, 8
    """Control steps of the hold test, of each of the three shakes and of the rest after them."""
    HOLD_DRIFT = (0.006, 0.20)
    """How far [m], [rad] the object may settle when the hand takes its weight."""
    SHAKE_DRIFT = (0.008, 0.25)
    """How far [m], [rad] it may go from there in the shakes and after them."""
    SHAKE_TILT, SHAKE_GAIN = 0.6, 1.3

    def __init__(self, hand: Hand, object_spec: ObjectSpec, gravity: Array) -> None:
        self.hand = hand
        self.object_spec = object_spec
        self.gravity = np.asarray(gravity, float) / np.linalg.norm(gravity)
        self.model = hand_scene(hand, object_spec).compile()
        self.data = mujoco.MjData(self.model)
        self._object = self.model.body(OBJECT).id
        self._tip_geoms = {self.model.geom(name).id for name in tip_geoms(hand)}
        self._weld = self.model.equality(HOLD).id
        self._n = hand.n_joints

    def find(self, rng: np.random.Generator, min_fingers: int = 3, tries: int = 200) -> Grasp:
        """Return the first grasp that passes every test; the state of `rng` alone decides which.

        Args:
            rng: Source of randomness.
            min_fingers: How many fingertips must touch, 3 or more; four take about five times the search.
            tries: Number of object poses to try.

        Raises:
            DexFlexError: If no object pose out of `tries` led to one.
        """
        for _ in range(tries):
            for candidate in grasp_candidates(self.hand, self.object_spec, rng, min_fingers):
                grasp = self.prove(candidate, rng, min_fingers)
                if grasp is not None:
                    return grasp
        raise DexFlexError(
            f"No stable grasp of {self.object_spec} found in {tries} object poses. "
            "Try another object or direction of gravity, or raise `tries`."
        )

    def prove(self, candidate: Candidate, rng: np.random.Generator, min_fingers: int = 3) -> Grasp | None:
        """Close on the fixed object, release it, hold it, shake it; return the grasp if it survives."""
        if self._collides(candidate):
            return None
        touching = self._close(candidate)
        if touching.sum() < min_fingers:
            return None
        start = self._pose()
        if not self._hold(self.HOLD_STEPS, self.gravity, start, self.HOLD_DRIFT):
            return None
        touching = self._touching()
        moving = np.abs(self.data.qvel[self._n : self._n + 3]).max() > _MAX_REST_SPEED
        if moving or touching.sum() < min_fingers:
            return None
        joints, targets = self.data.qpos[: self._n].copy(), self.data.ctrl.copy()
        rest = self._pose()
        for _ in range(3):
            sideways = np.cross(self.gravity, rng.normal(size=3))
            sideways /= np.linalg.norm(sideways)
            tilted = np.cos(self.SHAKE_TILT) * self.gravity + np.sin(self.SHAKE_TILT) * sideways
            if not self._hold(self.SHAKE_STEPS, self.SHAKE_GAIN * tilted, rest, self.SHAKE_DRIFT):
                return None
        if not self._hold(self.REST_STEPS, self.gravity, rest, self.SHAKE_DRIFT):
            return None
        if not np.array_equal(self._touching(), touching):
            return None
        return Grasp(joints, targets, *rest, touching)

    def _touching(self) -> NDArray[np.bool_]:
        return fingertip_contacts(self.hand, self.model, self.data, OBJECT).loads > _LOADED

    def _collides(self, candidate: Candidate) -> bool:
        """Say whether anything but fingertips on the object would overlap."""
        mujoco.mj_resetData(self.model, self.data)
        self._place(candidate.joints, candidate)
        mujoco.mj_fwdPosition(self.model, self.data)
        for contact in self.data.contact:
            pair = {int(g) for g in contact.geom}
            with_object = any(self.model.geom_bodyid[g] == self._object for g in pair)
            if contact.dist < -0.001 and not (with_object and pair & self._tip_geoms):
                return True
        return False

    def _close(self, candidate: Candidate) -> NDArray[np.bool_]:
        """Approach the welded object, press, then squeeze with balanced forces; say which fingers touch."""
        away = candidate.points + _APPROACH * candidate.normals
        press = candidate.points - _PRESS * candidate.normals
        targets = solve_pads(
            self.hand,
            torch.from_numpy(np.stack([away, press])),
            torch.from_numpy(np.stack([candidate.normals] * 2)),
            torch.from_numpy(np.stack([candidate.joints] * 2)),
            iterations=6,
        ).joints.numpy()
        targets = np.where(candidate.active[self.hand.finger_of_joint], targets, candidate.joints)
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        self._place(targets[0], candidate)
        model.eq_data[self._weld] = 0.0
        model.eq_data[self._weld, 3:10] = (*candidate.position, *candidate.quaternion)
        model.eq_data[self._weld, 10] = 1.0
        data.eq_active[self._weld] = 1
        model.opt.gravity = GRAVITY * self.gravity
        self._move(targets[1], 8)
        mujoco.mj_step(model, data, 4 * SUBSTEPS)
        loads, points, inward = fingertip_contacts(self.hand, model, data, OBJECT)
        touching = loads > _LOADED
        if touching.sum() < 3:
            return touching
        forces = np.zeros((self.hand.n_fingers, 3))
        forces[touching], _ = balance_weight(
            self.object_spec, points[touching], inward[touching], data.xipos[self._object], self.gravity
        )
        joints = data.qpos[: self._n]
        torques = contact_torques(self.hand.tables, joints, points, forces)
        squeeze = joints + np.clip(torques, -_MAX_TORQUE, _MAX_TORQUE) / self.hand.position_gains
        squeeze = np.where(touching[self.hand.finger_of_joint], squeeze, data.ctrl)
        self._move(np.clip(squeeze, *model.jnt_range[: self._n].T), 4)
        mujoco.mj_step(model, data, 4 * SUBSTEPS)
        data.eq_active[self._weld] = 0
        return touching

    def _place(self, joints: Array, candidate: Candidate) -> None:
        self.data.qpos[:] = (*joints, *candidate.position, *candidate.quaternion)
        self.data.ctrl[:] = joints

    def _move(self, targets: Array, steps: int) -> None:
        start = self.data.ctrl.copy()
        for k in range(steps * SUBSTEPS):
            self.data.ctrl[:] = start + (k + 1) / (steps * SUBSTEPS) * (targets - start)
            mujoco.mj_step(self.model, self.data)

    def _hold(
        self, steps: int, gravity: Array, start: tuple[Array, Array], drift: tuple[float, float]
    ) -> bool:
        self.model.opt.gravity = GRAVITY * gravity
        for _ in range(steps):
            mujoco.mj_step(self.model, self.data, SUBSTEPS)
            distance, angle = pose_error(*start, *self._pose())
            if distance > drift[0] or angle > drift[1]:
                return False
        return True

    def _pose(self) -> tuple[Array, Array]:
        return self.data.qpos[self._n : self._n + 3].copy(), self.data.qpos[self._n + 3 :].copy()
