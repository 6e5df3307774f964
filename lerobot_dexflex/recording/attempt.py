"""One attempt at a task: run it, keep it in a file that is either whole or absent."""

import contextlib
import functools
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.families import CLEAN, CommandErrors
from lerobot_dexflex.commands.glove import GlovedHand
from lerobot_dexflex.commands.source import check_source
from lerobot_dexflex.conventions import LEROBOT_KEYS
from lerobot_dexflex.envs.registration import NAMESPACE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.command import Command, fingertips_of
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces import Interface, make_interface
from lerobot_dexflex.recording.schema import columns, privileged_columns, rounded


@dataclass(frozen=True)
class Attempt:
    """What one attempt left behind."""

    index: int
    """Number of the attempt; its environment seed is `seed`."""
    seed: int
    success: bool
    steps: int
    """Control steps until the episode ended."""
    progress: float
    """The task's progress in [0, 1] at the end."""
    frames: dict[str, NDArray]
    """Columns of the dataset, shape (steps, ...); empty unless the attempt is kept, with recording on."""
    kept: bool
    """Whether it is an episode of the dataset: of an expert those that succeed, of a person as he decides."""

    def summary(self) -> dict[str, Any]:
        """Return everything but the frames."""
        return {
            "attempt": self.index,
            "seed": self.seed,
            "success": self.success,
            "kept": self.kept,
            "steps": self.steps,
            "progress": round(self.progress, 4),
        }


class Take:
    """An attempt under way: executes commands, and keeps what a dataset needs of each step.

    The frame at step k holds the observation before the step and the operator's label; the environment
    executes the label plus the operator's natural unsteadiness.

    Args:
        env: The task; it is reset.
        seed: Of its initial state.
        hand: Executes commands.
        keep: Whether frames are kept; without, only the outcome is.
    """

    def __init__(self, env: gymnasium.Env, seed: int, hand: GlovedHand, keep: bool) -> None:
        self._env, self._hand, self._keep, self.seed = env, hand, keep, seed
        self._robot: Hand = env.get_wrapper_attr("hand")
        self.observation, self.info = env.reset(seed=seed)
        self.steps = 0
        self._frames: list[dict[str, NDArray]] = []

    @property
    def success(self) -> bool:
        """Whether the task is done."""
        return bool(self.info["is_success"])

    def step(self, command: Command) -> bool:
        """Execute a command; return whether the environment says that the episode is over."""
        command = self._hand.move(self.observation, command)
        if self._keep:
            loads = self._env.get_wrapper_attr("pad_forces")
            self._frames.append(_frame(self._robot, self.observation, command, loads))
        self.observation, _, terminated, truncated, self.info = self._env.step(command.executed)
        self.steps += 1
        return terminated or truncated

    def attempt(self, index: int, kept: bool) -> Attempt:
        """Return what it left behind; frames only if it is kept.

        Args:
            index: Its number.
            kept: Whether it is an episode of the dataset.
        """
        robot = self._robot
        table = columns(robot, self._env.get_wrapper_attr("joints")) | privileged_columns(robot)
        frames = _stack(self._frames, table) if self._frames and kept else {}
        progress = float(self.info["progress"])
        return Attempt(index, self.seed, self.success, self.steps, progress, frames, kept)


