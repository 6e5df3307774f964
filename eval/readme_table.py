"""Print tables of the published results, or fill those of the documents from them.

python eval/readme_table.py
python eval/readme_table.py --tasks=PourCup-v0 --methods=joint,press:4,dexflex
python eval/readme_table.py --trainings=true --conditions=clean,removal_2mm

Without arguments, every `<!-- results:NAME -->` ... `<!-- /results -->` of the documents is filled with the
view of that NAME, from the rows of `eval/results/tasks.csv`.
"""

import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_dexflex import console
from lerobot_dexflex.envs.registration import TOOLS
from lerobot_dexflex.errors import DexFlexError

if TYPE_CHECKING:  # Seconds of imports that --help need not pay.
    import pandas as pd

    from lerobot_dexflex.evaluation.summary import Summary
    from lerobot_dexflex.evaluation.trainings import OverTrainings

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval/results"
TOLD_APART = "PourCup-v0,PlaceHammer-v0"
"""Tasks whose policies succeed often enough to be told apart."""
TASKS = "PourCup-v0,PlaceHammer-v0,AssembleTable-v0"
POLICIES = "joint,commanded/raw,commanded/press:1,press:4,dexgen,dexflex-notouch,dexflex"
"""Measured under policies, which learned joint targets, commanded and measured fingertips."""
SPLIT = "dexflex:use_splitter=True"
"""The controller below a source that presses."""
CLOSE = "levels=0.75"
"""Option of the controller by which its candidates stay closer to the draft."""
MOTION_ONLY = "motion/raw,motion/press:4,motion/dexgen,motion/dexflex"
"""Measured under policies that learned measured fingertips alone."""
OPERATOR = (
    "operator/joint,operator/raw,operator-pressing/raw,operator/press:4,operator/dexgen,operator/dexflex"
)
"""Measured below a live operator."""
_BLOCK = re.compile(r"<!-- results:(?P<name>\w+) -->\n.*?<!-- /results -->", re.DOTALL)


@dataclass
class View:
    """Tables of published episodes: success by method, a column per task or condition."""

    methods: str = POLICIES
    """Names in the table, separated by commas, such as `raw,act/raw`."""
    conditions: str = "clean"
    """Names, separated by commas: a table each, or a column each with `by=condition`."""
    tasks: str = TASKS
    """Names, separated by commas."""
    by: str = "task"
    """What stands side by side: `task`, or `condition`, then with the episodes of all tasks together."""
    trainings: bool = False
    """Also read the rows of other trainings, `tasks_seed*.csv`, and tell what holds over trainings."""
    against: str = ""
    """Over trainings, and with details: show only the tests against this method; all of them if empty."""
    what: str = "success"
    """What of one training is told: `success`; `details`: also times, drops, holding, interventions, tests;
    `selectivity`: how much drafts are changed where contacts begin or end, and in calm."""
    results: Path = RESULTS
    """Folder of `tasks.csv` and `runs.csv`."""

    def __post_init__(self) -> None:
        if self.by not in ("task", "condition"):
            raise DexFlexError(f"`by` must be `task` or `condition`. Got {self.by!r}.")
        if self.what not in ("success", "details", "selectivity"):
            raise DexFlexError(f"`what` must be `success`, `details` or `selectivity`. Got {self.what!r}.")
        if self.trainings and self.what != "success":
            raise DexFlexError(f"Over trainings, `what` must be `success`. Got {self.what!r}.")


@dataclass(frozen=True)
class Benchmark:
    """A table of the in-hand benchmark: progress by method, a column per condition."""

    methods: str
    """Names, separated by commas."""
    conditions: str
    """Names, separated by commas."""
    reference: str = "dexflex"
    """Method that the others are tested against."""
    published: str = "reach"
    """Name of the published table, without `.csv`; another hand than LEAP has its own."""


