"""The columns of the dataset: their names, units and resolution, in one place."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hand.model import SUBSTEPS, TIMESTEP, robot_joints
from lerobot_dexflex.hands import Hand, get_hand

FPS = round(1 / (SUBSTEPS * TIMESTEP))
"""Frames per second of datasets: the control rate."""
_ON_ARM = "_xarm7"
"""Follows the name of a hand that is on an arm."""

# Powers of two are exact in float32 and leave its low bits zero, which is what compresses.
ANGLE_STEP = 2.0**-14
LENGTH_STEP = 2.0**-18
FORCE_STEP = 2.0**-8
"""About the noise of a taxel."""


class Column(NamedTuple):
    """One numeric column of the dataset."""

    names: list[str]
    """Name of every element."""
    unit: str
    steps: NDArray[np.float64]
    """Resolution of every element; recorded values are multiples of it."""
    meaning: str


def privileged_columns(hand: Hand) -> dict[str, Column]:
    """Return the columns of a hand that only simulation knows.

    LeRobot hands no policy what is called neither `observation...` nor `action...`.
    """
    tips = _tip_names(hand)
    return {
        "operator.draft": Column(
            tips,
            "m",
            np.full(len(tips), LENGTH_STEP),
            "privileged: where the operator wants the fingertips after this step, without squeeze and before "
            "the errors of its glove, in the palm frame",
        ),
        "contact.loads": Column(
            [f"{finger}_load" for finger in hand.prefixes],
            "N",
            np.full(hand.n_fingers, FORCE_STEP),
            "privileged: true normal force on each fingertip before this step",
        ),
    }


def columns(hand: Hand, joints: Sequence[str]) -> dict[str, Column]:
    """Return the numeric columns of a robot for policies, keyed as in the dataset.

    Args:
        hand: The hand.
        joints: Names of all joints, the arm's before the hand's.
    """
    angles = [f"{joint}.pos" for joint in joints]
    tips, (rows, across) = _tip_names(hand), hand.taxels
    taxels = [
        f"{finger}_taxel.{row}.{column}"
        for finger in hand.prefixes
        for row in range(rows)
        for column in range(across)
    ]
    touch = f"{hand.n_fingers} fingers x {rows} rows (toward the tip) x {across} columns"
    steps = np.repeat([ANGLE_STEP, LENGTH_STEP], [len(angles), len(tips)])
    state, length = steps[: len(angles)], steps[len(angles) :]
    return {
        "observation.state": Column(angles, "rad", state, "measured joint positions, arm then hand"),
        "observation.tactile": Column(
            taxels,
            "N",
            np.full(len(taxels), FORCE_STEP),
            f"taxel normal forces, {touch}",
        ),
        "observation.fingertips": Column(tips, "m", length, "measured fingertips in the palm frame"),
        "observation.gravity": Column(
            [f"gravity.{axis}" for axis in "xyz"],
            "unit",
            np.full(3, ANGLE_STEP),
            "gravity direction in the palm frame",
        ),
        "action": Column(
            angles + tips,
            "rad, m",
            steps,
            "absolute joint targets, then the commanded fingertips, those of these joints, in the palm frame",
        ),
    }


def rounded(values: NDArray, steps: NDArray[np.float64]) -> NDArray[np.float32]:
    """Round values to the nearest multiple of `steps`. Shapes (..., n) and (n,)."""
    return (np.round(np.asarray(values, np.float64) / steps) * steps).astype(np.float32)


def lerobot_features(table: dict[str, Column], images: dict[str, tuple[int, ...]]) -> dict[str, Any]:
    """Return LeRobot's feature description.

    Args:
        table: Numeric columns from `columns`.
        images: Shape (height, width, 3) of each camera, keyed `observation.images.<camera>`.
    """
    cameras = {
        key: {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]}
        for key, shape in images.items()
    }
    numbers = {
        key: {"dtype": "float32", "shape": (len(column.names),), "names": column.names}
        for key, column in table.items()
    }
    return cameras | numbers


def robot_type(hand: Hand, joints: Sequence[str]) -> str:
    """Return LeRobot's name of the robot with these joints: the hand on its arm, or the hand alone."""
    return f"{hand.name}{_ON_ARM}" if len(joints) > hand.n_joints else hand.name


def robot_of(robot_type: str) -> tuple[Hand, tuple[str, ...]]:
    """Return the hand and the joints of a robot by LeRobot's name of it: the inverse of `robot_type`.

    Raises:
        DexFlexError: If there is no such hand.
    """
    name = robot_type.removesuffix(_ON_ARM)
    hand = get_hand(name)
    return hand, hand.joint_names if name == robot_type else robot_joints(hand)


def _tip_names(hand: Hand) -> list[str]:
    return [f"{finger}_tip.{axis}" for finger in hand.prefixes for axis in "xyz"]
