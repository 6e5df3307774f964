"""Kill recordings, corpora, trainings and comparisons at random moments, go on, and count what was lost.

python eval/kill_test.py --kills=50

Each program runs once undisturbed; then it is started again and again and killed (SIGKILL, the main process
only) after a random time. After every kill its workers must be gone and everything that was finished must
still be there; the next start must go on; what stands there at the end must equal what the undisturbed run
left.
"""

import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
from safetensors.numpy import load_file
from tqdm import tqdm

from lerobot_dexflex import console
from lerobot_dexflex.errors import DexFlexError

_ROOT = Path(__file__).resolve().parents[1]
_BIN = Path(sys.executable).parent
_CORPUS = _ROOT / "outputs/corpus/sample"
"""Made by `dexflex-corpus --config=configs/corpus/sample.yaml`."""
_ORPHAN_SECONDS = 10.0

Digest = dict[str, str]
"""Name of a finished piece of work, and a digest of what it holds."""


def files(folder: Path, *patterns: str) -> Digest:
    """Return digests of files by their path in a folder."""
    found = [path for pattern in patterns for path in folder.glob(pattern)]
    return {p.relative_to(folder).as_posix(): _digest(p.read_bytes()) for p in found}


def tensors(folder: Path, pattern: str) -> Digest:
    """Return digests of the tensors in safetensors files; their headers tell how long they took."""
    found = {}
    for path in folder.glob(pattern):
        content = b"".join(k.encode() + v.tobytes() for k, v in sorted(load_file(path).items()))
        found[path.relative_to(folder).as_posix()] = _digest(content)
    return found


def rows(folder: Path) -> Digest:
    """Return digests of the whole rows of a comparison's table, by method and seed."""
    path = folder / "tasks.csv"
    text = path.read_text() if path.exists() else ""
    whole = text[: text.rfind("\n") + 1].splitlines()[1:]
    return {",".join(line.split(",")[:5]): _digest(line.encode()) for line in whole}


@dataclass(frozen=True)
class Program:
    """A program that can be killed.

    Args:
        command: Words; `{output}` is its folder.
        kept: Given the folder, every finished piece of work; none may ever get lost or change.
        result: Given the folder, what the finished run is compared by.
    """

    command: tuple[str, ...]
    kept: Callable[[Path], Digest]
    result: Callable[[Path], Digest]


PROGRAMS = {
    "recording": Program(
        (
            str(_BIN / "dexflex-record"),
            "--root={output}/set",
            "--task=PlaceHammer-v0",
            "--episodes=2",
            "--workers=1",
        ),
        lambda folder: files(folder, "set.partial/*.npz"),
        lambda folder: files(folder, "set/data/**/*.parquet", "set/videos/**/*.mp4", "set/meta/stats.json"),
    ),
    "corpus": Program(
        (
            *(str(_BIN / "dexflex-corpus"), "--output={output}/corpus", "--objects_per_job=1"),
            *("--workers=1", "--steps_per_object=120", "--jobs.train=3", "--jobs.tune=0", "--jobs.test=0"),
        ),
        lambda folder: tensors(folder, "corpus/train/*.safetensors"),
        lambda folder: tensors(folder, "corpus/train/*.safetensors"),
    ),
    "training": Program(
        (
            *(str(_BIN / "dexflex-train"), f"--corpus={_CORPUS}", "--output={output}/controller"),
            *("--stages=[encoder_prior, dexgen]", "--encoder_prior.fit.steps=60"),
            *("--encoder_prior.fit.checkpoint_seconds=2", "--dexgen.fit.checkpoint_seconds=2"),
            *("--dexgen.fit.steps=60", "--encoder_prior.fit.batch_size=64", "--dexgen.fit.batch_size=64"),
        ),
        lambda folder: files(folder, "controller/*/weights.pt"),
        lambda folder: files(folder, "controller/controller/*.safetensors"),
    ),
    "comparison": Program(
        (
            *(sys.executable, str(_ROOT / "eval/compare_interfaces.py"), "--output={output}/compare"),
            *(
                "--tasks=PlaceHammer-v0",
                "--methods=raw,press",
                "--operator=true",
                "--episodes=4",
                "--videos=0",
            ),
            *("--seed=50000", "--workers=1"),
        ),
        lambda folder: rows(folder / "compare"),
        lambda folder: rows(folder / "compare"),
    ),
}