@dataclass(frozen=True)
class Trainings:
    """A table of the in-hand benchmark over several trainings of the controller."""

    methods: str
    """Names, separated by commas; a label before the `/` tells controllers apart."""
    reference: str
    """Method that the others are tested against."""
    published: str = "reach"
    """Name of the published table, without `.csv`; another hand than LEAP has its own."""


SHARED = View(
    "operator-pressing/raw,operator-pressing/filter,operator-pressing/press:1,operator-pressing/projection,"
    "operator-pressing/dexgen:use_splitter=True,operator-pressing/dexflex-notouch:use_splitter=True,"
    f"operator-pressing/{SPLIT}",
    "novice",
    ",".join(TOOLS),
)
"""Success below a person who uses tools."""
VIEWS = {
    "operator": View(OPERATOR, conditions="typical"),
    "expert": View("expert"),
    "policies": View(trainings=True),
    "commanded": View(f"commanded/raw,commanded/projection,commanded/{SPLIT},dexflex", trainings=True),
    "removal": View(
        "joint,commanded/raw,commanded/press:1,commanded/press:1+blocked=True,commanded/projection,"
        f"commanded/{SPLIT},press:4,press:4+blocked=True,dexgen,dexflex-notouch,dexflex",
        "removal_2mm",
        TOLD_APART,
        trainings=True,
        against="dexflex",
    ),
    "typical": View(POLICIES, "typical", TOLD_APART, trainings=True, against="dexflex"),
    "ten": View("demos10/joint,demos10-commanded/raw,demos10/dexgen,demos10/dexflex", tasks=TOLD_APART),
    "twenty_five": View(
        "demos25/joint,demos25-commanded/raw,demos25/dexgen,demos25/dexflex", tasks=TOLD_APART
    ),
    "motion_only": View(MOTION_ONLY, tasks=TOLD_APART, trainings=True),
    "act": View(f"act/joint,act/raw,act/{SPLIT},act10/joint,act10/raw,act10/{SPLIT}", tasks="PourCup-v0"),
    "tools_expert": View("expert", tasks=",".join(TOOLS)),
    "tools": SHARED,
    "tools_details": replace(SHARED, what="details", against=f"operator-pressing/{SPLIT}"),
    "selectivity": replace(SHARED, what="selectivity"),
    "fifty": View("joint,commanded/raw,dexgen,dexflex", tasks=TOLD_APART),
}
"""What a document may show, by name."""
BENCHMARKS = {
    "motion": Benchmark(
        "raw,press,dexgen,dexflex-noselection,dexflex-notouch,dexflex,forces,operator", "clean,removal_2mm"
    ),
    "families": Benchmark("press,dexgen,dexflex", "noise_2mm,scale_1.5,delay_2,removal_2mm"),
    "ablations": Benchmark(
        "dexflex-noselection,dexflex-noconsequence,dexflex-nopure,dexflex-noseeded,dexflex-nofinger,"
        "dexflex-noslow,dexflex-notouch,dexflex-nogrip,dexflex",
        "removal_2mm",
    ),
    "sharpa": Benchmark(
        f"raw,press,dexgen,dexflex-noselection,dexflex-notouch:{CLOSE},dexflex,dexflex:{CLOSE},forces,operator",
        "clean,removal_2mm",
        f"dexflex:{CLOSE}",
        "reach_sharpa",
    ),
    "across_leap": Benchmark(
        f"specialist/dexflex:{CLOSE},both/dexflex:{CLOSE}", "clean,removal_2mm", f"both/dexflex:{CLOSE}"
    ),
    "across_sharpa": Benchmark(
        ",".join(
            f"{label}/dexflex:{CLOSE}" for label in ("specialist", "both", "other", "tenth", "tenth-warm")
        ),
        "clean,removal_2mm",
        f"both/dexflex:{CLOSE}",
        "reach_sharpa",
    ),
    "pressing": Benchmark(
        f"raw,press,projection,dexgen:use_splitter=True,dexflex,{SPLIT}",
        "pressing,removal_2mm+pressing",
        SPLIT,
    ),
    "pressing_families": Benchmark(
        f"raw,press,projection,dexgen:use_splitter=True,{SPLIT}",
        "noise_2mm+pressing,scale_1.5+pressing,delay_2+pressing,removal_2mm+pressing",
        SPLIT,
    ),
}
"""Tables of the in-hand benchmark that a document may show, by name."""
TRAININGS = {"trainings": Trainings("dexflex-notouch,dexflex", "dexflex")}
"""Tables of several trainings of the controller in the in-hand benchmark, by name."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return console.run(View, _work, arguments)


def _work(view: View, words: list[str]) -> int:
    if words:
        print(markdown(view))
        return 0
    for document in documents():
        document.write_text(filled(document.read_text(), up=up(document)))
    return 0


def names(text: str) -> list[str]:
    """Return the names of the views that a document shows."""
    return [block["name"] for block in _BLOCK.finditer(text)]


def documents() -> list[Path]:
    """Return the documents that show results."""
    folders = (ROOT, ROOT / "docs", ROOT / "eval", *sorted((ROOT / "policies/checkpoints").glob("*_*")))
    found = [path for folder in folders for path in sorted(folder.glob("*.md"))]
    return [path for path in found if names(path.read_text())]


def filled(text: str, results: Path = RESULTS, up: str = "") -> str:
    """Return a document with its result tables made anew.

    Args:
        text: Markdown with result blocks.
        results: Folder of `tasks.csv`.
        up: Way from the document to the repository's root, such as `../../`.

    Raises:
        DexFlexError: If a block names no view, or a view has no episodes.
    """

    def block(match: re.Match[str]) -> str:
        name = match["name"]
        if name in BENCHMARKS:
            published, content = BENCHMARKS[name].published, benchmark_markdown(results, BENCHMARKS[name])
        elif name in TRAININGS:
            published, content = TRAININGS[name].published, trainings_markdown(results, TRAININGS[name])
        elif name in VIEWS:
            published, content = "tasks", markdown(replace(VIEWS[name], results=results))
        else:
            valid = ", ".join((*VIEWS, *BENCHMARKS, *TRAININGS))
            raise DexFlexError(f"There is no view {name!r} of the results. Valid: {valid}.")
        source = f"{up}eval/results/{published}.csv"
        last = f"Every episode: [{source}]({source})."
        space = "" if content.endswith("\n") else " "
        return f"<!-- results:{name} -->\n{content}{space}{last}\n<!-- /results -->"

    return _BLOCK.sub(block, text)


def up(document: Path) -> str:
    """Return the way from a document to the repository's root."""
    return "../" * (len(document.relative_to(ROOT).parts) - 1)


