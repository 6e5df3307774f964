"""Compile numeric loops with numba."""

from collections.abc import Callable
from typing import cast

import numba


def compiled[F: Callable](function: F) -> F:
    """Compile a function at its first call, and keep the machine code for later processes.

    It is kept in `__pycache__` or in the user's cache folder. Where neither can be written to, as in a
    read-only container, every process compiles for itself, which takes it about four seconds.
    """
    try:
        return cast(F, numba.njit(cache=True)(function))
    except RuntimeError:  # Numba found no folder that it may write to.
        return cast(F, numba.njit(function))
