"""One attempt of the expert: run it, keep it in a file that is either whole or absent."""

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
from numpy.typing import NDArray

from lerobot_dexflex.commands.families import CLEAN, CommandErrors
from lerobot_dexflex.commands.glove import GlovedHand
from lerobot_dexflex.commands.source import check_source
from lerobot_dexflex.conventions import LEROBOT_KEYS
from lerobot_dexflex.envs.registration import NAMESPACE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.command import Command, fingertips_of
from lerobot_dexflex.interfaces import Interface, make_interface
from lerobot_dexflex.interfaces.commanded_hand import N_JOINTS
from lerobot_dexflex.recording.schema import columns, privileged_columns, rounded


@dataclass(frozen=True)
class Attempt:
    """What one attempt of the expert left behind."""

    index: int
    """Number of the attempt; its environment seed is `seed`."""
    seed: int
    success: bool
    steps: int
    """Control steps until the episode ended."""
    progress: float
    """The task's progress in [0, 1] at the end."""
    frames: dict[str, NDArray]
    """Columns of the dataset, shape (steps, ...); empty unless the attempt succeeded with recording on."""

    def summary(self) -> dict[str, Any]:
        """Return everything but the frames."""
        return {
            "attempt": self.index,
            "seed": self.seed,
            "success": self.success,
            "steps": self.steps,
            "progress": round(self.progress, 4),
        }


def run_attempt(
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

    The frame at step k holds the observation before the step and the expert's label; the environment
    executes the label plus the expert's natural unsteadiness.

    Args:
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
    env = gymnasium.make(f"{NAMESPACE}/{task}", disable_env_checker=True, **options)
    try:
        errors, below = CommandErrors.parse(glove), _interface(interface, controller)
        hand = GlovedHand(below, errors, (seed, index, 1), check_source(source))
        return _run(env, expert, seed, index, cameras, hand)
    finally:
        env.close()


@functools.cache
def _interface(name: str, controller: str) -> Interface:
    """Return this process's interface; a controller takes a second to load."""
    return make_interface(name, controller)


def _run(env: gymnasium.Env, expert: Any, seed: int, index: int, keep: bool, hand: GlovedHand) -> Attempt:
    observation, info = env.reset(seed=seed + index)
    commands: Iterator[Command] = expert(env.unwrapped, np.random.default_rng((seed, index)))
    frames: list[dict[str, NDArray]] = []
    steps = 0
    for command in commands:
        command = hand.move(observation, command)
        if keep:
            frames.append(_frame(observation, command, env.get_wrapper_attr("pad_forces")))
        observation, _, terminated, truncated, info = env.step(command.executed)
        steps += 1
        if terminated or truncated:
            break
    success = bool(info["is_success"])
    table = columns(env.get_wrapper_attr("joints")) | privileged_columns()
    kept = _stack(frames, table) if keep and success else {}
    return Attempt(index, seed + index, success, steps, float(info["progress"]), kept)


def _frame(observation: dict[str, Any], command: Command, loads: NDArray) -> dict[str, NDArray]:
    images = {f"observation.images.{name}": image for name, image in observation["pixels"].items()}
    numbers = {key: observation[name] for name, key in LEROBOT_KEYS.items()}
    joints = command.joint_targets
    action = np.concatenate([joints, fingertips_of(joints[-N_JOINTS:]).ravel()])
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
    if frames and steps != ({attempt.steps} if attempt.success else set()):
        raise ValueError(f"columns of {sorted(steps)} frames in {attempt.steps} steps")
