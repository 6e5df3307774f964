"""Inverse kinematics of live operation, by mink: the arm follows a palm pose, the fingers follow their tips.

The arm and each finger are problems of their own, as targets in the palm frame make them: what one cannot
reach slows no other. Each call solves two quadratic programs per chain, within joint limits and speeds, from
where the last call ended. `docs/teleoperation.md` has accuracy and time.
"""

import math
from collections.abc import Sequence

import mink
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hands import PALM, Finger, Hand
from lerobot_dexflex.streams.wrist_frame import Frame

Array = NDArray[np.float64]

ARM_SPEED = math.pi
"""Largest speed of an arm's joint [rad/s]: 180 deg/s (UFACTORY, "Servo Mode Usage Guide")."""
ROTATION_COST = 0.3
"""Length that weighs 1 rad of the palm's orientation against its position [m/rad]."""
LIMIT_MARGIN = 1e-3
"""Distance that is kept from the joint limits [rad]."""
UNBEND = 1.0
"""Speed at which those come forward that start bent back [rad/s]."""
_ITERATIONS = 2
"""Steps per call. One overshoots where a target is out of reach."""


class Chain:
    """One chain of joints that leads one frame; it remembers where it is.

    Args:
        model: Of the chain alone.
        task: What its frame should do. Its damping grows with its error, so far targets stay tame.
        posture: What takes what the task leaves free [rad]. Shape (n,).
        straight: Names of joints that bend no farther back than zero.
        posture_cost: Weight of that posture [m/rad].
        damping_cost: Weight of motion as such [m/rad].
        speed: Largest speed of a joint [rad/s].
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        task: mink.FrameTask,
        posture: Array,
        straight: Sequence[str],
        posture_cost: float,
        damping_cost: float,
        speed: float,
    ) -> None:
        pull = mink.PostureTask(model, posture_cost)
        pull.set_target(posture)
        self.task = task
        self._tasks = [task, pull, mink.DampingTask(model, damping_cost)]
        names = [model.joint(k).name for k in range(model.njnt)]
        self._range = mink.ConfigurationLimit(model, gain=1.0, min_distance_from_limits=LIMIT_MARGIN)
        self._limits = [self._range, mink.VelocityLimit(model, dict.fromkeys(names, speed))]
        self._low, self._high = model.jnt_range.T + np.array([[LIMIT_MARGIN], [-LIMIT_MARGIN]])
        self._least = np.where([name in straight for name in names], 0.0, self._low)
        self._configuration = mink.Configuration(model)

    @property
    def joints(self) -> Array:
        """Where it is [rad]. Shape (n,)."""
        return self._configuration.q

    @property
    def frame(self) -> mink.SE3:
        """Where its frame is, in the frame of its base."""
        return self._configuration.get_transform_frame_to_world(self.task.frame_name, self.task.frame_type)

    def put(self, joints: ArrayLike) -> None:
        """Go on from joints [rad], shape (n,), or from the nearest within the limits."""
        self._configuration.update(np.clip(np.asarray(joints, float), self._low, self._high))

    def advance(self, target: mink.SE3, dt: float) -> None:
        """Go toward a target for a time [s]; stay where the solver finds no way."""
        self.task.set_target(target)
        step = dt / _ITERATIONS
        for _ in range(_ITERATIONS):
            self._range.lower = np.minimum(self._least, self.joints + UNBEND * step)
            try:
                velocity = mink.solve_ik(
                    self._configuration, self._tasks, step, solver="daqp", limits=self._limits
                )
            except mink.NoSolutionFound:
                return
            self.put(self._configuration.integrate(velocity, step))


class RobotIK:
    """Leads the arm to a palm pose and the fingers to fingertips, a little with every call.

    Targets out of reach are approached as far as joints allow. Joints are always finite, within their limits
    and no faster than their servos.

    Args:
        hand: The hand on the arm.
        joints: Where it starts, arm then hand [rad]; so the arm prefers to be. Shape (arm + hand,).
    """

    def __init__(self, hand: Hand, joints: ArrayLike) -> None:
        arm = np.array(joints, float)[: len(robot.ARM_JOINTS)]
        palm = mink.FrameTask(PALM, "body", 1.0, ROTATION_COST, lm_damping=1.0)
        self._arm = Chain(
            _arm_model(hand), palm, arm, (), posture_cost=0.01, damping_cost=0.05, speed=ARM_SPEED
        )
        self._fingers = [_finger(hand, k) for k in range(hand.n_fingers)]
        self.put(joints)

    @property
    def joints(self) -> Array:
        """Where the robot was led to, arm then hand [rad]. Shape (arm + hand,)."""
        return np.concatenate([chain.joints for chain in (self._arm, *self._fingers)])

    @property
    def palm(self) -> Frame:
        """Where the palm was led to, in the frame of the arm's base."""
        pose = self._arm.frame
        return Frame(pose.translation(), pose.rotation().as_matrix())

    @property
    def tips(self) -> Array:
        """Where the fingertips were led to, palm frame [m]. Shape (fingers, 3)."""
        return np.stack([finger.frame.translation() for finger in self._fingers])

    def put(self, joints: ArrayLike) -> None:
        """Go on from joints [rad], shape (arm + hand,): where the robot is after a reset."""
        ends = np.cumsum([len(chain.joints) for chain in (self._arm, *self._fingers)])[:-1]
        for chain, own in zip(
            (self._arm, *self._fingers), np.split(np.asarray(joints, float), ends), strict=True
        ):
            chain.put(own)

    def solve(self, palm: Frame | None, tips: Array, dt: float) -> Array:
        """Go toward targets for a time.

        Args:
            palm: Where the palm should be, in the frame of the arm's base; None keeps the arm still.
            tips: Where the fingertips should be, palm frame [m]. Shape (fingers, 3).
            dt: Time since the last call [s].

        Returns:
            Joint targets, arm then hand [rad]. Shape (arm + hand,).

        Raises:
            DexFlexError: If a target is not finite, or the time not positive; nothing has moved then.
        """
        wanted = [*np.asarray(tips).flat, *(() if palm is None else (*palm.position, *palm.rotation.flat))]
        if not (np.isfinite(wanted).all() and 0 < dt < math.inf):
            raise DexFlexError(f"Targets must be finite and time positive. Got {wanted} and {dt} s.")
        if palm is not None:
            rotation = mink.SO3.from_matrix(np.asarray(palm.rotation, float))
            target = mink.SE3.from_rotation_and_translation(rotation, np.asarray(palm.position, float))
            self._arm.advance(target, dt)
        for finger, tip in zip(self._fingers, np.asarray(tips, float), strict=True):
            finger.advance(mink.SE3.from_translation(tip), dt)
        return self.joints


