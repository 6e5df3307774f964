"""Serve a LeRobotDataset from memory, so that a CPU training is not spent on decoding videos.

LeRobot 0.6.1 decodes every frame of every sample anew and reads all columns of every row of an action
window: 10-20 ms per sample, several times the cost of learning from it. Here each video is decoded once
with LeRobot's own decoder, each column is read once, and items are assembled from the copies. Columns that
nobody reads are left out of both.

`cache_dataset` is the whole interface. It replaces `DatasetReader.get_item` in this process only and only for
the named dataset; anything unexpected leaves LeRobot's own loader in charge, with a warning. Image transforms
are no part of the copies: they are drawn anew for every item, as LeRobot does.
"""

import logging
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import torch
from lerobot.datasets.dataset_reader import DatasetReader
from torch import Tensor
from torch.utils.data import get_worker_info
from tqdm.auto import tqdm

logger = logging.getLogger(__name__)

_ROWS_PER_READ = 512
_lerobot_get_item = DatasetReader.get_item
_limits: "dict[Path, _Limit]" = {}
_caches: "WeakKeyDictionary[DatasetReader, DatasetCache | None]" = WeakKeyDictionary()


class _Limit(NamedTuple):
    """What is kept of a dataset."""

    gigabytes: float
    left_out: frozenset[str]


class CacheRefusedError(RuntimeError):
    """Why a dataset is left to LeRobot's loader."""


def cache_dataset(meta: Any, gigabytes: float, workers: int = 0, left_out: Collection[str] = ()) -> None:
    """Serve the dataset from memory from its first item on, or warn why not and what that costs.

    Args:
        meta: Its `LeRobotDatasetMetadata`.
        gigabytes: Largest memory for the decoded frames and columns [GB]; a dataset that needs more is
            refused. 96 x 96 images take 28 kB per frame and camera: 50 episodes of 230 frames from two
            cameras need 0.65 GB.
        workers: Processes that load the data; each would need a copy of its own, so that only 0 is served.
        left_out: Features that are not read, by their names in the dataset; items lack them.
    """
    if workers:
        _warn(meta.root, f"{workers} worker processes load it. Give --num_workers=0 to use the cache")
        return
    _limits[Path(meta.root)] = _Limit(gigabytes, frozenset(left_out))
    DatasetReader.get_item = _get_item  # pyright: ignore[reportAttributeAccessIssue]