def markdown(view: View) -> str:
    """Return the tables of a view.

    Raises:
        DexFlexError: If it has no episodes.
    """
    conditions = view.conditions.split(",")
    if view.by == "condition":
        return _one_table(view, conditions)
    parts = []
    for condition in conditions:
        text = _one_table(view, [condition])
        parts.append(f"**{condition}**\n\n{text}" if len(conditions) > 1 else text)
    return "\n\n".join(parts)


def _one_table(view: View, conditions: list[str]) -> str:
    from lerobot_dexflex.evaluation.report import trainings
    from lerobot_dexflex.evaluation.report.table import (
        detail_markdown,
        details_markdown,
        rates_markdown,
        selectivity_markdown,
    )

    if view.trainings:
        return trainings.markdown(pooled(view, conditions), view.against)
    summary = alone(view, conditions)
    if view.what == "details":
        return details_markdown(summary, view.against)
    if view.what == "selectivity":
        return selectivity_markdown(summary)
    wide = view.by == "condition" or "," in view.tasks
    return rates_markdown(summary) if wide else detail_markdown(summary)


def alone(view: View, conditions: list[str]) -> "Summary":
    """Return what `tasks.csv` says of a view under some of its conditions."""
    from lerobot_dexflex.evaluation.summary import summarise

    rows, columns, grew = _rows(view, conditions, [view.results / "tasks.csv"])
    return summarise(rows["tasks.csv"], view.methods.split(","), view.by, columns, grew)


