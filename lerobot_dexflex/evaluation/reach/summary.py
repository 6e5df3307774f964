"""From rows to means with intervals, averages over families of errors, and paired tests."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.conditions import Condition
from lerobot_dexflex.evaluation.reach.bounds import BOUNDS
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.statistics import Mean, holm, mean_interval, rank_test

FAMILIES = "families"
"""The average over the families of errors, each of which counts the same; stands as a condition. There is one
for each source and kind of goals: `families`, `families+pressing`, `families+verified`, ..."""
PAPER_FAMILIES = ("noise", "scale", "delay", "removal")
"""The families that the paper's averages are taken over."""
_AVERAGED = (
    "duration",
    "progress",
    "progress_budget",
    "goal_steps",
    "intent",
    "intent_loaded",
    "intent_free",
    "intervention",
    "retention",
)


class ProgressTest(NamedTuple):
    """A paired comparison of the reference's progress with another method's, Wilcoxon signed-rank."""

    condition: str
    kind: str
    """`baseline` or `variant` of ours; p-values are adjusted within condition and kind."""
    method: str
    n: int
    gain: Mean
    """Of the reference over the method."""
    p_value: float
    p_value_holm: float


@dataclass(frozen=True)
class Summary:
    """What the tables and figures show."""

    rows: pd.DataFrame
    """One per episode; the averages over families are among them, under conditions that begin with
    `FAMILIES`."""
    methods: tuple[str, ...]
    """In the order of the tables."""
    conditions: tuple[str, ...]
    """In the order of the tables, averages first."""
    reference: str
    """Method that all others are tested against."""
    tests: tuple[ProgressTest, ...]

    @property
    def run(self) -> tuple[str, ...]:
        """Conditions that were run: all that are no average."""
        return tuple(name for name in self.conditions if not is_average(name))

    @property
    def averages(self) -> tuple[str, ...]:
        """Conditions that are averages over families."""
        return tuple(name for name in self.conditions if is_average(name))

    def of(self, method: str, condition: str) -> pd.DataFrame:
        """Return the rows of a method under a condition, by their seeds."""
        return rows_of(self.rows, method, condition)

    def mean(self, method: str, condition: str, metric: str) -> Mean | None:
        """Return the mean of one of `Metrics` over the episodes for which it is defined."""
        return mean_interval(self.of(method, condition)[metric].dropna().tolist())


def summarise(
    rows: pd.DataFrame,
    methods: Sequence[str] = (),
    conditions: Sequence[str] = (),
    reference: str | None = None,
) -> Summary:
    """Return means with intervals, averages over families, and paired tests.

    Args:
        rows: One per episode, as `run` returns them; every method must have run the same first episodes.
        methods: Names, in the order of the tables; those of the rows if none.
        conditions: Names, in the order of the tables; those of the rows if none.
        reference: Method that all others are tested against; see `default_reference`.

    Raises:
        DexFlexError: If a method did not run under a condition, episodes are missing or there twice, or the
            reference is none of the methods.
    """
    methods = tuple(methods) or tuple(rows["method"].unique())
    conditions = tuple(conditions) or tuple(rows["condition"].unique())
    reference = reference or default_reference(methods)
    if reference not in methods:
        raise DexFlexError(f"The reference {reference!r} is none of the methods: {', '.join(methods)}.")
    wanted = rows["method"].isin(methods) & rows["condition"].isin(conditions)
    rows = rows.loc[wanted].sort_values(by="seed")
    _check_complete(rows, methods, conditions)
    averages = tuple(dict.fromkeys(name for each in conditions if (name := average_of(each))))
    parts = [_average(rows, [each for each in conditions if average_of(each) == name]) for name in averages]
    rows = pd.concat([rows, *parts], ignore_index=True)
    conditions = (*averages, *conditions)
    return Summary(rows, methods, conditions, reference, _tests(rows, methods, conditions, reference))


