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
    """`Mode` of each finger. Shape (fingers,)."""
    anchor: Array
    """Where holding tips are, in the object's frame [m]. Shape (fingers, 3)."""
    inward: Array
    """Contact normals into the object, in its frame. Shape (fingers, 3)."""
    joints: Array
    """Posture of the first grasp [rad]. Shape (joints,)."""
    park: Array
    """Where parked tips stay [m]. Shape (fingers, 3)."""
    timer: NDArray[np.int64] = field(init=False)
    """Steps in the current mode; for a holding finger, steps without load."""
    next_anchor: Array = field(init=False)
    next_inward: Array = field(init=False)
    free: Array = field(init=False)
    """Where lifted tips have got to, in the object's frame [m]. Shape (fingers, 3)."""
    forces: Array | None = None
    """Smoothed forces, wanted and executed [N], (2, fingers, 3); None before the first step."""
    reference: tuple[Array, Array] | None = None
    """Pose that leads the object to the goal; None begins at the object's."""

    def __post_init__(self) -> None:
        self.timer = np.zeros(self.mode.shape, np.int64)
        self.next_anchor, self.next_inward, self.free = (np.zeros(self.anchor.shape) for _ in range(3))


class Holder(Protocol):
    """Who holds an object and wants it elsewhere: the operator."""

    senses: ObjectSenses
    fingers: FingerStates
    goal: tuple[Array, Array]
    """Position [m] (3,) and orientation (w x y z)."""
    preload: float
    """Internal squeeze per finger [N]."""
