"""What the operator remembers of the fingers."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.sensing import ObjectSenses

Array = NDArray[np.float64]


class Mode(IntEnum):
    """What a finger is doing."""

    PARKED = -1
    HOLD = 0
    LIFT = 1
    SWING = 2
    PLACE = 3


@dataclass
class FingerStates:
    """Everything the operator remembers; deep copies are snapshots."""

    mode: NDArray[np.int64]
    """`Mode` of each finger. Shape (4,)."""
    anchor: Array
    """Where holding tips are, in the object's frame [m]. Shape (4, 3)."""
    inward: Array
    """Contact normals into the object, in its frame. Shape (4, 3)."""
    joints: Array
    """Posture of the first grasp [rad]. Shape (16,)."""
    park: Array
    """Where parked tips stay [m]. Shape (4, 3)."""
    timer: NDArray[np.int64] = field(default_factory=lambda: np.zeros(4, np.int64))
    """Steps in the current mode; for a holding finger, steps without load."""
    next_anchor: Array = field(default_factory=lambda: np.zeros((4, 3)))
    next_inward: Array = field(default_factory=lambda: np.zeros((4, 3)))
    free: Array = field(default_factory=lambda: np.zeros((4, 3)))
    """Where lifted tips have got to, in the object's frame [m]. Shape (4, 3)."""
    forces: Array | None = None
    """Smoothed forces, wanted and executed [N], (2, 4, 3); None before the first step."""
    reference: tuple[Array, Array] | None = None
    """Pose that leads the object to the goal; None begins at the object's."""


class Holder(Protocol):
    """Who holds an object and wants it elsewhere: the operator."""

    senses: ObjectSenses
    fingers: FingerStates
    goal: tuple[Array, Array]
    """Position [m] (3,) and orientation (w x y z)."""
    preload: float
    """Internal squeeze per finger [N]."""
