"""Put finished runs among the published results; older rows of the same cells make way.

python eval/publish.py --folders=outputs/compare,outputs/shared_control
python eval/publish.py --folders=outputs/degraded/seed1 --into=eval/results/reach_seed1.csv
python eval/publish.py --folders=outputs/degraded/both --into=eval/results/reach_sharpa.csv --label=both

Then `python eval/readme_table.py` and `python docs/render_results.py` renew tables and pictures.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from lerobot_dexflex import console
from lerobot_dexflex.console import names
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.table import KEY, RUNS

CELL = ["method", "task", "condition"]
"""What is published as a whole, or not at all."""


@dataclass
class Config:
    """Copy the rows of finished runs, and where they came from, into a published table."""

    folders: str
    """Folders of runs, separated by commas."""
    into: Path = Path("eval/results/tasks.csv")
    """The published table, `tasks*.csv` or `reach*.csv`; `runs.csv` stands beside it."""
    label: str = ""
    """Goes before the methods' names, to tell controllers apart: `both` leaves rows of `both/dexflex`."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    del words
    publish([Path(name) for name in names(config.folders)], config.into, config.label)
    return 0


def publish(folders: list[Path], into: Path, label: str = "") -> None:
    """Replace whole cells of a published table by the rows of runs.

    Origins in `runs.csv` of which no table of the folder has a row any more are forgotten.

    Args:
        folders: Folders of runs, which have a table of the same kind: `tasks.csv` or `reach.csv`.
        into: The published table.
        label: Goes before the methods' names, with a `/` between them.

    Raises:
        DexFlexError: If a table is missing, or a run has fewer episodes of a cell than are published.
            Nothing is changed then.
    """
    kind = f"{into.stem.partition('_')[0]}.csv"
    new = _labelled(_concatenated([folder / kind for folder in folders]), label)
    old = _read(into) if into.exists() else new.iloc[:0]
    _check_finished(old, new, into)
    replaced = old.set_index(CELL).index.isin(new.set_index(CELL).index)
    rows = pd.concat([old.loc[~replaced], new]).fillna("")
    runs = _labelled(_concatenated([folder / RUNS for folder in folders]), label)
    origins = pd.concat([_read(into.with_name(RUNS)), runs])
    others = [path for path in into.parent.glob("*.csv") if path.name != RUNS and path != into]
    known = set(rows["version"]).union(*(_read(path)["version"] for path in others))
    _write(rows, into)
    _write(origins.loc[origins["version"].isin(known)].drop_duplicates(), into.with_name(RUNS))
    print(f"{len(new)} rows of {len(new.groupby(CELL))} cells into {into}, instead of {int(replaced.sum())}.")


def _check_finished(old: pd.DataFrame, new: pd.DataFrame, into: Path) -> None:
    ours = new.groupby(CELL)["seed"].nunique()
    published = old.groupby(CELL)["seed"].nunique().reindex(ours.index, fill_value=0)
    for cell in ours.index[ours < published]:
        raise DexFlexError(
            f"{', '.join(cell)} has {ours[cell]} episodes, but {into} has {published[cell]}. Finish the run, "
            "then publish it; nothing was changed."
        )


def _concatenated(paths: list[Path]) -> pd.DataFrame:
    return pd.concat([_read(path) for path in paths]).fillna("")


def _labelled(rows: pd.DataFrame, label: str) -> pd.DataFrame:
    return rows.assign(method=[f"{label}/{method}" if label else method for method in rows["method"]])


def _read(path: Path) -> pd.DataFrame:
    """Return a table as text, so that what stays is written as it was, with each row once."""
    if not path.exists():
        raise DexFlexError(f"There are no results: {path} not found. Name the folder of a run.")
    rows = pd.read_csv(path, dtype=str, keep_default_na=False)
    return rows.drop_duplicates(list(KEY) if "seed" in rows else None, ignore_index=True)


def _write(rows: pd.DataFrame, path: Path) -> None:
    temporary = path.with_name(f".{path.name}")
    rows.to_csv(temporary, index=False, lineterminator="\n")
    temporary.replace(path)


if __name__ == "__main__":
    sys.exit(main())
