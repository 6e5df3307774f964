"""The file `recipe.yaml` of a corpus: what it is, by which code, and what it cost."""

from pathlib import Path
from typing import Any

import yaml

from lerobot_dexflex.corpus.config import FIRST_SEED, CorpusConfig
from lerobot_dexflex.corpus.schema import KINDS
from lerobot_dexflex.corpus.shard import read_header
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand

RECIPE = "recipe.yaml"
_CARD = "README.md"
"""May wait in the folder for the data that it describes."""
_DECISIVE = ("hand", "seed", "objects_per_job", "steps_per_object", "shares")
"""Settings on which every shard depends, beside the numbers of the hand."""


def open_folder(config: CorpusConfig, origin: dict[str, Any]) -> None:
    """Create or continue the folder of a corpus.

    Raises:
        DexFlexError: If it holds something else, or another recipe; nothing is changed then.
    """
    folder = config.output
    recipe = folder / RECIPE
    if recipe.is_file():
        have, wanted = _identity(_read(recipe)), _identity(_recipe(config))
        different = [
            f"{key}: {have[key]} there, {wanted[key]} now" for key in wanted if have[key] != wanted[key]
        ]
        if different:
            raise DexFlexError(
                f"{folder} holds a corpus of another recipe ({'; '.join(different)}). Choose another "
                "--output, or move it away; nothing was changed."
            )
        for leftover in folder.glob("*/*.tmp"):
            leftover.unlink()
        return
    if folder.exists() and {path.name for path in folder.iterdir()} - {_CARD}:
        raise DexFlexError(
            f"{folder} exists and has no {RECIPE}, so it is no corpus. Choose another --output, or move it "
            "away; nothing was changed."
        )
    folder.mkdir(parents=True, exist_ok=True)
    _write(recipe, {"complete": False, **_recipe(config), "origin": origin})


def close_folder(
    config: CorpusConfig, origin: dict[str, Any], shards: dict[str, list[Path]]
) -> dict[str, Any]:
    """Write the recipe with the totals of the finished shards and return the totals."""
    totals = {split: _summary(paths) for split, paths in shards.items() if paths}
    recipe = {"complete": True, **_recipe(config), "origin": origin, "totals": totals}
    _write(config.output / RECIPE, recipe)
    return totals


def shard_jobs(config: CorpusConfig) -> list[tuple[str, int]]:
    """Return split and number of every job, in the order in which they are started."""
    return [(split, k) for split in FIRST_SEED for k in range(getattr(config.jobs, split))]


def _summary(paths: list[Path]) -> dict[str, Any]:
    """Add up what the headers of shards tell."""
    sums: dict[str, float] = {}
    commits = set()
    for path in paths:
        header = read_header(path)
        commits |= {episode["commit"] for episode in header.get("episodes", ())}
        for key, value in header["totals"].items():
            sums[key] = sums.get(key, 0.0) + value
    seconds = max(sums.get("cpu_seconds", 0.0), 1e-9)
    patterns = {key.removeprefix("pattern_"): v for key, v in sums.items() if key.startswith("pattern_")}
    seen = max(sum(patterns.values()), 1.0)
    found: dict[str, Any] = {
        key: int(v) for key, v in sums.items() if not key.startswith(("pattern_", "cpu"))
    }
    found |= {"shards": len(paths), "cpu_seconds": round(seconds, 1)}
    if "steps" in sums:
        found["steps_per_cpu_second"] = round(sums["steps"] / seconds, 1)
    if patterns:
        ordered = sorted(patterns.items(), key=lambda item: -item[1])
        found["contact_patterns"] = {key: round(count / seen, 4) for key, count in ordered}
    if commits:
        found["commits"] = sorted(commits)
    return found


def kind_key(kind: int) -> str:
    """Return the name under which totals count the steps of a kind."""
    return "steps_" + KINDS[kind].replace(" ", "_")


def _recipe(config: CorpusConfig) -> dict[str, Any]:
    """Return what a recipe file says of the configuration, and of the numbers behind the hand's name."""
    return {"recipe": config.to_dict(), "numbers": get_hand(config.hand).signature}


def _identity(recipe: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of a recipe file on which every shard depends."""
    return {key: recipe["recipe"].get(key) for key in _DECISIVE} | {"numbers": recipe.get("numbers")}


def _read(path: Path) -> dict[str, Any]:
    """Return what a recipe file holds.

    Raises:
        DexFlexError: If the file is damaged.
    """
    try:
        found = yaml.safe_load(path.read_text())
        if isinstance(found["recipe"], dict):
            return found
    except (yaml.YAMLError, KeyError, TypeError, ValueError):
        pass
    raise DexFlexError(
        f"{path} is damaged: it holds no recipe. Restore it, choose another --output, or move the "
        "folder away; nothing was changed."
    )


def _write(path: Path, values: dict[str, Any]) -> None:
    temporary = path.with_suffix(".tmp")
    temporary.write_text(yaml.safe_dump(values, sort_keys=False))
    temporary.replace(path)
