"""Is a dataset what its description says? Every file is opened, every frame decoded and counted."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import av
import av.error
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_dexflex.errors import DexFlexError

INFO_FILE = Path("meta/info.json")
STATS_FILE = Path("meta/stats.json")
TASKS_FILE = Path("meta/tasks.parquet")
DAMAGE = (OSError, ValueError, KeyError, TypeError, AttributeError, pa.ArrowException, av.error.FFmpegError)
"""What readers of damaged files raise."""
_COUNTS = ("total_episodes", "total_frames", "total_tasks", "fps")


class DamagedDatasetError(DexFlexError):
    """A file of a dataset is not what it should be; the message names it, the remedy is up to the caller."""


class Dataset(NamedTuple):
    """A dataset whose files all hold what they should."""

    info: dict[str, Any]
    """LeRobot's description."""
    files: list[Path]
    """LeRobot's files, relative to the folder."""


def check_dataset(root: Path) -> Dataset:
    """Read a whole LeRobotDataset.

    Raises:
        DamagedDatasetError: If a file is missing, unreadable, a link, outside of `root`, or holds other
            frames than the description and the index say; names the file.
    """
    info = _description(root)
    tables = sorted(path.relative_to(root) for path in root.glob("meta/episodes/*/*.parquet"))
    episodes = _episodes(root, tables, info)
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    data = _files(root, info["data_path"], episodes, "data")
    films = {key: _files(root, info["video_path"], episodes, f"videos/{key}", key) for key in videos}
    files = [
        INFO_FILE,
        STATS_FILE,
        TASKS_FILE,
        *tables,
        *data,
        *(f for found in films.values() for f in found),
    ]
    require(root, files)
    with reading(root, TASKS_FILE):
        tasks = pq.read_table(root / TASKS_FILE).num_rows
        _expect("tasks", tasks, info["total_tasks"])
    with reading(root, STATS_FILE):
        _check_stats(json.loads((root / STATS_FILE).read_text()), info, videos)
    for file, rows in data.items():
        with reading(root, file):
            _check_data(root / file, rows, info, videos)
    for key, found in films.items():
        for file, rows in found.items():
            with reading(root, file):
                _check_film(root / file, rows, key, info)
    return Dataset(info, files)


def require(root: Path, files: list[Path]) -> None:
    """Check that files of a dataset are there, in its folder, and no links.

    Raises:
        DamagedDatasetError: If one is not.
    """
    for file in files:
        # Resolving follows links and `..`: what lies elsewhere comes out under another name.
        if (root / file).resolve() != root.resolve() / file:
            raise DamagedDatasetError(
                f"{root / file} is a link or lies outside of {root}; only a dataset's own files are read."
            )
    missing = [file.as_posix() for file in files if not (root / file).is_file()]
    if missing:
        raise DamagedDatasetError(f"{root} lacks {', '.join(missing)}.")


@contextlib.contextmanager
def reading(root: Path, file: Path) -> Iterator[None]:
    """Say of which file it is what goes wrong inside."""
    try:
        yield
    except DAMAGE as error:
        reason = f"no entry {error}" if isinstance(error, KeyError) else error
        raise DamagedDatasetError(f"{root / file} is damaged: {reason}.") from error


def _expect(what: str, found: object, wanted: object) -> None:
    if found != wanted:
        raise ValueError(f"{what}: {found} there, {wanted} expected")


def _description(root: Path) -> dict[str, Any]:
    """Return `meta/info.json`, of this LeRobot's version and with its names of files."""
    # LeRobot takes seconds to import, and who only records may start before it is.
    from lerobot.datasets.dataset_metadata import CODEBASE_VERSION
    from lerobot.datasets.utils import DEFAULT_DATA_PATH, DEFAULT_VIDEO_PATH

    require(root, [INFO_FILE])
    with reading(root, INFO_FILE):
        info = json.loads((root / INFO_FILE).read_text())
        _expect("codebase_version", info["codebase_version"], CODEBASE_VERSION)
        _expect("data_path", info["data_path"], DEFAULT_DATA_PATH)
        _expect("video_path", info["video_path"], DEFAULT_VIDEO_PATH)
        for name in _COUNTS:
            if type(info[name]) is not int or info[name] < 1:
                raise ValueError(f"{name} must be a positive integer. Got {info[name]!r}")
        for key, feature in info["features"].items():
            if not all(type(size) is int for size in feature["shape"]) or not isinstance(
                feature["dtype"], str
            ):
                raise ValueError(f"feature {key} has no shape and dtype")
    return info