def straight_joints(hand: Hand) -> list[slice]:
    """Return which joints bend no farther back than straight, as a person's: the last two of each finger.

    A finger that passes through straight could else bend the wrong way, and stay so while the person's makes
    a fist. Those that oppose may. Fingers bend for positive angles.
    """
    ends = [hand.finger_joints[k].stop for k in hand.opposed_fingers]
    return [slice(end - 2, end) for end in ends]


def _finger(hand: Hand, finger: int) -> Chain:
    names = [name for joints in straight_joints(hand) for name in hand.joint_names[joints]]
    return Chain(
        _finger_model(hand, finger),
        mink.FrameTask(f"{hand.prefixes[finger]}_tip", "site", 1.0, 0.0, lm_damping=3.0),
        np.array(hand.loose_joints[hand.finger_joints[finger]]),
        names,
        posture_cost=0.002,
        damping_cost=0.01,
        speed=float(hand.joint_speeds.min()),
    )


def _arm_model(hand: Hand) -> mujoco.MjModel:
    """Return the arm with a palm but no fingers."""
    spec = robot.base_spec()
    robot.add_hand(spec, robot.add_arm(spec), hand)
    return _without(spec, hand.fingers)


def _finger_model(hand: Hand, finger: int) -> mujoco.MjModel:
    """Return one finger in the frame of its palm, which stands still."""
    spec = robot.base_spec()
    robot.add_hand(spec, spec.worldbody, hand, (0.0, 0.0, 0.0), (1, 0, 0, 0))
    return _without(spec, [other for k, other in enumerate(hand.fingers) if k != finger])


def _without(spec: mujoco.MjSpec, fingers: Sequence[Finger]) -> mujoco.MjModel:
    for finger in fingers:
        spec.delete(spec.body(finger.links[0].name))
    return spec.compile()
