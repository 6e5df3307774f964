"""Draw the taxels of a hand as one small picture."""

import cv2
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hands import Hand

FULL_SCALE = 0.3
"""Force of the brightest colour [N]: a firm precision grasp puts 0.02-0.3 N on a loaded taxel."""


def touch_strip(
    hand: Hand, taxels: NDArray[np.floating], full_scale: float = FULL_SCALE, cell: int = 8, gap: int = 4
) -> NDArray[np.uint8]:
    """Draw the pads of all fingers side by side, each with its tip up.

    The colour scale is fixed, so that frames of a video can be compared.

    Args:
        hand: Whose pads.
        taxels: Taxel forces. Shape (fingers, along, across) or as one vector, [N].
        full_scale: Force of the brightest colour [N]; larger forces look the same.
        cell: Side of one taxel in pixels.
        gap: Width of the grey line between two pads in pixels.

    Returns:
        RGB image. Shape (along * cell, fingers * across * cell + (fingers - 1) * gap, 3).
    """
    pads = np.asarray(taxels).reshape(hand.n_fingers, *hand.taxels)[:, ::-1]
    shades = np.clip(pads / full_scale * 255 + 0.5, 0, 255).astype(np.uint8)
    large = [cv2.resize(s, None, fx=cell, fy=cell, interpolation=cv2.INTER_NEAREST) for s in shades]
    colours = [cv2.cvtColor(cv2.applyColorMap(s, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB) for s in large]
    framed = [cv2.copyMakeBorder(c, 0, 0, 0, gap, cv2.BORDER_CONSTANT, value=[128] * 3) for c in colours[:-1]]
    return cv2.hconcat([*framed, colours[-1]]).astype(np.uint8)
