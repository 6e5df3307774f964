"""Know when a hand holds nothing, or is to let go, so that it follows its draft as it came."""

import torch
from torch import Tensor

from lerobot_dexflex.hand.contacts import CONTACT_FORCE

EMPTY_STEPS = 8
"""A hand that has carried something is empty after so many control steps without load."""
LEAST_LEAD = 0.004
"""A finger is led outward, or inward, where the draft leads it so far along its pad's normal [m]."""
RELEASE, ALIKE = 0.008, 0.8
"""A release leads all fingers that carry load so far outward [m], and none of them less than this share of
the farthest."""
INSISTENCE = 0.016
"""Upstream that leads a single finger so far outward [m], again and again, wants it gone."""
INSISTING_STEPS = 10
"""How often in a row [control step]: an erroneous removal lasts 8."""


class FreeFingers:
    """Tell, row by row, which fingers are to follow their draft without candidates and without grip.

    A hand that feels nothing is free: there is nothing to keep. Of one that carries something a single finger
    led outward may be an error, which the controller refuses. But all that carry, led outward alike while the
    others are led outward too, are a release of the whole hand (where others stay it may be a removal, and
    one more finger on its way elsewhere); so are all that carry, led outward for ten steps. One finger that
    is led far outward for ten steps is free alone. Such fingers stay free until they are led inward, or touch
    something without being led outward. Touch that is not known may be touch of anything. Memories are never
    written in place.
    """

    def __init__(self) -> None:
        self._free: Tensor | None = None
        self._unloaded: Tensor | None = None
        self._together: Tensor | None = None
        self._insisted: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the rows in `mask`, shape (batch,) bool, or all."""
        if (
            mask is None
            or self._free is None
            or self._unloaded is None
            or self._together is None
            or self._insisted is None
        ):
            self._free = self._unloaded = self._together = self._insisted = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._free.device)
        self._free = self._free.masked_fill(mask[:, None], False)
        self._unloaded = self._unloaded.masked_fill(mask, EMPTY_STEPS)
        self._together = self._together.masked_fill(mask, 0)
        self._insisted = self._insisted.masked_fill(mask[:, None], 0)

    def look(self, draft: Tensor, loads: Tensor, inward: Tensor, late: Tensor) -> Tensor:
        """Return which fingers are free; call it once per control step. Shape (batch, fingers) bool.

        Args:
            draft: Where the fingertips should be, relative to where they are [m], palm frame. Shape
                (batch, horizon, fingers, 3).
            loads: Normal force of each fingertip [N]; NaN where it is not known. Shape (batch, fingers).
            inward: Normals of the pads, into what they touch, palm frame. Shape (batch, fingers, 3).
            late: Rows whose draft is what was left of an older one: nobody insists on it. Shape (batch,).
        """
        if self._free is None or self._unloaded is None or self._together is None or self._insisted is None:
            fingers = torch.zeros(loads.shape, dtype=torch.int64, device=loads.device)
            self._free, self._insisted, self._together = fingers.bool(), fingers, fingers[:, 0]
            self._unloaded = torch.full_like(self._together, EMPTY_STEPS)
        along = (draft * inward[:, None]).sum(-1)  # (batch, horizon, fingers)
        outward = -along.amin(1)
        led_outward, led_inward = outward >= LEAST_LEAD, along.amax(1) >= LEAST_LEAD
        led_inward = led_inward & ~led_outward
        carries, maybe = loads > CONTACT_FORCE, ~(loads <= CONTACT_FORCE)  # (batch, fingers); NaN: maybe.

        unloaded = torch.where(maybe.any(1), self._unloaded, self._unloaded + 1)
        self._unloaded = unloaded.masked_fill(carries.any(1), 0)
        empty = ~maybe.any(1) & (self._unloaded >= EMPTY_STEPS)

        together = (led_outward | ~maybe).all(1) & maybe.any(1)
        self._together = torch.where(late, self._together, (self._together + 1) * together)
        self._insisted = torch.where(
            late[:, None], self._insisted, (self._insisted + 1) * (outward >= INSISTENCE)
        )
        opens = _release(outward, maybe) & led_outward.all(1)
        released = opens | (self._together >= INSISTING_STEPS)
        asked = (released & ~late)[:, None] | (self._insisted >= INSISTING_STEPS)
        self._free = (self._free & (led_outward | ~maybe) | asked) & ~led_inward
        return self._free | empty[:, None]


def _release(outward: Tensor, carrying: Tensor) -> Tensor:
    """Return rows where two or more fingers carry and all that do are led outward alike. Shape (batch,)."""
    least = outward.masked_fill(~carrying, torch.inf).amin(1)
    most = outward.masked_fill(~carrying, -torch.inf).amax(1)
    return (carrying.sum(1) >= 2) & (least >= RELEASE) & (least >= ALIKE * most)