def _episodes(root: Path, tables: list[Path], info: dict[str, Any]) -> pd.DataFrame:
    """Return the index of the episodes, which must count the frames without a gap."""
    require(root, tables)
    parts = []
    for table in tables:
        with reading(root, table):
            parts.append(pq.read_table(root / table).to_pandas())
    with reading(root, Path("meta/episodes")):
        rows = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame({"length": []})
        if (count := len(rows)) != info["total_episodes"]:
            raise ValueError(f"{count} episodes are indexed, {INFO_FILE} counts {info['total_episodes']}")
        if (frames := int(rows["length"].sum())) != info["total_frames"]:
            raise ValueError(f"{frames} frames are indexed, {INFO_FILE} counts {info['total_frames']}")
        ends = rows["length"].cumsum()
        for name, wanted in {
            "episode_index": np.arange(count),
            "dataset_to_index": ends,
            "dataset_from_index": ends - rows["length"],
        }.items():
            if not np.array_equal(rows[name], wanted):
                raise ValueError(f"column {name} does not count the frames of {count} episodes")
    return rows


def _files(
    root: Path, template: str, episodes: pd.DataFrame, prefix: str, video_key: str = ""
) -> dict[Path, pd.DataFrame]:
    """Return the files that the index names, each with the rows of its episodes."""
    with reading(root, Path("meta/episodes")):
        columns = (f"{prefix}/chunk_index", f"{prefix}/file_index")
        numbers = zip(*(episodes[column].astype(int) for column in columns), strict=True)
        names = [template.format(chunk_index=c, file_index=f, video_key=video_key) for c, f in numbers]
        by_name = episodes.groupby(pd.Series(names, episodes.index))
        return {Path(str(name)): rows for name, rows in by_name}


def _check_stats(stats: dict[str, Any], info: dict[str, Any], videos: list[str]) -> None:
    _expect("statistics of", sorted(stats), sorted(info["features"]))
    for key in stats.keys() - videos:
        _expect(f"frames in the statistics of {key}", stats[key]["count"], [info["total_frames"]])


def _check_data(file: Path, episodes: pd.DataFrame, info: dict[str, Any], videos: list[str]) -> None:
    table = pq.read_table(file)
    features = {key: feature for key, feature in info["features"].items() if key not in videos}
    _expect("columns", sorted(table.column_names), sorted(features))
    lengths = episodes["length"].to_numpy()
    _expect("rows", table.num_rows, int(lengths.sum()))
    for key, feature in features.items():
        values = np.stack(table[key].to_numpy()).reshape(table.num_rows, -1)
        _expect(f"numbers in a row of {key}", values.shape[1], int(np.prod(feature["shape"])))
        if not np.isfinite(values).all():
            raise ValueError(f"{key} holds NaN or infinity")
    frames = np.concatenate([np.arange(n) for n in lengths])
    for key, wanted in {
        "episode_index": np.repeat(episodes["episode_index"], lengths),
        "frame_index": frames,
        "index": np.repeat(episodes["dataset_from_index"], lengths) + frames,
    }.items():
        if not np.array_equal(table[key].to_numpy(), wanted):
            raise ValueError(f"column {key} does not count the frames of its episodes")


def _check_film(file: Path, episodes: pd.DataFrame, key: str, info: dict[str, Any]) -> None:
    height, width = info["features"][key]["shape"][:2]
    lengths = episodes["length"].to_numpy()
    starts = (lengths.cumsum() - lengths) / info["fps"]
    if np.abs(episodes[f"videos/{key}/from_timestamp"] - starts).max() > 0.5 / info["fps"]:
        raise ValueError("the index says that its episodes start elsewhere")
    count = 0
    with av.open(str(file)) as container:
        stream = container.streams.video[0]
        stream.codec_context.options = {"err_detect": "explode"}  # Else frames are made up.
        for frame in container.decode(stream):
            _expect("height and width", (frame.height, frame.width), (height, width))
            count += 1
    _expect("frames", count, int(lengths.sum()))
