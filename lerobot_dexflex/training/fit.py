"""The training loop that all stages share: AdamW, cosine, moving average, held-out metrics, resuming."""

import copy
import json
import math
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import Tensor, nn
from tqdm import tqdm

from lerobot_dexflex.errors import DexFlexError

RESUME, DONE = "resume.pt", "weights.pt"
_PROGRESS_SECONDS = 5.0


@dataclass
class FitConfig:
    """How a stage is trained."""

    steps: int = 10_000
    """Optimiser steps; 0 skips the training."""
    max_minutes: float = 0.0
    """Stop, with the schedule completed, after so many minutes of training [min]; 0 means no bound."""
    batch_size: int = 256
    """Rows per step."""
    lr: float = 1e-3
    """Peak learning rate."""
    weight_decay: float = 0.01
    warmup_steps: int = 200
    """Steps of linear warm-up."""
    clip: float = 1.0
    """Largest gradient norm."""
    ema: float = 0.999
    """Decay of the moving average of weights; shorter at the beginning."""
    evaluate_every: int = 1000
    """Steps between held-out metrics; they are always computed at the end."""
    checkpoint_seconds: float = 60.0
    """Time between resumable states [s]."""


class Stage(ABC):
    """One part of the controller in training; knows its data and losses, not the loop.

    Args:
        network: What is trained.
    """

    name: str

    def __init__(self, network: nn.Module) -> None:
        self.network = network.train().requires_grad_(True)
        self.average = copy.deepcopy(network).eval().requires_grad_(False)

    @abstractmethod
    def batch(self) -> Any:
        """Draw a batch from torch's global generator."""

    @abstractmethod
    def loss(self, batch: Any) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss of `network` and its parts."""

    @abstractmethod
    def evaluate(self) -> dict[str, float]:
        """Return held-out metrics of `average`; NaN where one is not defined."""


def fit(stage: Stage, config: FitConfig, folder: Path, seed: int) -> dict[str, float]:
    """Train a stage, or go on where it was interrupted.

    Leaves averaged weights in `weights.pt`, numbers in `metrics.jsonl` and curves in `metrics.png`.

    Args:
        stage: What to train; ends with the averaged weights in `stage.average`.
        config: How.
        folder: Where state and results are kept.
        seed: Seed of all random draws.

    Returns:
        The last held-out metrics.

    Raises:
        KeyboardInterrupt: After an interrupt, with a resumable state on disk.
        DexFlexError: If the loss is not finite.
    """
    folder.mkdir(parents=True, exist_ok=True)
    run = _Run(stage, config, folder, seed)
    with _interrupt_flag() as interrupted:
        run.train(interrupted)
    metrics = run.evaluate()
    _write(folder / DONE, {"weights": stage.average.state_dict(), "metrics": metrics})
    (folder / RESUME).unlink(missing_ok=True)
    from lerobot_dexflex.training.curves import plot_curves

    plot_curves(folder)
    return metrics


def load_finished(network: nn.Module, folder: Path) -> dict[str, float] | None:
    """Load the averaged weights of a finished stage; returns its metrics, or None if it is not finished.

    Raises:
        DexFlexError: If the weights are those of another network.
    """
    if not (folder / DONE).is_file():
        return None
    done = _read(folder / DONE)
    try:
        network.load_state_dict(done["weights"])
    except RuntimeError as error:
        raise DexFlexError(
            f"{folder / DONE} holds weights of another network: {error}. Train into another `output`."
        ) from error
    except KeyError as error:
        raise DexFlexError(f"{folder / DONE} lacks {error}. Delete {folder} to train it anew.") from error
    return done["metrics"]


class _Run:
    def __init__(self, stage: Stage, config: FitConfig, folder: Path, seed: int) -> None:
        self.stage, self.config, self.folder = stage, config, folder
        parameters = list(stage.network.parameters())
        self.optimizer = torch.optim.AdamW(
            parameters, lr=config.lr, weight_decay=config.weight_decay, fused=True
        )
        self.step, self.seconds = 0, 0.0
        torch.manual_seed(seed)
        if (folder / RESUME).is_file():
            self._load()
        else:
            (folder / "metrics.jsonl").unlink(missing_ok=True)
        self._pairs = list(zip(stage.average.parameters(), parameters, strict=True))

    def train(self, interrupted: threading.Event) -> None:
        config, bar = self.config, tqdm(total=self.config.steps, initial=self.step, desc=self.stage.name)
        saved = shown = time.monotonic()
        while self.step < config.steps and self._progress() < 1:
            begin = time.monotonic()
            info = self._update()
            self.step += 1
            now = time.monotonic()
            self.seconds += now - begin
            bar.update()
            if now - shown > _PROGRESS_SECONDS or self.step == config.steps:
                shown = now
                numbers = {name: float(value) for name, value in info.items()}
                self._log(numbers)
                bar.set_postfix({name: f"{value:.3g}" for name, value in numbers.items()})
            if self.step % config.evaluate_every == 0 and self.step < config.steps:
                self.evaluate()
            if interrupted.is_set() or now - saved > config.checkpoint_seconds:
                saved = now
                self._save()
            if interrupted.is_set():
                bar.close()
                raise KeyboardInterrupt
        bar.close()

    def evaluate(self) -> dict[str, float]:
        with torch.random.fork_rng(), torch.no_grad():
            torch.manual_seed(0)
            metrics = {k: v for k, v in self.stage.evaluate().items() if not math.isnan(v)}
        self._log({"held_out": metrics})
        tqdm.write(f"{self.stage.name} {self.step}: " + ", ".join(f"{k} {v:.4g}" for k, v in metrics.items()))
        return metrics

    def _progress(self) -> float:
        """Share of the schedule that is done, by steps or by time."""
        by_time = self.seconds / (60 * self.config.max_minutes) if self.config.max_minutes else 0.0
        return max(self.step / self.config.steps, by_time)

    def _update(self) -> dict[str, Tensor]:
        config = self.config
        warm = min(1.0, (self.step + 1) / max(1, config.warmup_steps))
        rate = config.lr * warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * self._progress())))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        loss, info = self.stage.loss(self.stage.batch())
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.stage.network.parameters(), config.clip)
        if not torch.isfinite(norm):
            raise DexFlexError(
                f"{self.stage.name} diverged at step {self.step}: its loss was {float(loss.detach()):.3g}. "
                "Look for NaN in the corpus, or lower `lr`; the last resumable state is kept."
            )
        self.optimizer.step()
        decay = min(config.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for average, current in self._pairs:
                average.lerp_(current, 1 - decay)
        return {"loss": loss.detach(), **info}

    def _log(self, values: dict[str, Any]) -> None:
        with (self.folder / "metrics.jsonl").open("a") as file:
            file.write(json.dumps({"step": self.step, "seconds": round(self.seconds, 1), **values}) + "\n")

    def _save(self) -> None:
        state = {
            "network": self.stage.network.state_dict(),
            "average": self.stage.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "generator": torch.get_rng_state(),
            "step": self.step,
            "seconds": self.seconds,
        }
        _write(self.folder / RESUME, state)

    def _load(self) -> None:
        state = _read(self.folder / RESUME)
        self.stage.network.load_state_dict(state["network"])
        self.stage.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        torch.set_rng_state(state["generator"])
        self.step, self.seconds = state["step"], state["seconds"]


def _read(path: Path) -> dict[str, Any]:
    """Return what `_write` wrote.

    Raises:
        DexFlexError: If the file is damaged.
    """
    try:
        return torch.load(path, weights_only=True)
    except (OSError, EOFError, RuntimeError, ValueError, UnpicklingError) as error:
        raise DexFlexError(
            f"{path} is damaged ({type(error).__name__}). Delete {path.parent} to train that stage anew."
        ) from error


def _write(path: Path, state: dict[str, Any]) -> None:
    """Replace a file at once, so that an interrupt leaves the old or the new one."""
    temporary = path.with_suffix(".tmp")
    torch.save(state, temporary)
    os.replace(temporary, path)


@contextmanager
def _interrupt_flag() -> Iterator[threading.Event]:
    """Turn the first interrupt into a flag; the second one interrupts as usual."""
    flag = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield flag
        return
    before = signal.getsignal(signal.SIGINT)

    def handle(number: int, frame: Any) -> None:
        del number, frame
        flag.set()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, handle)
    try:
        yield flag
    finally:
        signal.signal(signal.SIGINT, before)
