"""Let a policy learn where the fingertips were measured, beside what was commanded.

A dataset's action holds commanded fingertips, which press. Where the fingertips should be after step t,
without force, is where they were measured at step t + 1; the last step of an episode repeats its own. LeRobot
0.6.1 reads windows of all observations or of none, so each item of a named dataset gets these as `NEXT_TIPS`,
over the steps of its action. A policy that misses them in a batch refuses it, rather than learn the commanded
ones unawares.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import torch
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_dexflex.conventions import FINGERTIPS
from lerobot_dexflex.errors import DexFlexError
from lerobot_policy_dexflex.lerobot_command import renamed

NEXT_TIPS = "observation.next_fingertips"
"""Measured fingertips one step after each step of the action [m]. Shape (batch, chunk, 3 fingers)."""
_lerobot_getitem = LeRobotDataset.__getitem__
_columns: dict[Path, str] = {}
_tips: "WeakKeyDictionary[DatasetReader, _Tips]" = WeakKeyDictionary()


def add_measured_tips(meta: Any) -> None:
    """Give every item of a dataset `NEXT_TIPS`, in this process and in those that load it for this one.

    Args:
        meta: Its `LeRobotDatasetMetadata`; the names of --rename_map count.
    """
    column = renamed({key: key for key in meta.features})[FINGERTIPS]
    # Loaders that LeRobot spawns get the dataset pickled, its metadata with it, and nothing else from here.
    meta.dexflex_measured_tips = _Note(str(meta.root), column)
    _serve(str(meta.root), column)


class _Note:
    """Brings `add_measured_tips` into the process that it is unpickled in."""

    def __init__(self, root: str, column: str) -> None:
        self._arguments = root, column

    def __reduce__(self) -> tuple[Any, tuple[str, str]]:
        return _arrive, self._arguments


def _arrive(root: str, column: str) -> _Note:
    _serve(root, column)
    return _Note(root, column)


def _serve(root: str, column: str) -> None:
    _columns[Path(root)] = column
    LeRobotDataset.__getitem__ = _getitem  # pyright: ignore[reportAttributeAccessIssue]


def _getitem(dataset: LeRobotDataset, idx: Any) -> Any:
    """Stand in for `LeRobotDataset.__getitem__`."""
    item = _lerobot_getitem(dataset, idx)
    column = _columns.get(Path(dataset.root))
    if column is not None and isinstance(item, dict):  # A slice consists of items that came here themselves.
        item[NEXT_TIPS] = _next_tips(dataset, item, column)
    return item


class _Tips(NamedTuple):
    """The measured fingertips of a dataset's selected episodes."""

    frames: Tensor
    """Number of every row in the whole dataset, ascending. Shape (rows,)."""
    values: Tensor
    """[m]. Shape (rows, 3 fingers)."""


def _next_tips(dataset: LeRobotDataset, item: Mapping[str, Any], column: str) -> Tensor:
    reader = dataset.reader
    assert reader is not None
    if reader not in _tips:
        _tips[reader] = _read(reader, column)
    known, values = _tips[reader]
    episodes = dataset.meta.episodes
    assert episodes is not None
    end = int(episodes[int(item["episode_index"])]["dataset_to_index"])
    windows = reader.delta_indices or {}
    frames = int(item["index"]) + torch.tensor(windows.get(ACTION, [0]))
    found = values[torch.searchsorted(known, (frames + 1).clamp(max=end - 1))]
    return found if ACTION in windows else found[0]


def _read(reader: DatasetReader, column: str) -> _Tips:
    assert reader.hf_dataset is not None
    numbers = reader.hf_dataset.select_columns(["index", column]).with_format("numpy")[:]
    return _Tips(torch.from_numpy(numbers["index"]), torch.from_numpy(np.stack(numbers[column])))


def measured_tips(batch: Mapping[str, Tensor]) -> Tensor:
    """Return where the fingertips were measured one step after each of a batch's actions [m].

    Args:
        batch: Holds `NEXT_TIPS`.

    Returns:
        Shape (batch, chunk, 3 fingers).

    Raises:
        DexFlexError: If `NEXT_TIPS` are missing: the loader is not the one that `add_measured_tips` prepared.
    """
    if NEXT_TIPS not in batch:
        raise DexFlexError(
            f"The batch lacks {NEXT_TIPS!r}: measured fingertips are added to the items of a LeRobotDataset, "
            "not to a stream's, and to those of a held-out split only in this process. Give "
            "--dataset.streaming=false --num_workers=0, or do not learn them: "
            "--policy.learns=[joint,commanded]."
        )
    return batch[NEXT_TIPS]
