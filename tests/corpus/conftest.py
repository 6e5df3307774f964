"""One grasp that holds, and a short recorded episode with jitter, pushes and a turning gravity."""

import numpy as np
import pytest

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.world import Push, Slip, World

SEED = 4
"""A capsule in a firm grasp of four fingers."""
STEPS = 40


class Jitter:
    """Lead the tips nowhere: every label is a small random displacement back to the first command."""

    def __init__(self, run, rng, steps=STEPS):
        self._start, self._rng, self._steps = run.command, rng, steps

    def label(self, run):
        if run.steps >= self._steps:
            return None
        return self._start - run.command + self._rng.normal(0, 2e-4, (4, 3))


@pytest.fixture(scope="session")
def episode():
    return CorpusEnv().draw(SEED)


@pytest.fixture
def world():
    return World(
        seed=3,
        gravity_rate=0.1,
        gains=tuple(np.linspace(0.9, 1.1, 16)),
        damping=1.2,
        pushes=[Push(5, 4, (0.0, 0.3, 0.2))],
        slips=[Slip(20, 6, 0.7)],
    )


@pytest.fixture
def run(episode, world):
    """An episode whose steps 8 to 15 are spoilt by 0.5 mm."""
    run = RunningEpisode(CorpusEnv(), episode, world, 1, {"seed": SEED, "commit": "none"})
    rng = np.random.default_rng(0)
    leader = Jitter(run, rng)
    while (label := leader.label(run)) is not None:
        draft = label + rng.uniform(-5e-4, 5e-4, (4, 3))
        run.step(draft, label, draft if 8 <= run.steps < 16 else label)
    return run
