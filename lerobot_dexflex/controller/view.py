"""One of several hands as their layout has it: what it feels, on the way in, what to do, on the way out."""

from functools import cache

import torch
from torch import Tensor

from lerobot_dexflex.controller.history import History
from lerobot_dexflex.controller.layout import SharedLayout, middle
from lerobot_dexflex.hand.grasp_frame import grasp_frame
from lerobot_dexflex.hands import Hand


class View:
    """Bring quantities of a hand into the slots and the frame of a layout, and back.

    Leading axes may be any.

    Args:
        layout: How networks see the fingers of several hands.
        hand: One of its hands.
    """

    def __init__(self, layout: SharedLayout, hand: Hand) -> None:
        self._fingers, self._joints = layout.n_fingers, layout.n_joints
        centre, axes = grasp_frame(hand)
        self._slots = torch.from_numpy(layout.slots(hand))
        self._joint_slots = torch.from_numpy(layout.joint_slots(hand))
        self._centre, self._axes = torch.from_numpy(centre), torch.from_numpy(axes)
        self._joint_center = torch.from_numpy(middle(hand))
        self._tip_center = torch.from_numpy(layout.tip_center())
        self._pads = torch.from_numpy(hand.pad_rotations.copy())
        self.geometry = torch.from_numpy(layout.geometry(hand)).float()

    def history(self, history: History) -> History:
        """Return what the hand felt, as the networks see it."""
        return History(
            joints=self.joints(history.joints),
            fingertips=self.points(history.fingertips),
            gravity=self.direction(history.gravity),
            tactile=self.taxels(history.tactile),
            tactile_missing=self.missing(history.tactile_missing),
            slow_loads=self.fingers(history.slow_loads),
            slow_fingertips=self.points(history.slow_fingertips),
            slow_missing=history.slow_missing,
            rotations=self.rotations(history.rotations),
            geometry=self.geometry.to(history.joints).expand(len(history.joints), -1, -1),
        )

    def direction(self, values: Tensor) -> Tensor:
        """Return vectors (..., 3) of the palm frame in the layout's."""
        return values @ self._axes.to(values)

    def fingers(self, values: Tensor) -> Tensor:
        """Return numbers of the fingers, (..., fingers), by slot; zero where there is none."""
        return self.spread(values, -1)

    def missing(self, fingers: Tensor) -> Tensor:
        """Return by slot which fingers, (..., fingers) bool, are missing: those, and where there is none."""
        return ~self.spread(~fingers, -1)

    def taxels(self, values: Tensor) -> Tensor:
        """Return numbers of the taxels, (..., fingers, along, across), by slot; zero where there is none."""
        return self.spread(values, -3)

    def vectors(self, values: Tensor) -> Tensor:
        """Return vectors of the fingers, palm frame (..., fingers, 3), in the layout; zero where none is."""
        return self.spread(values @ self._axes.to(values), -2)

    def points(self, values: Tensor) -> Tensor:
        """Return points of the fingers, palm frame (..., fingers, 3) [m], in the layout.

        An empty slot's is where its fingers have it in the middle of their range.
        """
        found = self._tip_center.to(values).expand(*values.shape[:-2], -1, -1).clone()
        found[..., self._slots, :] = (values - self._centre.to(values)) @ self._axes.to(values)
        return found

    def rotations(self, values: Tensor) -> Tensor:
        """Return orientations of distal links (..., fingers, 3, 3) as those of pads in the layout."""
        found = torch.eye(3).to(values).expand(*values.shape[:-3], self._fingers, 3, 3).clone()
        found[..., self._slots, :, :] = self._axes.T.to(values) @ values @ self._pads.to(values)
        return found

    def joints(self, values: Tensor) -> Tensor:
        """Return joints (..., joints) [rad] as distances from the middle of their range, zero of none."""
        found = values.new_zeros(*values.shape[:-1], self._joints)
        found[..., self._joint_slots] = values - self._joint_center.to(values)
        return found

    def own(self, values: Tensor) -> Tensor:
        """Return numbers of the slots, (..., slots), of this hand's fingers."""
        return values[..., self._slots]

    def own_vectors(self, values: Tensor) -> Tensor:
        """Return vectors of the slots, (..., slots, 3), of this hand's fingers in its palm frame."""
        return values[..., self._slots, :] @ self._axes.T.to(values)

    def own_local(self, values: Tensor) -> Tensor:
        """Return vectors (..., slots, 3) in the frames of `rotations` in those of the distal links."""
        return (self._pads.to(values) @ values[..., self._slots, :, None]).squeeze(-1)

    def spread(self, values: Tensor, axis: int) -> Tensor:
        """Return numbers of the fingers, which stand along an axis, by slot; zero where there is none."""
        shape = list(values.shape)
        shape[axis] = self._fingers
        return values.new_zeros(shape).index_copy(axis, self._slots.to(values.device), values)


@cache
def view_of(layout: SharedLayout, hand: Hand) -> View:
    """Return how a layout sees one of its hands; made once."""
    return View(layout, hand)
