"""Draw the taxels of a hand as one small picture."""

import cv2
import numpy as np
from numpy.typing import NDArray

FULL_SCALE = 0.3
"""Force of the brightest colour [N]: a firm precision grasp puts 0.02-0.3 N on a loaded taxel."""


def touch_strip(
    taxels: NDArray[np.floating], full_scale: float = FULL_SCALE, cell: int = 8, gap: int = 4
) -> NDArray[np.uint8]:
    """Draw four pads side by side, index, middle, ring, thumb, each with its tip up.

    The colour scale is fixed, so that frames of a video can be compared.

    Args:
        taxels: Taxel forces. Shape (4, 10, 6) or (240,), [N].
        full_scale: Force of the brightest colour [N]; larger forces look the same.
        cell: Side of one taxel in pixels.
        gap: Width of the grey line between two pads in pixels.

    Returns:
        RGB image. Shape (10 * cell, 24 * cell + 3 * gap, 3): (80, 204, 3) by default.
    """
    pads = np.asarray(taxels).reshape(4, 10, 6)[:, ::-1]
    shades = np.clip(pads / full_scale * 255 + 0.5, 0, 255).astype(np.uint8)
    large = [cv2.resize(s, None, fx=cell, fy=cell, interpolation=cv2.INTER_NEAREST) for s in shades]
    colours = [cv2.cvtColor(cv2.applyColorMap(s, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB) for s in large]
    framed = [cv2.copyMakeBorder(c, 0, 0, 0, gap, cv2.BORDER_CONSTANT, value=[128] * 3) for c in colours[:-1]]
    return cv2.hconcat([*framed, colours[-1]]).astype(np.uint8)
