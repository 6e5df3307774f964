"""Random search over the contact projection: every trial draws all its gains and limits at once.

A quadratic model of the progress then says what each of them is worth. Thousands of noisy episodes that vary
everything tell more than a few settings measured well: no episode is spent on one question alone. Training
objects and goals that the operator never tried, so neither tuning nor test objects are touched.
"""

import functools
from collections.abc import Hashable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray

from lerobot_dexflex.commands.loop import run_chains
from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.controller.settings import ProjectionSettings
from lerobot_dexflex.corpus.distortion import sample_corruption
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.provenance import environment_identity
from lerobot_dexflex.evaluation.reach.chain_book import ChainBook
from lerobot_dexflex.evaluation.store import Store
from lerobot_dexflex.evaluation.whole_jobs import WholeJob, run_missing
from lerobot_dexflex.experts.reach.chains import Chain
from lerobot_dexflex.interfaces.controller_folder import find_controller
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface
from lerobot_dexflex.interfaces.learned import shared_controller
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.provenance import weights_digest

RANGES = {
    "gain": (0.3, 1.2),
    "free_gain": (0.1, 1.0),
    "internal_gain": (0.0, 0.8),
    "closing_gain": (0.0, 1.2),
    "opening_load": (0.0, 4.0),
    "speed": (5e-4, 4e-3),
    "squeeze_gain": (0.0, 2e-4),
    "preload": (0.5, 6.0),
    "return_speed": (0.0, 2.5e-3),
}
"""Where every field of `ProjectionSettings` is drawn, uniformly."""
TRAINING_SEED = 1000
"""First seed of the chains: an object of the corpus's training split."""
CLEAN_SHARE = 0.2
BATCH = 16
"""Episodes of one trial."""
_LEAST = 320


@dataclass(frozen=True)
class Trial(WholeJob):
    """Settings and what a batch of episodes did with them."""

    number: int
    settings: dict[str, float]
    """Of `ProjectionSettings`."""
    chains: list[int]
    """Seeds of the chains."""
    corruptions: list[str]
    progress: list[float]
    dropped: list[bool]

    @property
    def job(self) -> Hashable:
        """What was run together."""
        return self.number


@dataclass(frozen=True)
class Search:
    """What to run.

    Args:
        output: Folder of the trials, which a later call continues.
        chains: Folder of goal chains, built where missing.
        n_chains: Starts that the trials draw from.
        controller: Folder of a controller; the shipped one if None. Its networks choose nothing here.
    """

    output: Path
    chains: Path
    n_chains: int = 250
    controller: Path | None = None

    @property
    def book(self) -> ChainBook:
        """The chains."""
        return ChainBook(self.chains / f"unverified_{TRAINING_SEED}.jsonl", TRAINING_SEED, verified=False)

    def identity(self) -> dict[str, Any]:
        """Return what every trial depends on."""
        weights = weights_digest(Method.parse("dexflex").weights(self.controller))
        names = {"chains": self.n_chains, "controller": weights}
        return names | environment_identity()


def run_search(search: Search, trials: int, workers: int, quiet: bool = False) -> list[Trial]:
    """Run the trials that are missing and return the first `trials`.

    Args:
        search: What to run.
        trials: How many settings to draw; the n-th is always the same.
        workers: Worker processes; 0 works in this one.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If the output folder holds trials of other settings or code.
    """
    search.book.ensure(search.n_chains, workers, quiet)
    store = Store(search.output, search.identity(), Trial.parse)
    job = functools.partial(run_trial, search)
    return run_missing(store, range(trials), job, BATCH, workers, quiet)


def run_trial(search: Search, number: int) -> Trial:
    """Draw settings and run a batch of episodes with them."""
    rng = np.random.default_rng((number, 17))
    settings = ProjectionSettings(**{key: float(rng.uniform(*ends)) for key, ends in RANGES.items()})
    chains = _chains(search)
    chosen = [chains[k] for k in rng.choice(len(chains), min(BATCH, len(chains)), replace=False)]
    corruptions = [sample_corruption(rng, CLEAN_SHARE) for _ in chosen]
    only = SelectionSettings(
        n_pure=0, n_seeded=0, include_draft=False, projection=settings, use_residual=False
    )
    interface = DexFlexInterface(shared_controller(find_controller(search.controller)), only)
    episodes = run_chains(chosen, corruptions, interface, seed=number, batch=BATCH)
    return Trial(
        number=number,
        settings=asdict(settings),
        chains=[episode.chain.seed for episode in episodes],
        corruptions=[episode.corruption.name for episode in episodes],
        progress=[float(episode.progress) for episode in episodes],
        dropped=[bool(episode.dropped) for episode in episodes],
    )


@dataclass(frozen=True)
class Effect:
    """What one setting is worth, all others drawn at random."""

    name: str
    slope: float
    """Change of the progress from the middle of the range to its end, linear part."""
    error: float
    """Its standard error."""
    best: float
    """Where the quadratic is highest within the range, in the setting's unit."""


def fit(trials: list[Trial]) -> list[Effect]:
    """Fit progress = family + sum of quadratics, by least squares.

    Args:
        trials: From `run_search`.

    Raises:
        DexFlexError: If there are too few episodes to tell settings apart.
    """
    if (found := sum(len(trial.progress) for trial in trials)) < _LEAST:
        raise DexFlexError(f"{found} episodes cannot tell the settings apart; run {_LEAST} or more.")
    unit = np.array([_unit(trial.settings) for trial in trials for _ in trial.progress])
    families = [name.partition("_")[0] for trial in trials for name in trial.corruptions]
    dummies = np.array([[name == other for other in sorted(set(families))] for name in families], float)
    progress = np.concatenate([trial.progress for trial in trials])
    model = sm.OLS(progress, np.hstack([dummies, unit, unit**2])).fit()
    first, count = dummies.shape[1], len(RANGES)
    grid = np.linspace(-1, 1, 201)
    effects = []
    for k, (name, (low, high)) in enumerate(RANGES.items()):
        slope, bend = model.params[first + k], model.params[first + count + k]
        top = grid[np.argmax(slope * grid + bend * grid**2)]
        best = low + (top + 1) / 2 * (high - low)
        effects.append(Effect(name, float(slope), float(model.bse[first + k]), float(best)))
    return effects


def _unit(settings: dict[str, float]) -> NDArray[np.float64]:
    """Return settings as numbers in [-1, 1]."""
    return np.array([2 * (settings[key] - low) / (high - low) - 1 for key, (low, high) in RANGES.items()])


@functools.cache
def _chains(search: Search) -> list[Chain]:
    return search.book.load(search.n_chains)
