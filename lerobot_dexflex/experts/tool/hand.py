"""The operator's hand: it goes to a tool, grips it as hard as its weight asks, turns it, lets go."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.experts.command import min_jerk
from lerobot_dexflex.experts.reach.fingers import Mode
from lerobot_dexflex.experts.reach.operator import Operator
from lerobot_dexflex.experts.tool.grip import Grip
from lerobot_dexflex.experts.tool.senses import ToolSenses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.poses import pose_error

Array = NDArray[np.float64]
MARGIN = (1.3, 2.5)
"""By how much more than friction asks for operators grip."""
LOST_STEPS = 3
"""A finger has lost the tool once it has felt nothing for so many steps."""
PRELOAD = 1.0
"""Internal squeeze per finger that is wished for, for a margin of 1 [N]."""


class OperatorHand:
    """Says joints and draft of the hand, step by step; privileged.

    Free fingers follow a path of joints; a gripped tool is led by the operator of `Reach-v0`.

    Args:
        senses: Of the running task.
        joints: Joint command at the start, arm then hand [rad]. Shape (arm + hand,).
        rng: Source of randomness, for regrasps only.
        margin: By how much more than needed it grips.
        frame: Axes of the working frame in the palm frame, see `holds`. Shape (3, 3).
    """

    def __init__(
        self, senses: ToolSenses, joints: Array, rng: np.random.Generator, margin: float, frame: Array
    ) -> None:
        self.senses, self._rng, self._margin, self.frame = senses, rng, margin, frame
        self._hand, joints = senses.hand, joints[-senses.hand.n_joints :]
        self._path = np.array(joints, float)[None]
        self.operator: Operator | None = None

    def go(self, target: Array, steps: int) -> None:
        """Send free fingers to joint positions [rad] (joints,), smoothly, in so many steps."""
        phases = np.array([min_jerk(k / steps) for k in range(1, steps + 1)])[:, None]
        here = self._path[:1]
        self._path = np.concatenate([here, here + phases * (target - here)])

    def relax(self, steps: int, after: int = 0) -> None:
        """Let the fingers go back to rest in so many steps, after keeping still for some."""
        self.go(np.array(self._hand.relaxed_joints), steps)
        self._path = np.concatenate([np.repeat(self._path[:1], after, 0), self._path])

    def grip(self, grip: Grip, preload: float | None = None, friction_share: float | None = None) -> None:
        """Close the fingers of a grip and keep the tool where it is in the palm.

        Args:
            grip: Where the fingers are.
            preload: Internal squeeze per finger that is wished for [N]; None leaves the margin's.
            friction_share: Share of the friction that the forces may use; None leaves the margin.
        """
        self.operator = Operator(self.senses, self._rng)
        self.squeeze(
            PRELOAD * self._margin if preload is None else preload,
            1.0 / self._margin if friction_share is None else friction_share,
        )
        self.operator.expect(grip.inward, self.senses.read())

    def squeeze(self, preload: float, friction_share: float) -> None:
        """Grip the tool harder or less hard; the arguments are those of `grip`."""
        assert self.operator is not None
        self.operator.preload, self.operator.friction_share = preload, friction_share

    def let_go(self) -> None:
        """Lead all fingers freely again, from where they are."""
        self._path = self.senses.read().joints[None]
        self.operator = None

    def lead(self, position: Array, rotation: Array) -> None:
        """Lead the gripped tool in the palm.

        Args:
            position: Where its body is to be, working frame [m]. Shape (3,).
            rotation: How it is to be turned. Shape (3, 3).
        """
        assert self.operator is not None
        position, rotation = self.frame @ position, self.frame @ rotation
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
        self.operator.set_goal(position + rotation @ self.senses.tool.centre, quaternion)

    def keep(self) -> None:
        """Hold the gripped tool where it is."""
        assert self.operator is not None
        now = self.senses.read()
        self.operator.set_goal(now.position, now.quaternion)

    def brace(self, force: Array, point: Array) -> None:
        """Expect a force on the gripped tool from outside, until told otherwise.

        Args:
            force: In the working frame [N]. Shape (3,).
            point: Where it acts, in the frame of the tool's body [m]. Shape (3,).
        """
        assert self.operator is not None
        force = self.frame @ force
        arm = self.senses.read().rotation @ (point - self.senses.tool.centre)
        self.operator.load[:3], self.operator.load[3:] = force, np.cross(arm, force)

    @property
    def gripped(self) -> bool:
        """Whether every finger that shall hold the tool feels it."""
        if self.operator is None:
            return False
        holding = self.operator.fingers.mode == Mode.HOLD
        return bool((self.senses.read().loads[holding] > 2 * CONTACT_FORCE).all())

    @property
    def miss(self) -> tuple[float, float]:
        """How far the tool is from where it is led [m], [rad]."""
        assert self.operator is not None
        now = self.senses.read()
        return pose_error(now.position, now.quaternion, *self.operator.goal)

    @property
    def there(self) -> bool:
        """Whether the tool is where it is led, to 4 mm and .06 rad."""
        distance, angle = self.miss
        return distance < 0.004 and angle < 0.06

    @property
    def slipping(self) -> bool:
        """Whether a finger that shall hold the tool has lost it."""
        if self.operator is None:
            return False
        fingers = self.operator.fingers
        return bool(((fingers.mode == Mode.HOLD) & (fingers.timer >= LOST_STEPS)).any())

    def step(self) -> tuple[Array, Array]:
        """Return joint targets [rad] (joints,) and the draft, palm frame [m] (8, fingers, 3), of now."""
        if self.operator is not None:
            guidance = self.operator.guide()
            return guidance.joints, guidance.tips
        path = self._path
        self._path = path[1:] if len(path) > 1 else path
        ahead = np.minimum(np.arange(DRAFT_HORIZON), len(self._path) - 1)
        return self._path[0], kernels.fingertips(self._hand.tables, self._path[ahead])
