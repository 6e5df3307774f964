"""From rows to rates with intervals, averages over tasks, and paired tests."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.letters import compact_letters
from lerobot_dexflex.runs.statistics import (
    SIGNIFICANT,
    Mean,
    Rate,
    holm,
    mean_interval,
    paired_e_value,
    paired_test,
    ratio_interval,
    success_rate,
)

AVERAGE = "average"
_EPISODE = ["task", "condition", "seed", "training"]
"""What the same episode has in common under every method; `training` where rows of several are pooled."""


class PairTest(NamedTuple):
    """Exact McNemar test of two methods on the episodes that both have run."""

    first: str
    second: str
    n_episodes: int
    only_first: int
    """Episodes that only the first of the two solved."""
    only_second: int
    p_value: float
    p_value_holm: float
    """Adjusted for all pairs of the table."""
    e_value: float | None
    """Evidence that stays valid where n grew after a look; None where it did not. See `paired_e_value`."""
    p_anytime_holm: float | None
    """min(1, 1 / e_value), adjusted likewise; None where n did not grow."""

    def concerns(self, method: str) -> bool:
        """Say whether a method is one of the two; an empty name asks for any."""
        return not method or method in (self.first, self.second)


@dataclass(frozen=True)
class Summary:
    """What a table of methods tells."""

    rows: pd.DataFrame
    """The episodes, and nothing else."""
    methods: tuple[str, ...]
    columns: tuple[str, ...]
    """Tasks, or conditions; with more than one, also their `AVERAGE`."""
    rates: dict[tuple[str, str], Rate]
    """By method and column; missing where there are no episodes, or no equal numbers to average over."""
    tests: tuple[PairTest, ...]

    def of(self, method: str) -> pd.DataFrame:
        """Return the episodes of a method, in the order of tasks, conditions and seeds."""
        episodes = self.rows.loc[self.rows["method"] == method]
        return episodes.sort_values(by=_keys(episodes), kind="stable")

    def mean(self, method: str, metric: str) -> Mean | None:
        """Return the mean of a column over the episodes of a method for which it is known.

        `completion_time` [s] is that of the successes, `limited_time` [s] that of all episodes; see `times`.
        """
        episodes = self.of(method)
        if metric == "completion_time":
            episodes, metric = episodes.loc[episodes["success"].astype(bool)], "seconds"
        elif metric == "limited_time":
            episodes = episodes.assign(limited_time=times(episodes))
        elif metric not in episodes:
            return None
        return mean_interval(episodes[metric].dropna().astype(float).tolist())

    def ratio(self, method: str, first: str, second: str) -> Mean | None:
        """Return the ratio of two columns' means, over the episodes of a method for which both are known."""
        episodes = self.of(method)
        if not {first, second} <= set(episodes):
            return None
        both = episodes[[first, second]].dropna().astype(float)
        return ratio_interval(both[first].tolist(), both[second].tolist())

    def progress_gain(self, test: PairTest) -> Mean | None:
        """Return the mean of second - first over the episodes that both have run."""
        pair = self.pairs(test)
        return mean_interval((pair["progress_second"] - pair["progress_first"]).tolist())

    def pairs(self, test: PairTest) -> pd.DataFrame:
        """Return the episodes of a test, a row each, with columns `..._first` and `..._second`."""
        return _paired(self.of(test.first), self.of(test.second))

    @property
    def letters(self) -> dict[str, str]:
        """Letters of every method, `a` for the most successful; who shares one does not differ significantly.

        Empty if there is one method, or a pair that shares no episode and thus was not tested.
        """
        n = len(self.methods)
        if n < 2 or len(self.tests) < n * (n - 1) // 2:
            return {}
        ranked = sorted(self.methods, key=lambda name: -self._average(name))
        differing = [(t.first, t.second) for t in self.tests if t.p_value_holm < SIGNIFICANT]
        return compact_letters(ranked, differing)

    def _average(self, method: str) -> float:
        found = [r.pc_success for (m, column), r in self.rates.items() if m == method and column != AVERAGE]
        return sum(found) / len(found)

    @property
    def counts(self) -> tuple[int, ...]:
        """Different numbers of episodes in the cells, ascending; averages left out."""
        return tuple(sorted({r.n_episodes for (_, column), r in self.rates.items() if column != AVERAGE}))


def newest(rows: pd.DataFrame) -> pd.DataFrame:
    """Return of each method, task and condition the rows of the version that was appended last."""
    group = ["method", "task", "condition"]
    last = rows.groupby(group, sort=False)["version"].transform("last")
    return rows.loc[rows["version"] == last]


def grown(origins: pd.DataFrame) -> frozenset[str]:
    """Return the versions of `runs.csv` whose rows come from more than one command: n may have grown."""
    distinct = origins.fillna("").drop_duplicates(["version", "method", "command", "commit"])
    again = distinct.duplicated(["version", "method"])
    return frozenset(distinct.loc[again, "version"])


