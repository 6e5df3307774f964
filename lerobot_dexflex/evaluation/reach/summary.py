"""From rows to means with intervals, averages over families of errors, and paired tests."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.bounds import CLEAN, ORACLE
from lerobot_dexflex.evaluation.reach.metrics import Metrics
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.statistics import Mean, holm, mean_interval, rank_test

FAMILIES = "families"
"""The average over the families of errors, each of which counts the same; stands as a condition."""
PAPER_FAMILIES = ("noise", "scale", "delay", "removal")
"""The families that the paper's averages are taken over."""
_AVERAGED = ("duration", "progress", "intent", "retention", "intervention")


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
    """One per episode; the averages over families are among them, under the condition `FAMILIES`."""
    methods: tuple[str, ...]
    """In the order of the tables."""
    conditions: tuple[str, ...]
    """In the order of the tables, `FAMILIES` first if there is an average."""
    reference: str
    """Method that all others are tested against."""
    means: Mapping[tuple[str, str], Mapping[str, Mean | None]]
    """Every metric by method and condition."""
    tests: tuple[ProgressTest, ...]

    @property
    def averaged(self) -> tuple[str, ...]:
        """Conditions that the average over families is taken over."""
        return tuple(name for name in self.conditions if family(name))

    def of(self, method: str, condition: str) -> pd.DataFrame:
        """Return the rows of a method under a condition, by their seeds."""
        return rows_of(self.rows, method, condition)


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
    if averaged := [name for name in conditions if family(name)]:
        rows = pd.concat([rows, _average(rows, averaged)], ignore_index=True)
        conditions = (FAMILIES, *conditions)
    means = {
        (method, condition): _means(rows_of(rows, method, condition))
        for method in methods
        for condition in conditions
    }
    return Summary(rows, methods, conditions, reference, means, _tests(rows, methods, conditions, reference))


def rows_of(rows: pd.DataFrame, method: str, condition: str) -> pd.DataFrame:
    """Return the rows of a method under a condition."""
    return rows.loc[(rows["method"] == method) & (rows["condition"] == condition)]


def family(condition: str) -> str | None:
    """Return the family over which a condition is averaged; None for what is no single error or a control.

    Commands scaled below 1 are a control: the operator corrects the lag, and nothing is at stake.
    """
    name, _, strength = condition.partition("_")
    if "+" in condition or name not in PAPER_FAMILIES or (name == "scale" and float(strength) <= 1):
        return None
    return name


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
    return pd.DataFrame(found).rename_axis(["method", "seed"]).reset_index().assign(condition=FAMILIES)


def _means(rows: pd.DataFrame) -> dict[str, Mean | None]:
    return {name: mean_interval(rows[name].dropna().tolist()) for name in Metrics._fields}


def _tests(
    rows: pd.DataFrame, methods: Sequence[str], conditions: Sequence[str], reference: str
) -> tuple[ProgressTest, ...]:
    """Test the reference's progress against every method but upper bounds, Holm within condition and kind."""
    others = [m for m in methods if m != reference and Method.parse(m).base not in (CLEAN, ORACLE)]
    variants = [m for m in others if Method.parse(m).base == "dexflex"]
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