def run_attempt(
    hand: Hand,
    task: str,
    seed: int,
    index: int,
    cameras: bool = True,
    interface: str = "joint",
    glove: str = CLEAN,
    source: str = "motion",
    controller: str = "",
) -> Attempt:
    """Let the expert attempt the task once.

    Args:
        hand: The hand that does it.
        task: Name in `TASKS`.
        seed: Seed of the recording; the episode starts from environment seed `seed + index`.
        index: Number of the attempt.
        cameras: Render and keep the frames; without, only the outcome is returned.
        interface: See `RecordConfig`.
        glove: See `RecordConfig`.
        source: See `RecordConfig`.
        controller: See `RecordConfig`.

    Raises:
        DexFlexError: If the task has no expert or the interface no controller.
    """
    expert = make_expert(task)
    options: dict[str, Any] = {} if cameras else {"cameras": ()}
    env = gymnasium.make(f"{NAMESPACE}/{task}", hand=hand, disable_env_checker=True, **options)
    try:
        errors, below = CommandErrors.parse(glove), _interface(hand, interface, controller)
        gloved = GlovedHand(below, errors, (seed, index, 1), check_source(source))
        return _run(env, expert, seed, index, cameras, gloved)
    finally:
        env.close()


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Let networks add up in one order: more threads change last bits, and contacts make them visible."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@functools.cache
def _interface(hand: Hand, name: str, controller: str) -> Interface:
    """Return this process's interface; a controller takes a second to load."""
    return make_interface(hand, name, controller)


def _run(env: gymnasium.Env, expert: Any, seed: int, index: int, keep: bool, hand: GlovedHand) -> Attempt:
    take = Take(env, seed + index, hand, keep)
    for command in expert(env.unwrapped, np.random.default_rng((seed, index))):
        if take.step(command):
            break
    return take.attempt(index, kept=take.success)


def _frame(hand: Hand, observation: dict[str, Any], command: Command, loads: NDArray) -> dict[str, NDArray]:
    images = {f"observation.images.{name}": image for name, image in observation["pixels"].items()}
    numbers = {key: observation[name] for name, key in LEROBOT_KEYS.items()}
    joints = command.joint_targets
    action = np.concatenate([joints, fingertips_of(hand, joints[-hand.n_joints :]).ravel()])
    privileged = {"operator.draft": command.draft[0].ravel(), "contact.loads": loads}
    return images | numbers | {"action": action} | privileged


def _stack(frames: list[dict[str, NDArray]], table: dict[str, Any]) -> dict[str, NDArray]:
    stacked = {key: np.stack([frame[key] for frame in frames]) for key in frames[0]}
    return {
        key: rounded(values, table[key].steps) if key in table else values for key, values in stacked.items()
    }


def attempt_path(folder: Path, index: int) -> Path:
    """Return the file of an attempt."""
    return folder / f"attempt_{index:06d}.npz"


def save_attempt(attempt: Attempt, folder: Path) -> None:
    """Write an attempt to `folder`; a reader never sees half a file."""
    path = attempt_path(folder, attempt.index)
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    head = {f"head.{name}": value for name, value in vars(attempt).items() if name != "frames"}
    arrays: dict[str, Any] = head | attempt.frames
    try:
        with temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def load_attempt(path: Path, frames: bool = True) -> Attempt:
    """Read what `save_attempt` wrote, without its frames if they are not needed.

    Raises:
        DexFlexError: If the file is no attempt.
    """
    try:
        with np.load(path) as file:
            head = {key.removeprefix("head."): file[key].item() for key in file if key.startswith("head.")}
            kept = {key: file[key] for key in file if frames and not key.startswith("head.")}
        attempt = Attempt(**head, frames=kept)
        _check_loaded(attempt, path, frames)
    except (OSError, ValueError, TypeError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        raise DexFlexError(
            f"{path} is no recorded attempt ({error}); delete it to record it again."
        ) from error
    return attempt


def _check_loaded(attempt: Attempt, path: Path, frames: bool) -> None:
    if type(attempt.success) is not bool:
        raise ValueError(f"success must be true or false, got {attempt.success!r}")
    if path != attempt_path(path.parent, attempt.index):
        raise ValueError(f"it is attempt {attempt.index}")
    steps = {len(values) for values in attempt.frames.values()}
    if type(attempt.kept) is not bool:
        raise ValueError(f"kept must be true or false, got {attempt.kept!r}")
    if frames and steps != ({attempt.steps} if attempt.kept else set()):
        raise ValueError(f"columns of {sorted(steps)} frames in {attempt.steps} steps")
