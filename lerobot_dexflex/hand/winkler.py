"""A Winkler foundation: a skin of independent springs, one per taxel, that shares out a known force."""

import numpy as np
from numpy.typing import NDArray


def winkler_loads(
    depths: NDArray[np.float64], forces: NDArray[np.float64], stiffness: float
) -> NDArray[np.float64]:
    """Solve sum_i k max(0, depth_i - offset) = force for the one offset, over the taxels inside the object.

    In closed form (water filling): with the depths in descending order, offset_n is the solution if the n
    deepest taxels carry everything; the right n is the last whose shallowest taxel still lies deeper than
    offset_n. A negative offset presses the object further in than the simulation did.

    Args:
        depths: Depth of each taxel inside the touching object, zero outside. Shape (pads, taxels), [m].
        forces: Normal force on each pad. Shape (pads,), [N].
        stiffness: Spring constant k under one taxel [N/m].

    Returns:
        Force on each taxel, never negative. Shape (pads, taxels), [N]. A row sums to its force if any of
        its taxels lies inside the object, and is meaningless otherwise.
    """
    ordered = -np.sort(-depths, axis=1)
    rank = np.arange(1, depths.shape[1] + 1)
    offsets = (np.cumsum(ordered, axis=1) - forces[:, None] / stiffness) / rank
    count = ((ordered > offsets) & (ordered > 0)).sum(axis=1)
    offset = offsets[np.arange(len(offsets)), count - 1]
    return stiffness * np.maximum(depths - offset[:, None], 0.0) * (depths > 0)


def blur_matrix(n: int, sigma: float) -> NDArray[np.float64]:
    """Return a Gaussian blur that is reflected at both ends. Shape (n, n), unitless.

    Rows and columns sum to one: force is conserved and a uniform load stays uniform.

    Args:
        n: Number of taxels.
        sigma: Standard deviation in taxels, small against `n`.
    """
    if sigma == 0:
        return np.eye(n)
    taxel = np.arange(n)
    sources = np.concatenate([-1 - taxel, taxel, 2 * n - 1 - taxel])
    kernel = np.exp(-0.5 * ((taxel[:, None] - sources) / sigma) ** 2).reshape(n, 3, n).sum(axis=1)
    return kernel / kernel.sum(axis=1, keepdims=True)