def rows_of(rows: pd.DataFrame, method: str, condition: str) -> pd.DataFrame:
    """Return the rows of a method under a condition."""
    return rows.loc[(rows["method"] == method) & (rows["condition"] == condition)]


def family(condition: str) -> str | None:
    """Return the family over which a condition is averaged; None for what is no single error or a control.

    Motions scaled below 1 are a control: the operator corrects the lag, and nothing is at stake.
    """
    errors = tuple(Condition.parse(condition).errors)
    if len(errors) != 1 or errors[0].family not in PAPER_FAMILIES:
        return None
    return None if errors[0].family == "scale" and errors[0].strength <= 1 else errors[0].family


def average_of(condition: str) -> str | None:
    """Return the name of the average that a condition is part of; None without a family."""
    return "+".join((FAMILIES, *Condition.parse(condition).setting)) if family(condition) else None


def is_average(condition: str) -> bool:
    """Say whether a condition is an average over families."""
    return condition.partition("+")[0] == FAMILIES


def default_reference(methods: Sequence[str]) -> str:
    """Return `dexflex`, else the first method that is one without an ablation, else the first method."""
    ours = [m for m in methods if Method.parse(m).base == "dexflex" and not Method.parse(m).ablation]
    return "dexflex" if "dexflex" in ours else (ours or list(methods))[0]


def _check_complete(rows: pd.DataFrame, methods: Sequence[str], conditions: Sequence[str]) -> None:
    for condition in conditions:
        every = sorted(set(rows.loc[rows["condition"] == condition, "seed"]))
        for method in methods:
            seeds = rows_of(rows, method, condition)["seed"].tolist()
            if len(set(seeds)) < len(seeds):
                raise DexFlexError(
                    f"{method!r} has several rows of an episode under {condition!r}: choose one `version`."
                )
            if not seeds or seeds != every[: len(seeds)]:
                raise DexFlexError(
                    f"{method!r} has {len(seeds)} episodes under {condition!r}, with gaps or none at all; "
                    "run the same command again to complete it."
                )


def _average(rows: pd.DataFrame, averaged: Sequence[str]) -> pd.DataFrame:
    """Return a row per method and episode that ran under all conditions.

    A metric is averaged over the conditions of each family and then over families; it is empty where it is
    undefined under one of them.
    """
    found = {}
    for name in _AVERAGED:
        wide = rows[rows["condition"].isin(averaged)].pivot(
            index=["method", "seed"], columns="condition", values=name
        )
        found[name] = wide.dropna().T.groupby(family).mean().mean()
    average = pd.DataFrame(found).rename_axis(["method", "seed"]).reset_index()
    return average.assign(condition=average_of(averaged[0]))


def _base(name: str) -> str:
    """Return the interface of a method, before whose name there may be a label: `both/dexflex`."""
    return Method.parse(name.partition(":")[0].rpartition("/")[2]).base


def _tests(
    rows: pd.DataFrame, methods: Sequence[str], conditions: Sequence[str], reference: str
) -> tuple[ProgressTest, ...]:
    """Test the reference's progress against every method but upper bounds, Holm within condition and kind."""
    others = [m for m in methods if m != reference and _base(m) not in BOUNDS]
    variants = [m for m in others if _base(m) == "dexflex"]
    kinds = {"baseline": [m for m in others if m not in variants], "variant": variants}
    tests: list[ProgressTest] = []
    for condition in conditions:
        progress = rows[rows["condition"] == condition].pivot(
            index="seed", columns="method", values="progress"
        )
        for kind, group in kinds.items():
            pairs = [progress[[reference, method]].dropna() for method in group]
            results = [rank_test(pair.iloc[:, 1].tolist(), pair.iloc[:, 0].tolist()) for pair in pairs]
            adjusted = holm([result.p_value for result in results])
            tests += [
                ProgressTest(condition, kind, method, len(pair), result.gain, result.p_value, p)
                for method, pair, result, p in zip(group, pairs, results, adjusted, strict=True)
            ]
    return tuple(tests)
