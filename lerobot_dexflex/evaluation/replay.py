"""Execute recorded actions again, from the initial states they were recorded in."""

import functools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.disturbed import DisturbedInterface
from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.conventions import (
    COMMANDED,
    DRAFT_HORIZON,
    DRAFTS,
    FINGERTIPS,
    LEROBOT_KEYS,
    MEASURED,
    STATE,
)
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation import rollout
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import HANDS, Hand
from lerobot_dexflex.interfaces.method import Method, make_interface
from lerobot_dexflex.recording.schema import FPS, columns, robot_of, robot_type
from lerobot_dexflex.recording.staging import RECORD_FILE
from lerobot_dexflex.runs.provenance import Version, method_version

_PARQUET = "data/*/*.parquet"


@dataclass(frozen=True)
class Demonstrations:
    """The actions of a recorded dataset and where they come from."""

    root: Path
    hand: Hand
    task: str
    seeds: tuple[int, ...]
    """Environment seed of each episode."""
    actions: tuple[NDArray[np.float32], ...]
    """Joint targets [rad] and commanded fingertips [m] per step. Shapes (steps, joints + 3 fingers)."""
    measured: tuple[NDArray[np.float32], ...]
    """Where the fingertips were one step after each action [m]; the last step repeats its own. Shapes
    (steps, 3 fingers)."""
    expert: tuple[int, int]
    """Successes and attempts of the expert while recording; only successes were kept."""

    def played(self, draft: str) -> dict[int, NDArray[np.float32]]:
        """Return by seed what is replayed: joint targets and fingertips, each as `actions`.

        Args:
            draft: Which fingertips, one of `DRAFTS`.
        """
        if draft == COMMANDED:
            return dict(zip(self.seeds, self.actions, strict=True))
        joints = [actions[:, : -3 * self.hand.n_fingers] for actions in self.actions]
        parts = zip(joints, self.measured, strict=True)
        return dict(zip(self.seeds, (np.concatenate(both, 1) for both in parts), strict=True))


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
    names, robot = info["features"].get("action", {}).get("names"), info.get("robot_type")
    ours = [robot_type(hand, robot_joints(hand)) for hand in HANDS.values()]
    if robot not in ours or names != columns(*robot_of(robot))["action"].names or info["fps"] != FPS:
        raise DexFlexError(
            f"{root} holds another robot or rate: robot_type {robot!r}, {info['fps']} fps. Replay needs "
            f"{' or '.join(ours)} at {FPS} fps, with joint targets and commanded fingertips as action."
        )
    files = sorted(root.glob(_PARQUET))
    tables = [pq.read_table(file, columns=["episode_index", "action", FINGERTIPS]) for file in files]
    index = np.concatenate([table["episode_index"].to_numpy() for table in tables])
    values, tips = (
        np.concatenate([np.stack(table[key].to_numpy()) for table in tables])
        for key in ("action", FINGERTIPS)
    )
    seeds = tuple(record["episode_seeds"])
    expert = (record["expert"]["successes"], record["expert"]["attempts"])
    actions = tuple(values[index == k] for k in range(len(seeds)))
    measured = tuple(_one_step_later(tips[index == k]) for k in range(len(seeds)))
    hand, _ = robot_of(robot)
    return Demonstrations(root, hand, record["recipe"]["task"], seeds, actions, measured, expert)