def summarise(
    rows: pd.DataFrame,
    methods: Sequence[str],
    by: str = "task",
    columns: Sequence[str] = (),
    grew: frozenset[str] = frozenset(),
) -> Summary:
    """Return rates, means and tests of methods.

    Args:
        rows: Episodes; those of other methods and columns are left out.
        methods: In the order of the table.
        by: What stands side by side: `task` or `condition`. The other one is pooled.
        columns: Tasks or conditions, in order; all that there are if empty.
        grew: Versions whose n grew after a look; see `grown`.

    Raises:
        DexFlexError: If a method has no episodes.
    """
    columns = tuple(columns or dict.fromkeys(rows[by]))
    rows = rows.loc[rows["method"].isin(methods) & rows[by].isin(columns)]
    if missing := [name for name in methods if name not in set(rows["method"])]:
        raise DexFlexError(f"There are no episodes of {', '.join(missing)} in {', '.join(columns)}.")
    rates = {
        (method, column): success_rate(part["success"].astype(bool).tolist())
        for method in methods
        for column in columns
        if not (part := rows.loc[(rows["method"] == method) & (rows[by] == column)]).empty
    }
    shown = (*columns, AVERAGE) if len(columns) > 1 else columns
    for method in methods:
        if len(columns) > 1 and (rate := _pooled([rates.get((method, column)) for column in columns])):
            rates[method, AVERAGE] = rate
    return Summary(rows, tuple(methods), shown, rates, _tests(rows, methods, grew))


def times(rows: pd.DataFrame) -> pd.Series:
    """Return times to success [s], that of a failure its task's limit.

    A dropped object ends an episode early, but would not have been brought home later: censored where it
    ended, it would count as if it might.

    Raises:
        DexFlexError: If an episode is longer than its task allows.
    """
    longest = rows.groupby("task")["seconds"].transform("max")
    known = {name: task.max_episode_steps * CONTROL_PERIOD for name, task in TASKS.items()}
    limits = rows["task"].map(known).fillna(longest)
    if (late := rows["seconds"] > limits + 1e-6).any():
        row = rows.loc[late].iloc[0]
        raise DexFlexError(
            f"An episode of {row['method']} in {row['task']}, {row['condition']} took {row['seconds']} s, "
            f"seed {row['seed']}; the limit is {limits[late].iloc[0]:g} s. These rows are of another version "
            "of the task."
        )
    return rows["seconds"].astype(float).where(rows["success"].astype(bool), limits)


def _pooled(rates: Sequence[Rate | None]) -> Rate | None:
    """Return the average of rates, over all their episodes; None if they have different numbers of them."""
    found = [rate for rate in rates if rate is not None]
    if len(found) < len(rates) or len({rate.n_episodes for rate in found}) > 1:
        return None
    successes = sum(rate.n_success for rate in found)
    return success_rate([k < successes for k in range(sum(rate.n_episodes for rate in found))])


def _paired(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    return first.merge(second, on=_keys(first), suffixes=("_first", "_second"))


def _keys(rows: pd.DataFrame) -> list[str]:
    return [name for name in _EPISODE if name in rows]


def _tests(rows: pd.DataFrame, methods: Sequence[str], grew: frozenset[str]) -> tuple[PairTest, ...]:
    found = []
    episodes = {name: rows.loc[rows["method"] == name] for name in methods}
    for first, second in combinations(methods, 2):
        pair = _paired(episodes[first], episodes[second])
        if pair.empty:
            continue
        solved = (pair[f"success_{which}"].astype(bool).tolist() for which in ("first", "second"))
        test = paired_test(*solved)
        looked = not grew.isdisjoint([*pair["version_first"], *pair["version_second"]])
        evidence = paired_e_value(test.only_first, test.only_second) if looked else None
        found.append(PairTest(first, second, len(pair), *test, test.p_value, evidence, None))
    fixed = holm([test.p_value for test in found])
    anytime = holm([min(1.0, 1 / (test.e_value or 1.0)) for test in found])
    return tuple(
        test._replace(p_value_holm=p, p_anytime_holm=None if test.e_value is None else at_any)
        for test, p, at_any in zip(found, fixed, anytime, strict=True)
    )


def write_eval_info(rows: pd.DataFrame, path: Path) -> None:
    """Write rates as LeRobot's `eval_info.json` has them: a group per method and condition, a task per task.

    Args:
        rows: Episodes.
        path: JSON file.
    """
    tasks = list(dict.fromkeys(rows["task"]))
    names = rows["method"] + " " + rows["condition"]
    groups = {str(name): part for name, part in rows.groupby(names, sort=False)}
    info = {
        "per_task": [
            {"task_group": name, "task_id": tasks.index(str(task)), "task": task, "metrics": _metrics(part)}
            for name, group in groups.items()
            for task, part in group.groupby("task", sort=False)
        ],
        "per_group": {name: _rate(group) for name, group in groups.items()},
        "overall": _rate(rows),
    }
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(json.dumps(info, indent=1) + "\n")
    temporary.replace(path)


def _metrics(rows: pd.DataFrame) -> dict[str, Any]:
    ordered = rows.sort_values("seed")
    successes = ordered["success"].astype(bool).tolist()
    return {"successes": successes, "seeds": ordered["seed"].astype(int).tolist(), **_rate(rows)}


def _rate(rows: pd.DataFrame) -> dict[str, Any]:
    return success_rate(rows["success"].astype(bool).tolist())._asdict()
