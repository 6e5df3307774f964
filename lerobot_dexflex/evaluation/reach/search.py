"""Random search over `press`, the hand-written grip: every trial draws all its settings at once.

A quadratic model of the progress then says what each of them is worth. Thousands of noisy episodes that vary
everything tell more than a few settings measured well: no episode is spent on one question alone. Training
objects and goals that nobody tried, so neither tuning nor test objects are touched.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import statsmodels.api as sm
from numpy.typing import NDArray

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.loop import run_chains
from lerobot_dexflex.commands.source import SOURCES as SOURCES
from lerobot_dexflex.commands.source import Source
from lerobot_dexflex.corpus.distortion import sample_errors
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.chain_book import ChainBook
from lerobot_dexflex.experts.reach.chains import Chain
from lerobot_dexflex.hands import Hand, get_hand
from lerobot_dexflex.interfaces.press import PressInterface, make_press
from lerobot_dexflex.runs.jobs import Job, run_missing
from lerobot_dexflex.runs.provenance import method_version
from lerobot_dexflex.runs.table import Row

RANGES = {
    "force": (0.5, 6.0),
    "release": (0.0, 0.02),
    "servo": (0.0, 3e-4),
    "back": (0.0, 1.5e-3),
    "limit": (0.002, 0.02),
    "gain": (0.4, 1.0),
    "blocked": (0.0, 1.0),
}
"""Where every option of `press` and its gain of the motion are drawn, uniformly; of a switch, both ends."""
SWITCHES = ("blocked",)
CLEAN_SHARE = 0.2
"""Of episodes in which nothing goes wrong; the others meet every family as often."""
TRAINING_SEED = 1000
"""First seed of the chains: an object of the corpus's training split."""
TASK, METHOD, TABLE = "Reach-v0", "press", "search.csv"
COLUMNS = ("source", "errors", "progress", "dropped", *RANGES)
"""Of a row. Every episode draws its own errors; the condition numbers the trial."""
_TRIAL = "trial-"
BATCH = 16
"""Episodes of one trial."""
_LEAST = 320


class Trial(NamedTuple):
    """Settings, and the episodes on which they are tried."""

    settings: dict[str, float]
    """By the keys of `RANGES`."""
    source: Source
    """What the drafts say."""
    seeds: tuple[int, ...]
    """Of the chains."""
    errors: tuple[CommandErrors, ...]
    """What goes wrong with the drafts, one for each chain."""

    def make(self, hand: Hand) -> PressInterface:
        """Build the interface for a hand."""
        options: dict[str, Any] = {name: value for name, value in self.settings.items() if name != "gain"}
        interface = make_press(hand, **options | {name: bool(options[name]) for name in SWITCHES})
        interface.gain = self.settings["gain"]
        return interface


@dataclass(frozen=True)
class Search:
    """What to run.

    Args:
        output: Folder of the table, which a later call continues.
        chains: Folder of goal chains, built where missing.
        n_chains: Starts that the trials draw from.
        hand: Name of the hand.
    """

    output: Path
    chains: Path
    n_chains: int = 250
    hand: str = "leap"

    @property
    def book(self) -> ChainBook:
        """The chains."""
        return ChainBook(get_hand(self.hand), self.chains, TRAINING_SEED)

    def jobs(self, trials: int, version: str) -> list[Job]:
        """Return the first trials as jobs, each a condition of its own; the chains must have been built."""
        seeds = list(_chains(self))
        return [
            Job(METHOD, version, TASK, f"{_TRIAL}{number}", draw_trial(number, seeds).seeds)
            for number in range(trials)
        ]

    def run_job(self, job: Job) -> list[Row]:
        """Run a batch of episodes with the settings of a trial."""
        hand, chains = get_hand(self.hand), _chains(self)
        number = int(job.condition.removeprefix(_TRIAL))
        trial = draw_trial(number, list(chains))
        chosen = [chains[seed] for seed in trial.seeds]
        episodes = run_chains(
            chosen, trial.errors, trial.make(hand), source=trial.source, seed=number, batch=BATCH
        )
        return [
            {
                "source": trial.source,
                "errors": errors.name,
                "progress": round(float(episode.progress), 4),
                "dropped": bool(episode.dropped),
                **{name: float(f"{value:.4g}") for name, value in trial.settings.items()},
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
    settings = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
    settings |= {name: float(settings[name] > 0.5) for name in SWITCHES}
    chosen = rng.choice(len(seeds), min(BATCH, len(seeds)), replace=False)
    errors = tuple(sample_errors(rng, CLEAN_SHARE, even=True) for _ in chosen)
    return Trial(settings, SOURCES[number % len(SOURCES)], tuple(seeds[k] for k in chosen), errors)


def run_search(search: Search, trials: int, workers: int, quiet: bool = False) -> pd.DataFrame:
    """Run the trials that are missing and return the rows of the first `trials`.

    Args:
        search: What to run.
        trials: How many settings to draw; the n-th is always the same.
        workers: Worker processes; 0 works in this one.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If another process works in a folder.
    """
    version = method_version(
        (__name__, PressInterface.__module__, TASKS[TASK].module),
        batch=BATCH,
        n_chains=search.n_chains,
        hand=get_hand(search.hand).signature,
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
    """Where the model is highest within the range, in the setting's unit."""


def fit(rows: pd.DataFrame) -> list[Effect]:
    """Fit progress = source and family + sum of quadratics, by least squares.

    Args:
        rows: From `run_search`, or those of one source.

    Raises:
        DexFlexError: If there are too few episodes to tell settings apart.
    """
    if len(rows) < _LEAST:
        raise DexFlexError(f"{len(rows)} episodes cannot tell the settings apart; run {_LEAST} or more.")
    groups = pd.get_dummies(rows["source"] + rows["errors"].str.partition("_")[0]).to_numpy(float)
    unit = _unit(rows)
    bends = [k for k, name in enumerate(RANGES) if name not in SWITCHES]  # A switch has no middle.
    model = sm.OLS(rows["progress"].to_numpy(float), np.hstack([groups, unit, unit[:, bends] ** 2])).fit()
    slopes = model.params[groups.shape[1] :][: len(RANGES)]
    curved = dict(zip(bends, model.params[groups.shape[1] + len(RANGES) :], strict=True))
    errors = model.bse[groups.shape[1] :]
    grid = np.linspace(-1, 1, 201)
    effects = []
    for k, (name, (low, high)) in enumerate(RANGES.items()):
        top = grid[np.argmax(slopes[k] * grid + curved.get(k, 0.0) * grid**2)]
        best = low + (top + 1) / 2 * (high - low)
        effects.append(Effect(name, float(slopes[k]), float(errors[k]), float(best)))
    return effects


def _unit(rows: pd.DataFrame) -> NDArray[np.float64]:
    """Return the settings as numbers in [-1, 1]. Shape (N, len(RANGES))."""
    low, high = np.array(list(RANGES.values())).T
    return 2 * (rows[list(RANGES)].to_numpy(float) - low) / (high - low) - 1


@functools.cache
def _chains(search: Search) -> dict[int, Chain]:
    """Return the chains by their seeds, in order."""
    return {chain.seed: chain for chain in search.book.load(search.n_chains)}
