"""Execute recorded actions again, from the initial states they were recorded in."""

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.disturbed import DisturbedInterface
from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.conventions import DRAFT_HORIZON, LEROBOT_KEYS
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation import rollout
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.hand.model import JOINTS
from lerobot_dexflex.interfaces.method import Method, make_interface
from lerobot_dexflex.recording.schema import FPS, columns
from lerobot_dexflex.recording.staging import RECORD_FILE
from lerobot_dexflex.runs.provenance import Version, method_version

_ARM = 7
_PARQUET = "data/*/*.parquet"


@dataclass(frozen=True)
class Demonstrations:
    """The actions of a recorded dataset and where they come from."""

    root: Path
    task: str
    seeds: tuple[int, ...]
    """Environment seed of each episode."""
    actions: tuple[NDArray[np.float32], ...]
    """23 joint targets [rad] and 12 commanded fingertips [m] per step. Shapes (steps, 35)."""
    expert: tuple[int, int]
    """Successes and attempts of the expert while recording; only successes were kept."""


def load_demonstrations(root: Path) -> Demonstrations:
    """Read the actions of a dataset that `dexflex-record` wrote.

    Raises:
        DexFlexError: If it is no such dataset, or one of another robot or rate.
    """
    record_file, info_file = root / RECORD_FILE, root / "meta/info.json"
    for file in (record_file, info_file):
        if not file.is_file():
            raise DexFlexError(f"{root} is no dataset of dexflex-record: {file} not found. Check --root.")
    record, info = json.loads(record_file.read_text()), json.loads(info_file.read_text())
    names = info["features"].get("action", {}).get("names")
    if names != columns(JOINTS)["action"].names or info["fps"] != FPS:
        raise DexFlexError(
            f"{root} holds another robot or rate: robot_type {info.get('robot_type')!r}, {info['fps']} fps. "
            f"Replay needs leap_xarm7 at {FPS} fps, with joint targets and commanded fingertips as action."
        )
    files = sorted(root.glob(_PARQUET))
    tables = [pq.read_table(file, columns=["episode_index", "action"]) for file in files]
    index = np.concatenate([table["episode_index"].to_numpy() for table in tables])
    values = np.concatenate([np.stack(table["action"].to_numpy()) for table in tables])
    seeds = tuple(record["episode_seeds"])
    expert = (record["expert"]["successes"], record["expert"]["attempts"])
    actions = tuple(values[index == k] for k in range(len(seeds)))
    return Demonstrations(root, record["recipe"]["task"], seeds, actions, expert)


class ReplayController:
    """Plays recorded actions through an interface; holds the last one when they end.

    Args:
        actions: Recorded actions, shape (steps, 35).
        interface: `joint` executes the joint targets; the others read drafts that lead the commanded
            fingertips to the recorded ones.
        errors: What goes wrong with the commands; those of joint targets are moved by as much.
    """

    motion: Motion | None = None

    def __init__(
        self, actions: NDArray[np.float32], interface: str, errors: CommandErrors = NO_ERRORS
    ) -> None:
        self._actions = torch.from_numpy(np.array(actions, np.float64))
        self._interface = DisturbedInterface(make_interface(interface), errors)
        self._step = 0

    def reset(self, seeds: Sequence[int]) -> None:
        """Start from the first action."""
        if len(seeds) != 1:
            raise DexFlexError(f"A replay runs one episode at a time. Got {len(seeds)} seeds.")
        self._interface.reset()
        self._interface.begin(seeds)
        self._step = 0

    def act(self, observation: dict[str, Any], task: str) -> NDArray[np.floating]:
        """Return the next joint targets [rad]. Shape (1, 23)."""
        del task
        ahead = [min(self._step + k, len(self._actions) - 1) for k in range(DRAFT_HORIZON)]
        joints, tips = self._actions[ahead].split([len(JOINTS), 12], dim=1)
        state = {
            key: torch.from_numpy(observation[name]).double()
            for name, key in LEROBOT_KEYS.items()
            if name in observation
        }
        if self._interface.command_space == "joint":
            draft = joints[None, :, _ARM:]
        else:
            start = self._interface.start(state)
            draft = torch.diff(tips.view(1, -1, 4, 3), dim=1, prepend=start[:, None])
        self._step += 1
        hand = self._interface.step(state, draft)
        return torch.cat([joints[:1, :_ARM], hand], dim=1).numpy()


@dataclass(frozen=True)
class Replays:
    """A dataset's actions as players: of each seed, what was recorded from it."""

    root: Path
    """Folder of the dataset."""

    def __call__(self, method: str, errors: CommandErrors = NO_ERRORS) -> "Replayer":
        """Replay through a method, with errors of the commands."""
        return Replayer(_demonstrations(self.root), method, errors)

    def check(self, methods: Sequence[str]) -> None:
        """Refuse what cannot run, before anything does.

        Raises:
            DexFlexError: If the folder is no dataset, or a method or its controller does not exist.
        """
        _demonstrations(self.root)
        for name in methods:
            Method.parse(name).weights()

    def version(self, method: str, task: str, **settings: Any) -> Version:
        """Return what decides a method's episodes; the recorded actions count as weights."""
        parsed = Method.parse(method)
        modules = (rollout.__name__, type(self).__module__, TASKS[task].module, *parsed.modules)
        recorded = (self.root / RECORD_FILE, *sorted(self.root.glob(_PARQUET)))
        return method_version(modules, (*recorded, *parsed.weights()), method=parsed.name, **settings)


class Replayer:
    """Replays, one at a time, the episode that was recorded from a seed. Satisfies `Controller`.

    Args:
        demonstrations: What was recorded.
        method: See `ReplayController`.
        errors: See `ReplayController`.
    """

    def __init__(self, demonstrations: Demonstrations, method: str, errors: CommandErrors) -> None:
        self._actions = dict(zip(demonstrations.seeds, demonstrations.actions, strict=True))
        self._method, self._errors = method, errors

    @property
    def motion(self) -> Motion | None:
        """See `Controller.motion`."""
        return self._playing.motion

    def reset(self, seeds: Sequence[int]) -> None:
        """Start the episode of a seed."""
        self._playing = ReplayController(self._actions[seeds[0]], self._method, self._errors)
        self._playing.reset(seeds)

    def act(self, observation: dict[str, Any], task: str) -> NDArray[np.floating]:
        """Return the next joint targets [rad]. Shape (1, 23)."""
        return self._playing.act(observation, task)


@functools.cache
def _demonstrations(root: Path) -> Demonstrations:
    return load_demonstrations(root)
