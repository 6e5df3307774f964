"""What several trainings of the policies say together: one table of rows for each, with the same episodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.summary import PairTest, Summary, newest, summarise, times
from lerobot_dexflex.runs.statistics import Mean, median_time, two_level_interval
from lerobot_dexflex.runs.table import read

TRAINING = "training"
"""Column of the number of the training."""
_CELL = ["method", "task", "condition"]
_NAMED = 3
"""So many missing cells an error names."""


class MethodOverTrainings(NamedTuple):
    """A method, over all tasks and trainings; intervals are two-level, see `two_level_interval`."""

    name: str
    success: tuple[float, ...]
    """Average over the tasks of each training [%]."""
    time: Mean
    """Restricted mean time to success [s]: an episode that fails counts as the task's limit."""
    median: float | None
    """Kaplan-Meier median of the time to success [s]; None if fewer than half succeed."""
    holding: Mean | None
    """Share of steps with the object held; None if a task does not report it."""
    drops: Mean | None
    """Per episode; None if a task does not report them."""


class PairOverTrainings(NamedTuple):
    """Two methods on the same episodes of the same trainings."""

    test: PairTest
    """On all paired episodes: what holds for these trainings."""
    gain: Mean
    """Average over the tasks of the success of second - first [% points], with its two-level interval: what
    holds for trainings of their kind."""
    each: tuple[float, ...]
    """The same of each training."""


@dataclass(frozen=True)
class OverTrainings:
    """What a table of methods tells over trainings."""

    summary: Summary
    """Of all rollouts, its tests paired by task, condition, seed and training."""
    names: tuple[str, ...]
    """Of the trainings."""
    methods: tuple[MethodOverTrainings, ...]
    pairs: tuple[PairOverTrainings, ...]


def read_trainings(paths: Sequence[Path]) -> dict[str, pd.DataFrame]:
    """Return the newest rows of every training by its file's name, in the order given.

    Args:
        paths: A table of `runs.table` for each training.

    Raises:
        DexFlexError: If a file is missing or damaged.
    """
    return {path.name: newest(read(path)) for path in paths}


def pool(trainings: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of all trainings, with the column `TRAINING`.

    Args:
        trainings: Rows of each training by its name, those of one version per method, task and condition.

    Raises:
        DexFlexError: If there are none, one lacks episodes that another has, or two hold the same version of
            a method and are thus no two trainings.
    """
    if not trainings:
        raise DexFlexError("Rows of at least one training are needed. Got none.")
    rows = pd.concat(
        [table.assign(**{TRAINING: k}) for k, table in enumerate(trainings.values())], ignore_index=True
    )
    names = list(trainings)
    everything = rows[[*_CELL, "seed"]].drop_duplicates()
    for k, name in enumerate(names):
        _check_complete(name, rows.loc[rows[TRAINING] == k], everything)
    versions = rows[[*_CELL, "version", TRAINING]].drop_duplicates()
    twice = versions.loc[versions.duplicated([*_CELL, "version"], keep=False)]
    if not twice.empty:
        first = twice.loc[(twice[[*_CELL, "version"]] == twice.iloc[0][[*_CELL, "version"]]).all(axis=1)]
        raise DexFlexError(
            f"{' and '.join(names[k] for k in first[TRAINING])} hold the same version "
            f"{first.iloc[0]['version']} of {_cell(first.iloc[0][_CELL].tolist())}: that is one training. "
            "Give the rows of each training once, and of methods that were trained."
        )
    return rows


def over_trainings(
    trainings: Mapping[str, pd.DataFrame],
    methods: Sequence[str],
    by: str = "task",
    columns: Sequence[str] = (),
    grew: frozenset[str] = frozenset(),
) -> OverTrainings:
    """Return what trainings say of methods together.

    Args:
        trainings: Rows of each training by its name; see `pool`. Those of other methods and columns are left
            out before the trainings are compared.
        methods: In the order of the table.
        by: What stands side by side: `task` or `condition`.
        columns: Tasks or conditions, in order; all that there are if empty.
        grew: Versions whose n grew after a look; see `summary.grown`.

    Raises:
        DexFlexError: If the trainings hold different episodes, a method has none, or an episode is longer
            than its task allows.
    """
    chosen = {
        name: rows.loc[rows["method"].isin(methods) & (rows[by].isin(columns) if columns else True)]
        for name, rows in trainings.items()
    }
    summary = summarise(pool(chosen), methods, by, columns, grew)
    return OverTrainings(
        summary,
        tuple(trainings),
        tuple(_method(summary, name) for name in methods),
        tuple(_pair(summary, test) for test in summary.tests),
    )


def _check_complete(name: str, rows: pd.DataFrame, everything: pd.DataFrame) -> None:
    merged = everything.merge(rows[[*_CELL, "seed"]], how="left", indicator="found")
    missing = merged.loc[merged["found"] == "left_only"]
    if missing.empty:
        return
    cells = []
    for cell, part in missing.groupby(_CELL, sort=False):
        wanted = int((everything[_CELL] == list(cell)).all(axis=1).sum())
        seeds = f"seeds {part['seed'].min()} to {part['seed'].max()}"
        cells.append(f"{_cell(list(cell))}: {len(part)} of {wanted} episodes, {seeds}")
    more = f"; and of {len(cells) - _NAMED} more cells" if len(cells) > _NAMED else ""
    raise DexFlexError(
        f"{name} lacks episodes that other trainings have, of {'; '.join(cells[:_NAMED])}{more}. Run them "
        "or leave out these methods, tasks or conditions."
    )


def _cell(cell: Sequence[object]) -> str:
    method, task, condition = cell
    return f"{method} in {task}, {condition}"


def _method(summary: Summary, name: str) -> MethodOverTrainings:
    rows = summary.of(name)
    rows = rows.assign(solved=100.0 * rows["success"].astype(bool), time=times(rows))
    return MethodOverTrainings(
        name,
        _of_each(_groups(rows, "solved")),
        two_level_interval(_groups(rows, "time")),
        median_time(rows["time"].tolist(), rows["success"].astype(bool).tolist()),
        _reported(rows, "holding"),
        _reported(rows, "drops"),
    )


def _pair(summary: Summary, test: PairTest) -> PairOverTrainings:
    rows = summary.pairs(test)
    second, first = (rows[f"success_{which}"].astype(float) for which in ("second", "first"))
    groups = _groups(rows.assign(gain=100 * (second - first)), "gain")
    return PairOverTrainings(test, two_level_interval(groups), _of_each(groups))


def _reported(rows: pd.DataFrame, column: str) -> Mean | None:
    return None if rows[column].isna().any() else two_level_interval(_groups(rows, column))


def _groups(rows: pd.DataFrame, column: str) -> list[NDArray[np.float64]]:
    """Return a column by task and condition, each of shape (trainings, episodes)."""
    return [
        part.pivot(index=TRAINING, columns="seed", values=column).to_numpy(float)
        for _, part in rows.groupby(["task", "condition"], sort=False)
    ]


def _of_each(groups: Sequence[NDArray[np.float64]]) -> tuple[float, ...]:
    return tuple(np.mean([group.mean(axis=1) for group in groups], axis=0).tolist())
