"""What several trainings of the controller say together: one table of rows for each."""

from collections.abc import Sequence
from typing import NamedTuple

import pandas as pd

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.tables import as_markdown, mean_text
from lerobot_dexflex.runs.statistics import Mean, holm, mean_interval, rank_test


class TrainedCell(NamedTuple):
    """A method under a condition, over all trainings."""

    condition: str
    method: str
    means: tuple[float, ...]
    """Mean progress of each training."""
    together: Mean
    """Of the progress of each episode, averaged over the trainings."""
    gain: Mean | None
    """Of the reference over the method, of the same averages; None for the reference itself."""
    p_value: float | None
    """Wilcoxon signed-rank on the averages, adjusted by Holm within the condition."""


def across_trainings(tables: Sequence[pd.DataFrame], reference: str = "dexflex") -> list[TrainedCell]:
    """Compare methods by the progress of the same episodes, averaged over trainings.

    Episodes are the sample: the tests say what holds for these trainings; how much trainings differ is seen
    in their means.

    Args:
        tables: One per training, one row per episode; what is not in all of them is left out.
        reference: Method that the others are tested against.

    Raises:
        DexFlexError: If there are fewer than two tables, or they share no episodes of the reference.
    """
    if len(tables) < 2:
        raise DexFlexError(f"Trainings are compared from two tables on. Got {len(tables)}.")
    keys = ["condition", "method", "seed"]
    columns = [table.set_index(keys)["progress"].rename(n) for n, table in enumerate(tables)]
    progress = pd.concat(columns, axis=1, join="inner").reset_index()
    found: list[TrainedCell] = []
    for condition, here in progress.groupby("condition", sort=False):
        methods = here["method"].unique().tolist()
        if reference not in methods:
            raise DexFlexError(f"The trainings share no episodes of {reference!r} under {condition!r}.")
        here = here.assign(average=here[list(range(len(tables)))].to_numpy().mean(1))
        average = here.pivot(index="seed", columns="method", values="average")
        others = [name for name in methods if name != reference]
        pairs = [average[[name, reference]].dropna().to_numpy() for name in others]
        tests = [rank_test(pair[:, 0].tolist(), pair[:, 1].tolist()) for pair in pairs]
        adjusted = dict(zip(others, holm([test.p_value for test in tests]), strict=True))
        gains = dict(zip(others, [test.gain for test in tests], strict=True))
        for name, rows in here.groupby("method", sort=False):
            means = tuple(float(rows[n].mean()) for n in range(len(tables)))
            together = mean_interval(rows["average"].tolist())
            assert together is not None
            of = (str(condition), str(name), means, together)
            found.append(TrainedCell(*of, gains.get(str(name)), adjusted.get(str(name))))
    return found


def markdown(cells: Sequence[TrainedCell]) -> str:
    """Return the table in Markdown."""
    count = len(cells[0].means)
    header = ["condition", "method", *(f"training {n}" for n in range(count)), "together", "gain", "p (Holm)"]
    rows = [
        [
            cell.condition,
            f"`{cell.method}`",
            *(f"{mean:.2f}" for mean in cell.means),
            mean_text(cell.together),
            "" if cell.gain is None else mean_text(cell.gain, "+"),
            "" if cell.p_value is None else f"{cell.p_value:.2g}",
        ]
        for cell in cells
    ]
    return as_markdown(header, rows)