def _one_step_later(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.concatenate([values[1:], values[-1:]])


class ReplayController:
    """Plays recorded actions through an interface; holds the last one when they end.

    Args:
        hand: The hand that was recorded.
        actions: Joint targets [rad], then fingertips [m]. Shape (steps, joints + 3 fingers).
        interface: `joint` executes the joint targets; the others read drafts that lead the fingertips, from
            wherever they are measured, to the recorded ones.
        errors: What goes wrong with the commands; those of joint targets are moved by as much.
    """

    motion: Motion | None = None

    def __init__(
        self, hand: Hand, actions: NDArray[np.float32], interface: str, errors: CommandErrors = NO_ERRORS
    ) -> None:
        self._actions = torch.from_numpy(np.array(actions, np.float64))
        self._interface = DisturbedInterface(make_interface(hand, interface), errors)
        self._step = 0

    def reset(self, seeds: Sequence[int]) -> None:
        """Start from the first action."""
        if len(seeds) != 1:
            raise DexFlexError(f"A replay runs one episode at a time. Got {len(seeds)} seeds.")
        self._interface.reset()
        self._interface.begin(seeds)
        self._step = 0

    def act(self, observation: dict[str, Any], task: str) -> NDArray[np.floating]:
        """Return the next joint targets [rad]. Shape (1, joints)."""
        del task
        ahead = [min(self._step + k, len(self._actions) - 1) for k in range(DRAFT_HORIZON)]
        hand, planned = self._interface.hand, self._actions[ahead]
        joints, tips = planned[:, : -3 * hand.n_fingers], planned[:, -3 * hand.n_fingers :]
        state = {
            key: torch.from_numpy(observation[name]).double()
            for name, key in LEROBOT_KEYS.items()
            if name in observation
        }
        if self._interface.command_space == "joint":
            draft = joints[None, :, -hand.n_joints :]
        else:
            here = fingertips(hand, state[STATE][:, -hand.n_joints :])
            draft = tips.reshape(1, -1, hand.n_fingers, 3) - here[:, None]
        self._step += 1
        targets = self._interface.step(state, draft)
        return torch.cat([joints[:1, : -hand.n_joints], targets], dim=1).numpy()


@dataclass(frozen=True)
class Replays:
    """A dataset's actions as players: of each seed, what was recorded from it.

    Raises:
        DexFlexError: If `draft` is none of `DRAFTS`.
    """

    root: Path
    """Folder of the dataset."""
    draft: str = MEASURED
    """Which fingertips are replayed: `measured` ones, one step after each action, or `commanded` ones."""

    def __post_init__(self) -> None:
        if self.draft not in DRAFTS:
            raise DexFlexError(f"`draft` must be {' or '.join(DRAFTS)}. Got {self.draft!r}.")

    def __call__(self, method: str, errors: CommandErrors = NO_ERRORS) -> "Replayer":
        """Replay through a method, with errors of the commands."""
        return Replayer(self.hand, _demonstrations(self.root).played(self.draft), method, errors)

    @property
    def hand(self) -> Hand:
        """The hand that was recorded."""
        return _demonstrations(self.root).hand

    def check(self, methods: Sequence[str]) -> None:
        """Refuse what cannot run, before anything does.

        Raises:
            DexFlexError: If the folder is no dataset, or a method or its controller does not exist.
        """
        _demonstrations(self.root)
        for name in methods:
            Method.parse(name).weights(self.hand)

    def version(self, method: str, task: str, **settings: Any) -> Version:
        """Return what decides a method's episodes; the recorded actions count as weights."""
        parsed = Method.parse(method)
        modules = (rollout.__name__, type(self).__module__, TASKS[task].module, *parsed.modules)
        recorded = (self.root / RECORD_FILE, *sorted(self.root.glob(_PARQUET)))
        return method_version(
            modules, (*recorded, *parsed.weights(self.hand)), method=parsed.name, draft=self.draft, **settings
        )


class Replayer:
    """Replays, one at a time, the episode that was recorded from a seed. Satisfies `Controller`.

    Args:
        hand: The hand that was recorded.
        actions: What was recorded, by seed.
        method: See `ReplayController`.
        errors: See `ReplayController`.
    """

    def __init__(
        self, hand: Hand, actions: Mapping[int, NDArray[np.float32]], method: str, errors: CommandErrors
    ) -> None:
        self._hand, self._actions, self._method, self._errors = hand, actions, method, errors

    @property
    def motion(self) -> Motion | None:
        """See `Controller.motion`."""
        return self._playing.motion

    def reset(self, seeds: Sequence[int]) -> None:
        """Start the episode of a seed."""
        self._playing = ReplayController(self._hand, self._actions[seeds[0]], self._method, self._errors)
        self._playing.reset(seeds)

    def act(self, observation: dict[str, Any], task: str) -> NDArray[np.floating]:
        """Return the next joint targets [rad]. Shape (1, joints)."""
        return self._playing.act(observation, task)


@functools.cache
def _demonstrations(root: Path) -> Demonstrations:
    return load_demonstrations(root)
