"""Move the wrist: damped-least-squares inverse kinematics of the xArm7 for a palm pose."""

from functools import cache

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.grasp_frame import flange_change, grasp_frame
from lerobot_dexflex.hands import PALM, Hand
from lerobot_dexflex.hands.tables import rotation_of

Array = NDArray[np.float64]
N_ARM = len(robot.ARM_JOINTS)


@cache
def robot_model(hand: Hand) -> mujoco.MjModel:
    """Return the compiled arm with a hand, without any scene (base at the world origin)."""
    spec = robot.base_spec()
    robot.add_hand(spec, robot.add_arm(spec), hand)
    return spec.compile()


def rotation_vector(rotation: Array) -> Array:
    """Return the rotation vector [rad] of a rotation matrix (3, 3)."""
    quaternion, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def rotation_matrix(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    quaternion, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, vector / angle, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def about_z(angle: float) -> Array:
    """Return the rotation matrix (3, 3) of a turn about z [rad]."""
    return rotation_matrix(np.array([0.0, 0.0, angle]))


class ArmKinematics:
    """Forward and inverse kinematics of a point fixed to the palm.

    Args:
        hand: The hand on the arm.
        point: The controlled point in the palm frame [m] (a grasp centre, say). Shape (3,).
        posture: Arm configuration that the spare joint is pulled to [rad]. Shape (7,).
    """

    ROTATION_SCALE = 0.3
    """Length that weighs 1 rad of orientation error against position error [m/rad]."""

    def __init__(self, hand: Hand, point: Array, posture: Array) -> None:
        self.point = np.asarray(point, float)
        self.posture = np.asarray(posture, float)
        self._model = robot_model(hand)
        self._data = mujoco.MjData(self._model)
        self._palm = self._model.body(PALM).id
        self._lower, self._upper = self._model.jnt_range[:N_ARM].T
        self._jacobian = np.zeros((6, self._model.nv))

    def forward(self, arm_joints: Array) -> tuple[Array, Array]:
        """Return the point's position [m] (3,) and the palm's orientation (3, 3) in the world frame."""
        self._data.qpos[:N_ARM] = arm_joints
        mujoco.mj_kinematics(self._model, self._data)
        rotation = self._data.xmat[self._palm].reshape(3, 3).copy()
        return self._data.xpos[self._palm] + rotation @ self.point, rotation

    def error(self, arm_joints: Array, position: Array, rotation: Array) -> tuple[float, float]:
        """Return the position [m] and orientation [rad] errors of a configuration."""
        point, palm = self.forward(arm_joints)
        return float(np.linalg.norm(position - point)), float(
            np.linalg.norm(rotation_vector(rotation @ palm.T))
        )

    def solve(
        self,
        arm_joints: Array,
        position: Array,
        rotation: Array,
        iterations: int = 3,
        damping: float = 0.02,
        posture_gain: float = 0.02,
    ) -> Array:
        """Take a few steps from `arm_joints` toward a pose; for straight pieces of up to 15 cm.

        Args:
            arm_joints: Seed [rad]. Shape (7,).
            position: Target of the controlled point, world frame [m]. Shape (3,).
            rotation: Target orientation of the palm, world frame. Shape (3, 3).
            iterations: Number of steps.
            damping: Damping at large errors [m]; it fades as the error does.
            posture_gain: Share of the way to `posture` taken in the null space at each step.

        Returns:
            Arm joints within the limits [rad]. Shape (7,).
        """
        joints = np.array(arm_joints, float)
        for _ in range(iterations):
            point, palm = self.forward(joints)
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_jac(self._model, self._data, self._jacobian[:3], self._jacobian[3:], point, self._palm)
            jacobian = self._jacobian[:, :N_ARM].copy()
            jacobian[3:] *= self.ROTATION_SCALE
            error = np.concatenate(
                [position - point, self.ROTATION_SCALE * rotation_vector(rotation @ palm.T)]
            )
            weight = damping**2 * min(1.0, 0.02 + 10 * error @ error)
            step = np.linalg.solve(jacobian.T @ jacobian + weight * np.eye(N_ARM), jacobian.T @ error)
            if posture_gain:
                null_space = np.eye(N_ARM) - np.linalg.pinv(jacobian, rcond=1e-3) @ jacobian
                step += posture_gain * null_space @ (self.posture - joints)
            step *= min(1.0, 0.3 / max(np.abs(step).max(), 1e-9))
            joints[:] = np.clip(joints + step, self._lower + 0.01, self._upper - 0.01)
        return joints

    def reach(self, seed: Array, position: Array, rotation: Array) -> Array:
        """Solve for a far pose from a planar seed that also fixes the arm's branch; (7,) [rad].

        Joint-space interpolation to the result avoids the wrist singularities that a Cartesian path meets.
        """
        seed = np.asarray(seed, float)
        kept, self.posture = self.posture, seed
        joints = self.solve(seed, position, rotation, iterations=150, damping=0.03, posture_gain=0.1)
        self.posture = kept
        return self.solve(joints, position, rotation, iterations=20, damping=0.01, posture_gain=0.0)


def arm_for(hand: Hand, arm_joints: ArrayLike) -> Array:
    """Return the arm's joints with which a hand grasps where, as written, `arm_joints` lets it grasp [rad].

    Args:
        hand: The hand on the arm.
        arm_joints: Joints as tasks and operators are written. Shape (7,).
    """
    joints = np.array(arm_joints, float)
    shift, turn = flange_change(hand)
    if not shift.any() and np.array_equal(turn, np.eye(3)):
        return joints
    grasping = ArmKinematics(hand, grasp_frame(hand).centre, joints)
    point, palm = grasping.forward(joints)
    flange = palm @ rotation_of(hand.mount_quaternion).T
    last = joints[-1] + np.arctan2(turn[1, 0], turn[0, 0])
    joints[-1] = last - 2 * np.pi * np.round(last / (2 * np.pi))
    return grasping.reach(joints, point + flange @ shift, flange @ turn @ flange.T @ palm)
