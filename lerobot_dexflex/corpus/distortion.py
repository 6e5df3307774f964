"""Bad drafts with breaks, and an unsteady grip: they bring the hand off its way, labels show the way back."""

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.families import NO_ERRORS, CommandError, CommandErrors
from lerobot_dexflex.commands.stream import ErrorStream
from lerobot_dexflex.experts.reach.sensing import HandState
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

_CLEAN_SHARE = 0.15
_STRETCH = (6, 25)
"""Control steps of a stretch, the upper end excluded."""
_STRENGTHS = {
    "noise": (0.0005, 0.004),
    "scale": (0.4, 1.8),
    "delay": (1, 4),
    "removal": (0.001, 0.004),
    "bias": (0.0003, 0.002),
}
"""Range of every family: [m], [1], [control steps], [m] per step, [m]."""
_SHARES = (0.2, 0.1, 0.1, 0.5, 0.1)
"""Removals most: they alone take a contact away."""
_TWO_SHARE = 0.3
"""How often two families come together, as people's errors do."""


def sample_errors(
    rng: np.random.Generator, clean_share: float = _CLEAN_SHARE, even: bool = False
) -> CommandErrors:
    """Draw families and their strengths; a share stays clean.

    Args:
        rng: Source of randomness.
        clean_share: How often nothing goes wrong.
        even: Whether all families are as likely, one at a time; else as in the corpus, sometimes two.
    """
    if rng.random() < clean_share:
        return NO_ERRORS
    count = 2 if not even and rng.random() < _TWO_SHARE else 1
    families = rng.choice(list(_STRENGTHS), count, replace=False, p=None if even else _SHARES)
    return CommandErrors(tuple(_draw_strength(str(family), rng) for family in sorted(families)))


def _draw_strength(family: str, rng: np.random.Generator) -> CommandError:
    low, high = _STRENGTHS[family]
    strength = float(rng.integers(low, high + 1)) if family == "delay" else float(rng.uniform(low, high))
    return CommandError(family, strength)


_LARGEST_UNSTEADINESS, _STEADINESS = 0.5, 0.8
"""Size of a grip's errors, of the forces themselves, and their correlation from step to step."""


class UnsteadyGrip:
    """Errors of the executed forces as a learner would make them (DART, Laskey et al. 2017).

    Args:
        hand: Whose grip.
        rng: Source of randomness, of their size, too.
    """

    def __init__(self, hand: Hand, rng: np.random.Generator) -> None:
        self._rng = rng
        self._size = float(rng.uniform(0, _LARGEST_UNSTEADINESS))
        self._direction = rng.normal(size=(hand.n_fingers, 3))

    def step(self, grip: Array) -> Array:
        """Return what is added to the forces of a grip [N] in this control step. Shapes (fingers, 3)."""
        rest = np.sqrt(1 - _STEADINESS**2)
        self._direction = _STEADINESS * self._direction + rest * self._rng.normal(size=self._direction.shape)
        return self._size / np.sqrt(3) * np.linalg.norm(grip, axis=1, keepdims=True) * self._direction


class Distortion:
    """Spoil an operator's drafts and say when they are to be executed.

    Args:
        hand: Whose drafts.
        errors: What happens to the drafts.
        rng: Source of randomness, of everything in the episode.
    """

    def __init__(self, hand: Hand, errors: CommandErrors, rng: np.random.Generator) -> None:
        self._stream, self._rng = ErrorStream(hand, 1), rng
        self._stream.begin(0, errors, [rng for _ in errors])
        self._active, self._left = False, int(rng.integers(*_STRETCH))

    def step(self, plan: Array, now: HandState) -> tuple[Array, bool]:
        """Return the spoilt draft [m] (8, fingers, 3) and whether it, not the operator's own, is executed."""
        if self._left == 0:
            self._active, self._left = not self._active, int(self._rng.integers(*_STRETCH))
        self._left -= 1
        motion, tips, loads, inward = (
            torch.from_numpy(np.array([part])) for part in (plan, now.tips, now.loads, now.inward)
        )
        here = tips[:, None]
        draft = self._stream.delayed(here + motion) - here
        return self._stream.step(draft, tips, loads, inward)[0].numpy(), self._active