@dataclass
class KillConfig:
    """Kill programs at random moments and count what was lost."""

    programs: str = ",".join(PROGRAMS)
    """Which, separated by commas."""
    kills: int = 50
    """Kills of each."""
    seed: int = 0
    """Of the moments."""
    folder: Path = Path(tempfile.gettempdir())
    """Where the programs work, in a folder of their own that is removed."""

    def __post_init__(self) -> None:
        if unknown := [name for name in self.names if name not in PROGRAMS]:
            raise DexFlexError(f"Unknown programs {', '.join(unknown)}. Valid: {', '.join(PROGRAMS)}.")
        if self.kills < 1:
            raise DexFlexError(f"`kills` must be at least 1. Got {self.kills}.")

    @property
    def names(self) -> list[str]:
        """Names of the programs."""
        return [name.strip() for name in self.programs.split(",") if name.strip()]


@dataclass
class Losses:
    """What many kills of one program cost."""

    kills: int = 0
    finished: int = 0
    """Runs that came to their end between kills."""
    different: int = 0
    """Of these, the runs whose result is not that of the undisturbed run."""
    lost: int = 0
    """Finished pieces of work that were gone or changed after a kill."""
    orphans: int = 0
    """Workers that lived on 10 s after their parent."""
    unusable: int = 0
    """Starts that were refused or crashed."""
    messages: list[str] = field(default_factory=list)


def torture(program: Program, kills: int, rng: random.Random, folder: Path) -> Losses:
    """Kill a program so many times; see the module."""
    undisturbed = folder / "undisturbed"
    begun = time.monotonic()
    process = _start(program, undisturbed)
    if process.wait():
        raise DexFlexError(f"{' '.join(program.command)} fails even undisturbed:\n{_said(undisturbed)}")
    seconds, expected = time.monotonic() - begun, program.result(undisturbed)
    losses, number, before = Losses(), 0, {}
    with tqdm(total=kills, unit="kill", desc=folder.name) as bar:
        while losses.kills < kills:
            output = folder / f"run{number}"
            process = _start(program, output)
            try:
                status = process.wait(timeout=rng.uniform(0.0, 1.1 * seconds))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
                losses.kills += 1
                losses.orphans += _orphans(process.pid)
                bar.update()
                now = program.kept(output)
                if now:  # A finished recording removes its attempts when the dataset stands.
                    losses.lost += sum(now.get(name) != digest for name, digest in before.items())
                before = now or before
                continue
            if status:
                losses.unusable += 1
                losses.messages.append(_said(output))
            else:
                losses.finished += 1
                losses.different += program.result(output) != expected
            number, before = number + 1, {}
    return losses


def _start(program: Program, output: Path) -> subprocess.Popen:
    output.mkdir(parents=True, exist_ok=True)
    command = [word.format(output=output) for word in program.command]
    with (output / "said.txt").open("ab") as said:
        return subprocess.Popen(command, stdout=said, stderr=said, cwd=_ROOT, start_new_session=True)


def _orphans(session: int) -> int:
    """Return how many processes of a session live on after a while."""
    deadline = time.monotonic() + _ORPHAN_SECONDS
    while (count := len(_living(session))) and time.monotonic() < deadline:
        time.sleep(0.1)
    for pid in _living(session):
        os.kill(pid, signal.SIGKILL)
    return count


def _living(session: int) -> list[int]:
    found = subprocess.run(["ps", "-o", "pid=", "-s", str(session)], capture_output=True, text=True)
    return [int(word) for word in found.stdout.split()]


def _said(output: Path) -> str:
    return (output / "said.txt").read_text(errors="replace")[-2000:]


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _run(config: KillConfig, words: Sequence[str]) -> int:
    del words
    table = {}
    for name in config.names:
        with tempfile.TemporaryDirectory(dir=config.folder) as folder:
            home = Path(folder) / name
            home.mkdir()
            losses = torture(PROGRAMS[name], config.kills, random.Random(config.seed), home)
        for message in losses.messages:
            print(message, file=sys.stderr)
        table[name] = {key: value for key, value in vars(losses).items() if key != "messages"}
        print(pd.DataFrame(table).T.to_string(), flush=True)
    bad = ("different", "lost", "orphans", "unusable")
    return int(any(numbers[key] for numbers in table.values() for key in bad))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(console.run(KillConfig, _run, None))
