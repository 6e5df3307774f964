"""A bench that the hand alone is mounted on, its palm frame the world frame."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.model import add_hand, base_spec
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

POSTURES = ("relaxed_joints", "nominal_joints", "idle_joints", "open_joints", "loose_joints")
"""Fields of a hand that hold its postures."""


class Bench:
    """The simulated hand in postures of one's choice.

    Raises:
        DexFlexError: If the simulator refuses the hand's numbers.
    """

    def __init__(self, hand: Hand) -> None:
        spec = base_spec()
        add_hand(spec, spec.worldbody, hand, (0, 0, 0), (1, 0, 0, 0))
        try:
            self.model = spec.compile()
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise DexFlexError(
                f"MuJoCo refuses the links of hand '{hand.name}' ({reason}). Give masses in kg, lengths in "
                "m, and principal moments in kg m^2, none of them more than the sum of the others."
            ) from error
        self.data = mujoco.MjData(self.model)

    def pose(self, joints: Array) -> None:
        """Put the hand into a posture, without any motion. Shape (joints,), [rad]."""
        self.data.qpos[:] = self.data.ctrl[:] = joints
        self.data.qvel[:] = 0.0
        mujoco.mj_fwdPosition(self.model, self.data)


def random_postures(hand: Hand, n: int) -> Array:
    """Return postures drawn uniformly within the limits, always the same [rad]. Shape (n, joints)."""
    return np.random.default_rng(0).uniform(hand.joint_lower, hand.joint_upper, (n, hand.n_joints))


def sweep(hand: Hand, steps: int) -> Array:
    """Return postures in which one joint after another goes through its range, the others relaxed [rad].

    Args:
        hand: The hand.
        steps: Postures per joint.

    Returns:
        Postures, joint by joint. Shape (joints, steps, joints).
    """
    rest = np.array(hand.relaxed_joints)
    postures = np.broadcast_to(rest, (hand.n_joints, steps, hand.n_joints)).copy()
    way = np.linspace(0, 1, steps)
    for joint, (lower, upper) in enumerate(zip(hand.joint_lower, hand.joint_upper, strict=True)):
        stops = [rest[joint], lower, upper, rest[joint]]
        lengths = np.cumsum([0, *np.abs(np.diff(stops))])
        postures[joint, :, joint] = np.interp(way * lengths[-1], lengths, stops)
    return postures
