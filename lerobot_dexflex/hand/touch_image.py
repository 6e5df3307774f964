"""Draw the taxels of a hand as one small picture."""

from functools import cache

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
    shade = np.clip(pads / full_scale * 255 + 0.5, 0, 255).astype(np.uint8)
    cells = _palette()[shade].repeat(cell, axis=1).repeat(cell, axis=2)  # (4, 10 cell, 6 cell, 3)
    line = np.full((cells.shape[1], gap, 3), 128, np.uint8)
    return np.concatenate([cells[0], line, cells[1], line, cells[2], line, cells[3]], axis=1)


@cache
def _palette() -> NDArray[np.uint8]:
    import matplotlib as mpl  # Only videos and reports need it.

    return (mpl.colormaps["inferno"](np.arange(256))[:, :3] * 255).astype(np.uint8)
