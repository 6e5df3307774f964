"""From records to the numbers of the result file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.bounds import CLEAN, ORACLE
from lerobot_dexflex.evaluation.reach.cells import PAPER_FAMILIES, Cell
from lerobot_dexflex.evaluation.reach.metrics import EVENT_LAGS
from lerobot_dexflex.evaluation.reach.record import Record
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.statistics import holm, mean_interval, rank_test, success_rate

FAMILIES = "families"
"""The average over the degradation families, each of which counts the same."""
_AVERAGED = ("duration", "progress", "intent", "retention", "intervention")
Found = Mapping[tuple[str, str], Mapping[int, Record]]
"""Records by (cell, method) and episode."""


def summarise(
    records: Sequence[Record], methods: Sequence[str], cells: Sequence[str], reference: str | None = None
) -> dict[str, Any]:
    """Return means with intervals per cell and method, averages over families, and paired tests.

    Args:
        records: All episodes; every method of a cell must have run the same first ones.
        methods: Names, in the order of the tables.
        cells: Names, in the order of the tables.
        reference: Method that all others are tested against; see `default_reference`.

    Raises:
        DexFlexError: If a method did not run in a cell or episodes are missing.
    """
    reference = reference or default_reference(methods)
    if reference not in methods:
        raise DexFlexError(f"The reference {reference!r} is none of the methods: {', '.join(methods)}.")
    found = _sorted(records, methods, cells)
    averaged = [cell for cell in cells if Cell.parse(cell).family]
    return {
        "reference": reference,
        "cells": {cell: {m: _describe(found[cell, m].values()) for m in methods} for cell in cells},
        "averaged_cells": averaged,
        FAMILIES: {m: _average(found, averaged, m) for m in methods} if averaged else {},
        "tests": _tests(found, methods, [*cells, *([FAMILIES] if averaged else [])], averaged, reference),
    }


def default_reference(methods: Sequence[str]) -> str:
    """Return `dexflex`, else the first method that is one without an ablation, else the first method."""
    ours = [m for m in methods if Method.parse(m).base == "dexflex" and not Method.parse(m).ablation]
    return "dexflex" if "dexflex" in ours else (ours or list(methods))[0]


def per_episode(found: Found, cells: Sequence[str], method: str, metric: str) -> dict[int, float]:
    """Return a metric per episode, averaged over the cells of each family and then over families.

    Episodes in which the metric is undefined in a cell are left out.
    """
    families = {family: [c for c in cells if Cell.parse(c).family == family] for family in PAPER_FAMILIES}
    families = {family: members for family, members in families.items() if members}
    values = {}
    for k in set.intersection(*(set(found[cell, method]) for cell in cells)):
        rows = [[found[c, method][k].metrics[metric] for c in members] for members in families.values()]
        if all(value is not None for row in rows for value in row):
            values[k] = float(np.mean([np.mean([v for v in row if v is not None]) for row in rows]))
    return values


def _sorted(records: Sequence[Record], methods: Sequence[str], cells: Sequence[str]) -> Found:
    found: dict[tuple[str, str], dict[int, Record]] = {(c, m): {} for c in cells for m in methods}
    for record in sorted(records, key=lambda r: r.episode):
        if (record.cell, record.method) in found:
            found[record.cell, record.method][record.episode] = record
    for (cell, method), episodes in found.items():
        if list(episodes) != list(range(len(episodes))) or not episodes:
            raise DexFlexError(
                f"{method!r} has {len(episodes)} episodes in {cell!r} with gaps or none at all; run the same "
                "command again to complete it."
            )
    return found


def _describe(records: Any) -> dict[str, Any]:
    records = list(records)
    names = records[0].metrics
    metrics = {name: _mean([r.metrics[name] for r in records]) for name in names}
    kept = success_rate([not r.dropped for r in records])
    branches = [r.branches for r in records if r.branches]
    return {
        "n": len(records),
        "drops": len(records) - kept.n_success,
        "pc_kept": kept.pc_success,
        "pc_kept_ci95": kept.pc_success_ci95,
        **metrics,
        "branches": {
            name: float(np.mean([b.get(name, 0.0) for b in branches])) for name in sorted(branches[0])
        }
        if branches
        else None,
        "event_curve": _event_curve([r.event_curve for r in records if r.event_curve]),
    }


def _event_curve(curves: Sequence[Sequence[float | None]]) -> list[list[float]] | None:
    """Return rows of lag, mean, and interval of the intervention around removals; None without any."""
    if not curves:
        return None
    rows = []
    for k, lag in enumerate(EVENT_LAGS.tolist()):
        values = np.array([c[k] for c in curves if c[k] is not None], float)
        if len(values) < 2:
            continue
        # Of hundreds of episodes; the normal interval is that of the bootstrap to the drawn line's width.
        half = 1.96 * values.std(ddof=1) / np.sqrt(len(values))
        rows.append(
            [lag, *(round(float(v), 5) for v in (values.mean(), values.mean() - half, values.mean() + half))]
        )
    return rows


def _average(found: Found, cells: Sequence[str], method: str) -> dict[str, Any]:
    values = {metric: per_episode(found, cells, method, metric) for metric in _AVERAGED}
    return {metric: _mean(list(v.values())) for metric, v in values.items()}


def _tests(
    found: Found, methods: Sequence[str], cells: Sequence[str], averaged: Sequence[str], reference: str
) -> list[dict[str, Any]]:
    """Test the reference's progress against every method but upper bounds, Holm within cell and kind."""
    others = [m for m in methods if m != reference and Method.parse(m).base not in (CLEAN, ORACLE)]
    variants = [m for m in others if Method.parse(m).base == "dexflex"]
    tests = []
    for cell in cells:
        for kind, family in (("baseline", [m for m in others if m not in variants]), ("variant", variants)):
            rows = []
            for method in family:
                ours, theirs = (_progress(found, cell, averaged, m) for m in (reference, method))
                both = sorted(set(ours) & set(theirs))
                test = rank_test([theirs[k] for k in both], [ours[k] for k in both])
                rows.append(
                    {
                        "cell": cell,
                        "kind": kind,
                        "method": method,
                        "n": len(both),
                        "gain": test.gain._asdict(),
                    }
                    | {"p_value": test.p_value}
                )
            for row, p in zip(rows, holm([row["p_value"] for row in rows]), strict=True):
                tests.append(row | {"p_value_holm": p})
    return tests


def _progress(found: Found, cell: str, averaged: Sequence[str], method: str) -> dict[int, float]:
    if cell == FAMILIES:
        return per_episode(found, averaged, method, "progress")
    return {k: float(r.metrics["progress"] or 0.0) for k, r in found[cell, method].items()}


def _mean(values: Sequence[float | None]) -> dict[str, Any] | None:
    mean = mean_interval([value for value in values if value is not None])
    return None if mean is None else mean._asdict()
