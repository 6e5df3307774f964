"""Random search over the contact projection: every trial draws all its gains and limits at once.

A quadratic model of the progress then says what each of them is worth. Thousands of noisy episodes that vary
everything tell more than a few settings measured well: no episode is spent on one question alone. Training
objects and goals that the operator never tried, so neither tuning nor test objects are touched.
"""

import functools
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import statsmodels.api as sm
from numpy.typing import NDArray

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.loop import run_chains
from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.controller.settings import ProjectionSettings
from lerobot_dexflex.corpus.distortion import sample_errors
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.chain_book import ChainBook
from lerobot_dexflex.experts.reach.chains import Chain
from lerobot_dexflex.interfaces.controller_folder import find_controller
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface
from lerobot_dexflex.interfaces.learned import shared_controller
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.jobs import Job, run_missing
from lerobot_dexflex.runs.provenance import method_version
from lerobot_dexflex.runs.table import Row

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
TASK, METHOD, TABLE = "Reach-v0", "projection", "search.csv"
COLUMNS = ("errors", "progress", "dropped", *RANGES)
"""Of a row. Every episode draws its own errors, as the corpus does; the condition numbers the trial."""
_TRIAL = "trial-"
CLEAN_SHARE = 0.2
BATCH = 16
"""Episodes of one trial."""
_LEAST = 320


class Trial(NamedTuple):
    """Settings, and the episodes on which they are tried."""

    settings: ProjectionSettings
    seeds: tuple[int, ...]
    """Of the chains."""
    errors: tuple[CommandErrors, ...]
    """What goes wrong with the commands, one for each chain."""


@dataclass(frozen=True)
class Search:
    """What to run.

    Args:
        output: Folder of the table, which a later call continues.
        chains: Folder of goal chains, built where missing.
        n_chains: Starts that the trials draw from.
        controller: Folder or hub id of a controller; the shipped one if empty. Its networks choose nothing
            here.
    """

    output: Path
    chains: Path
    n_chains: int = 250
    controller: str = ""

    @property
    def book(self) -> ChainBook:
        """The chains."""
        return ChainBook(self.chains / f"unverified_{TRAINING_SEED}.jsonl", TRAINING_SEED, verified=False)

    def jobs(self, trials: int, version: str) -> list[Job]:
        """Return the first trials as jobs, each a condition of its own; the chains must have been built."""
        seeds = list(_chains(self))
        return [
            Job(METHOD, version, TASK, f"{_TRIAL}{number}", draw_trial(number, seeds).seeds)
            for number in range(trials)
        ]

    def run_job(self, job: Job) -> list[Row]:
        """Run a batch of episodes with the settings of a trial."""
        chains = _chains(self)
        number = int(job.condition.removeprefix(_TRIAL))
        trial = draw_trial(number, list(chains))
        only = SelectionSettings(
            n_pure=0, n_seeded=0, include_draft=False, projection=trial.settings, use_residual=False
        )
        interface = DexFlexInterface(shared_controller(find_controller(self.controller)), only)
        chosen = [chains[seed] for seed in trial.seeds]
        episodes = run_chains(chosen, trial.errors, interface, seed=number, batch=BATCH)
        settings = asdict(trial.settings)
        return [
            {
                "errors": errors.name,
                "progress": round(float(episode.progress), 4),
                "dropped": bool(episode.dropped),
                **{name: float(f"{settings[name]:.4g}") for name in RANGES},
            }
            for errors, episode in zip(trial.errors, episodes, strict=True)
        ]


def draw_trial(number: int, seeds: Sequence[int]) -> Trial:
    """Return the trial of a number, always the same.

    Args:
        number: Of the trial.
        seeds: Of the chains, to draw from.
    """
    rng = np.random.default_rng((number, 17))
    settings = ProjectionSettings(**{key: float(rng.uniform(*ends)) for key, ends in RANGES.items()})
    chosen = rng.choice(len(seeds), min(BATCH, len(seeds)), replace=False)
    errors = tuple(sample_errors(rng, CLEAN_SHARE) for _ in chosen)
    return Trial(settings, tuple(seeds[k] for k in chosen), errors)


def run_search(search: Search, trials: int, workers: int, quiet: bool = False) -> pd.DataFrame:
    """Run the trials that are missing and return the rows of the first `trials`.

    Args:
        search: What to run.
        trials: How many settings to draw; the n-th is always the same.
        workers: Worker processes; 0 works in this one.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If there is no controller, or another process works in a folder.
    """
    version = method_version(
        (__name__, DexFlexInterface.__module__, TASKS[TASK].module),
        Method.parse("dexflex").weights(search.controller),
        batch=BATCH,
        n_chains=search.n_chains,
    )
    search.book.ensure(search.n_chains, workers, quiet)
    jobs = search.jobs(trials, version.name)
    path = search.output / TABLE
    return run_missing(path, COLUMNS, jobs, [version], search.run_job, workers, quiet)


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


def fit(rows: pd.DataFrame) -> list[Effect]:
    """Fit progress = family + sum of quadratics, by least squares.

    Args:
        rows: From `run_search`.

    Raises:
        DexFlexError: If there are too few episodes to tell settings apart.
    """
    if len(rows) < _LEAST:
        raise DexFlexError(f"{len(rows)} episodes cannot tell the settings apart; run {_LEAST} or more.")
    dummies = pd.get_dummies(rows["errors"].str.partition("_")[0]).to_numpy(float)
    unit = _unit(rows)
    model = sm.OLS(rows["progress"].to_numpy(float), np.hstack([dummies, unit, unit**2])).fit()
    first, count = dummies.shape[1], len(RANGES)
    grid = np.linspace(-1, 1, 201)
    effects = []
    for k, (name, (low, high)) in enumerate(RANGES.items()):
        slope, bend = model.params[first + k], model.params[first + count + k]
        top = grid[np.argmax(slope * grid + bend * grid**2)]
        best = low + (top + 1) / 2 * (high - low)
        effects.append(Effect(name, float(slope), float(model.bse[first + k]), float(best)))
    return effects


def _unit(rows: pd.DataFrame) -> NDArray[np.float64]:
    """Return the settings as numbers in [-1, 1]. Shape (N, len(RANGES))."""
    low, high = np.array(list(RANGES.values())).T
    return 2 * (rows[list(RANGES)].to_numpy(float) - low) / (high - low) - 1


@functools.cache
def _chains(search: Search) -> dict[int, Chain]:
    """Return the chains by their seeds, in order."""
    return {chain.seed: chain for chain in search.book.load(search.n_chains)}
