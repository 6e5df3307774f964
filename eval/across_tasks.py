"""Average comparisons of the same interfaces over tasks: rates, intervals and paired tests over all episodes.

python eval/across_tasks.py eval/results/{pour_cup,place_hammer}.json --output eval/results/tasks.json
python eval/across_tasks.py heavy=pour_heavy.json,hammer_heavy.json slippery=pour_slip.json,hammer_slip.json
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from lerobot_dexflex.errors import DexFlexError


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    command.add_argument(
        "results",
        nargs="+",
        help="comparison.json of each column of the table, named as its file, or NAME=FILE,FILE,...: "
        "the episodes of all these files together",
    )
    command.add_argument("--output", type=Path, help="also write everything to this JSON file")
    return command


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    from lerobot_dexflex.evaluation.across import across, pool
    from lerobot_dexflex.evaluation.report.table import across_markdown
    from lerobot_dexflex.evaluation.store import write_json

    try:
        found = across({name: pool(_read_all(files)) for name, files in map(_column, options.results)})
    except DexFlexError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if options.output is not None:
        write_json(options.output, found)
    print(across_markdown(found))
    return 0


def _column(argument: str) -> tuple[str, list[Path]]:
    name, equals, files = argument.partition("=")
    return (name, [Path(file) for file in files.split(",")]) if equals else (Path(name).stem, [Path(name)])


def _read_all(paths: list[Path]) -> dict[str, dict[str, Any]]:
    return {str(path): _read(path) for path in paths}


def _read(path: Path) -> dict[str, Any]:
    try:
        result = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DexFlexError(
            f"{path} cannot be read: {error}. Give a file of eval/compare_interfaces.py."
        ) from error
    if "per_interface" not in result:
        raise DexFlexError(f"{path} is no comparison. Give a comparison.json of eval/compare_interfaces.py.")
    return result


if __name__ == "__main__":
    sys.exit(main())