def pooled(view: View, conditions: list[str]) -> "OverTrainings":
    """Return what the rows of all trainings say of a view under some of its conditions."""
    from lerobot_dexflex.evaluation.trainings import over_trainings

    others = sorted(view.results.glob("tasks_seed*.csv"))
    rows, columns, grew = _rows(view, conditions, [view.results / "tasks.csv", *others])
    return over_trainings(rows, view.methods.split(","), view.by, columns, grew)


def _rows(
    view: View, conditions: list[str], paths: list[Path]
) -> tuple[dict[str, "pd.DataFrame"], list[str], frozenset[str]]:
    """Return a view's rows of each file, its columns, and the versions whose n grew."""
    from lerobot_dexflex.evaluation.summary import grown
    from lerobot_dexflex.evaluation.trainings import read_trainings
    from lerobot_dexflex.runs.table import RUNS, read

    tasks = view.tasks.split(",")
    tables = {
        name: rows.loc[rows["task"].isin(tasks) & rows["condition"].isin(conditions)]
        for name, rows in read_trainings(paths).items()
    }
    columns = conditions if view.by == "condition" else tasks
    return tables, columns, grown(read(view.results / RUNS))


def benchmark_markdown(results: Path, table: Benchmark) -> str:
    """Return progress in the in-hand benchmark and the tests of its reference, from `reach*.csv`."""
    from lerobot_dexflex.evaluation.reach.summary import family, summarise
    from lerobot_dexflex.evaluation.reach.tables import TEST_HEADER, as_markdown, mean_text, test_rows
    from lerobot_dexflex.evaluation.summary import newest
    from lerobot_dexflex.runs.table import read

    methods, conditions = table.methods.split(","), table.conditions.split(",")
    rows = newest(read(results / f"{table.published}.csv"))
    summary = summarise(rows, methods, conditions, table.reference)
    several = len({family(condition) for condition in conditions} - {None}) > 1
    shown = summary.conditions if several else summary.run
    cells = [
        [f"`{method}`", *(mean_text(summary.mean(method, condition, "progress")) for condition in shown)]
        for method in methods
    ]
    tests = [row for row in test_rows(summary) if row[0] in shown]
    count = min(len(summary.of(method, condition)) for method in methods for condition in conditions)
    return (
        f"{as_markdown(['interface', *shown], cells)}\n\nMean progress on {count} chains of test objects, "
        f"bootstrap 95 % intervals. `{summary.reference}` against the others, on the same chains:\n\n"
        f"{as_markdown(TEST_HEADER, tests)}\n\n"
    )


def trainings_markdown(results: Path, table: Trainings) -> str:
    """Return progress in the in-hand benchmark over trainings, from a table and those with `_seed*`."""
    from lerobot_dexflex.evaluation.reach.trainings import across_trainings, markdown
    from lerobot_dexflex.evaluation.summary import newest
    from lerobot_dexflex.runs.table import read

    first, methods = table.published, table.methods.split(",")
    paths = [results / f"{first}.csv", *sorted(results.glob(f"{first}_seed*.csv"))]
    rows = [newest(read(path)) for path in paths]
    cells = across_trainings([each.loc[each["method"].isin(methods)] for each in rows], table.reference)
    n = min(cell.together.n for cell in cells)
    return (
        f"{markdown(cells)}\n\nn = {n} test chains per cell, each run by {len(paths)} trainings of the "
        "controller; their progress is averaged for each chain before methods are compared. Rows of "
        f"the other trainings: {', '.join(f'`{path.name}`' for path in paths[1:])}."
    )


if __name__ == "__main__":
    sys.exit(main())
