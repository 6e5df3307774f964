"""Run the jobs of a corpus in worker processes: one job makes one shard, a finished shard is never lost."""

import contextlib
import functools
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from tqdm import tqdm

from lerobot_dexflex.corpus.config import CorpusConfig
from lerobot_dexflex.corpus.job import run_job
from lerobot_dexflex.corpus.manifest import close_folder, open_folder, shard_jobs
from lerobot_dexflex.corpus.shard import read_header, shard_path
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.lock import locked
from lerobot_dexflex.runs.provenance import provenance
from lerobot_dexflex.runs.workers import run_each

_JOB = "lerobot_dexflex.corpus.job"
"""What makes the data, with all that it imports."""


def generate(config: CorpusConfig, arguments: list[str] | None = None) -> bool:
    """Make every shard that is missing, then write the recipe with its totals.

    Args:
        config: The recipe.
        arguments: Command-line arguments for the recipe; None takes those of this process.

    Returns:
        Whether the corpus is complete; False after an interrupt.

    Raises:
        DexFlexError: If the folder holds something else, or another process works in it. Finished shards
            are never lost.
    """
    with locked(config.output):
        return _generate(config, arguments)


def _generate(config: CorpusConfig, arguments: list[str] | None) -> bool:
    origin = provenance("dexflex-corpus", [_JOB], arguments)
    open_folder(config, origin)
    jobs = shard_jobs(config)
    folder = config.output
    paths = [shard_path(folder / split, number) for split, number in jobs]
    missing = [k for k, path in enumerate(paths) if not path.is_file()]
    if not _run(config, origin["commit"], jobs, paths, missing):
        print(f"Interrupted: {sum(path.is_file() for path in paths)} of {len(paths)} shards are in {folder}.")
        print("Run the same command again to continue.")
        return False
    shards: dict[str, list[Path]] = {}
    for (split, _), path in zip(jobs, paths, strict=True):
        shards.setdefault(split, []).append(path)
    totals = close_folder(config, origin, shards)
    for split, found in totals.items():
        rate = found.get("steps_per_cpu_second", "-")
        print(f"{split}: {found['steps']} steps in {found['shards']} shards, {rate} steps per CPU second.")
    return True


def _run(
    config: CorpusConfig, commit: str, jobs: list[tuple[str, int]], paths: list[Path], missing: list[int]
) -> bool:
    """Run the missing jobs; return whether all are done."""
    function = functools.partial(_run_each, config, commit, tuple(jobs))
    queue = iter(missing)
    kept = sum(_kept(path) for path in paths if path.is_file())
    with tqdm(
        total=len(jobs), initial=len(jobs) - len(missing), unit="shard", desc=str(config.output)
    ) as bar:
        bar.set_postfix_str(f"{kept} steps kept")
        try:
            with contextlib.closing(
                run_each(function, lambda running: next(queue, None), config.workers)
            ) as results:
                for number in results:
                    kept += _kept(paths[number])
                    bar.update()
                    bar.set_postfix_str(f"{kept} steps kept")
        except KeyboardInterrupt:
            return False
        except BrokenProcessPool as error:
            raise DexFlexError(
                "A worker process died (out of memory?). Finished shards are kept: run the same command "
                "again, with --workers=1 if it dies again."
            ) from error
    return True


def _run_each(config: CorpusConfig, commit: str, jobs: tuple[tuple[str, int], ...], number: int) -> int:
    split, job = jobs[number]
    run_job(config, commit, split, job)
    return number


def _kept(path: Path) -> int:
    return int(read_header(path)["totals"]["steps"])