class DatasetCache:
    """All selected rows of a dataset in memory.

    Args:
        reader: The loaded reader of the dataset.
        gigabytes: Memory bound [GB].
        left_out: Features that items lack.

    Raises:
        CacheRefusedError: If the dataset is too large or holds what this cache does not know.
    """

    def __init__(
        self, reader: DatasetReader, gigabytes: float, left_out: Collection[str] = frozenset()
    ) -> None:
        self._reader, self._left_out = reader, left_out
        self._refuse_unknown(gigabytes)
        tasks = reader._meta.tasks
        assert tasks is not None
        self._tasks = tasks
        self._columns = self._read_columns()
        self._frames = {key: self._decode(key) for key in reader._meta.video_keys if key not in left_out}

    def item(self, row: int) -> dict[str, Any]:
        """Return what `DatasetReader.get_item` returns, without what is left out: keys, values, dtypes."""
        reader, columns = self._reader, self._columns
        item: dict[str, Any] = {key: column[row].clone() for key, column in columns.items()}
        rows: dict[str, list[int]] = {}
        if reader.delta_indices is not None:
            rows, padding = self._windows(item)
            padding = {key: value for key, value in padding.items() if not self._omits(key)}
            item |= padding | {key: columns[key][window] for key, window in rows.items() if key in columns}
        frames = {key: self._images(key, rows.get(key, [row])) for key in self._frames}
        item = frames | item
        if reader._image_transforms is not None:
            item |= {key: reader._image_transforms(item[key]) for key in frames}
        item["task"] = self._tasks.iloc[int(item["task_index"])].name
        return item

    def _omits(self, key: str) -> bool:
        return key.removesuffix("_is_pad") in self._left_out

    def without_left_out(self, item: dict[str, Any]) -> dict[str, Any]:
        """Return LeRobot's item without what this cache leaves out."""
        return {key: value for key, value in item.items() if not self._omits(key)}

    def _windows(self, item: dict[str, Any]) -> tuple[dict[str, list[int]], dict[str, Tensor]]:
        reader = self._reader
        absolute, padding = reader._get_query_indices(int(item["index"]), int(item["episode_index"]))
        to_row = reader._absolute_to_relative_idx
        rows = absolute if to_row is None else {k: [to_row[i] for i in v] for k, v in absolute.items()}
        return rows, padding

    def _images(self, key: str, rows: list[int]) -> Tensor:
        frames = self._frames[key][rows].squeeze(0)
        return frames if self._reader._return_uint8 else frames.to(torch.float32) / 255

    def _refuse_unknown(self, gigabytes: float) -> None:
        reader = self._reader
        if reader.hf_dataset is None:
            raise CacheRefusedError("it is not loaded")
        unknown = [k for k in (*reader._meta.image_keys, *reader._meta.depth_keys) if not self._omits(k)]
        if unknown:
            raise CacheRefusedError(f"only videos and numbers are cached, not {unknown}")
        numbers = 0
        for key, feature in reader._meta.features.items():
            if key in self._left_out:
                continue
            elements = torch.Size(feature["shape"]).numel()
            numbers += elements if feature["dtype"] == "video" else 8 * elements
        needed = numbers * len(reader.hf_dataset) / 1e9
        if needed > gigabytes:
            raise CacheRefusedError(
                f"it needs {needed:.1f} GB of memory and the bound is {gigabytes:.1f} GB "
                "(--policy.cache_gigabytes)"
            )

    def _read_columns(self) -> dict[str, Tensor]:
        dataset = self._reader.hf_dataset
        assert dataset is not None
        dataset = dataset.select_columns([key for key in dataset.column_names if key not in self._left_out])
        parts: dict[str, list[Tensor]] = {}
        for begin in range(0, len(dataset), _ROWS_PER_READ):
            for key, values in dataset[begin : begin + _ROWS_PER_READ].items():
                if not all(isinstance(value, Tensor) for value in values):
                    raise CacheRefusedError(f"column {key!r} does not hold numbers")
                parts.setdefault(key, []).append(torch.stack(list(values)))
        return {key: torch.cat(values) for key, values in parts.items()}

    def _decode(self, key: str) -> Tensor:
        """Decode all frames of a camera, episode by episode. Shape (rows, channels, height, width), uint8."""
        reader = self._reader
        episodes, timestamps = self._columns["episode_index"], self._columns["timestamp"]
        height, width, channels = reader._meta.features[key]["shape"]
        frames = torch.empty(len(episodes), channels, height, width, dtype=torch.uint8)
        return_uint8, reader._return_uint8 = reader._return_uint8, True
        try:
            for episode in tqdm(episodes.unique().tolist(), desc=f"Decoding {key}", unit="episode"):
                rows = (episodes == episode).nonzero().flatten()
                query = {key: timestamps[rows].tolist()}
                frames[rows] = reader._query_videos(query, episode)[key].view(-1, channels, height, width)
        finally:
            reader._return_uint8 = return_uint8
        return frames


def _get_item(reader: DatasetReader, idx: int) -> dict[str, Any]:
    """Stand in for `DatasetReader.get_item`."""
    limit = _limits.get(Path(reader.root))
    if limit is None or get_worker_info() is not None:
        return _lerobot_get_item(reader, idx)
    if reader not in _caches:
        _caches[reader] = _build(reader, limit)
    cache = _caches[reader]
    return _lerobot_get_item(reader, idx) if cache is None else cache.item(int(idx))


def _build(reader: DatasetReader, limit: _Limit) -> DatasetCache | None:
    """Build a cache and prove it on a few items; None if LeRobot's loader has to stay."""
    try:
        cache = DatasetCache(reader, limit.gigabytes, limit.left_out)
        last = len(cache._columns["index"]) - 1
        with _without_transforms(reader):  # They are random: two items of one row would differ.
            for row in {0, last // 2, last}:
                if not _equal(cache.item(row), cache.without_left_out(_lerobot_get_item(reader, row))):
                    raise CacheRefusedError(f"item {row} differs from LeRobot's")
    except Exception as reason:
        _warn(reader.root, str(reason))
        return None
    return cache


def _warn(root: Path, reason: str) -> None:
    logger.warning(
        "Dataset %s is not cached: %s. Loading stays slow: 10-20 ms a sample of two cameras, not 0.5.",
        root,
        reason,
    )


@contextmanager
def _without_transforms(reader: DatasetReader) -> Iterator[None]:
    transforms, reader._image_transforms = reader._image_transforms, None
    try:
        yield
    finally:
        reader._image_transforms = transforms


def _equal(ours: dict[str, Any], theirs: dict[str, Any]) -> bool:
    if list(ours) != list(theirs):
        return False
    for key, value in theirs.items():
        mine = ours[key]
        if isinstance(value, Tensor):
            if not isinstance(mine, Tensor) or mine.dtype != value.dtype or not torch.equal(mine, value):
                return False
        elif mine != value:
            return False
    return True
