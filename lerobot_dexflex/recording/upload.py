"""The folder that goes to the Hub: the dataset's own files, named by the dataset itself."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow.parquet as pq

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.staging import RECORD_FILE, read_record

_ALWAYS = ("README.md", "recipe.yaml", RECORD_FILE, "meta/info.json", "meta/stats.json", "meta/tasks.parquet")
_NAMING = ("README.md", "recipe.yaml")
"""Files that tell the reader the dataset's name on the Hub."""


class Upload(NamedTuple):
    """A folder ready for the Hub."""

    folder: Path
    files: list[Path]
    """Relative to the folder, in order."""
    tag: str
    """Revision tag by which LeRobot finds the data: the format's version, e.g. `v3.0`."""


def build_upload(root: Path, repo_id: str, folder: Path) -> Upload:
    """Copy what belongs on the Hub from a finished recording to `folder`.

    Only files that the dataset's own index names are taken. Card and recipe get the name `repo_id`, in case
    the dataset was recorded under another one; everything else is copied byte by byte.

    Args:
        root: Folder of the dataset.
        repo_id: Its name on the Hub.
        folder: Created; may exist if empty.

    Raises:
        DexFlexError: If the recording is unfinished or damaged, or the folder holds anything.
    """
    record = read_record(root)
    if not record["complete"]:
        raise DexFlexError(
            f"{root} is unfinished ({record['episodes']} of {record['recipe']['episodes']} episodes), so "
            "nothing was uploaded. Finish it with the command that started it, then push."
        )
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DexFlexError(f"{folder} exists. Choose another folder, or delete it; nothing was changed.")
    info, files = _own_files(root)
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / file, folder / file)
    recorded_name = rf"(?<![\w.-]){re.escape(record['recipe']['repo_id'])}(?![\w.-])"
    for name in _NAMING:
        (folder / name).write_text(re.sub(recorded_name, repo_id, (root / name).read_text()))
    return Upload(folder, files, info["codebase_version"])


def _own_files(root: Path) -> tuple[dict[str, Any], list[Path]]:
    """Return LeRobot's description of the dataset and all files that belong to it."""
    try:
        info = json.loads((root / "meta/info.json").read_text())
        files = sorted({*map(Path, _ALWAYS), *_indexed_files(root, info)})
    except (OSError, ValueError, KeyError) as error:
        raise DexFlexError(f"{root} is no readable LeRobotDataset ({error}). {_REMEDY}") from error
    missing = [file.as_posix() for file in files if not (root / file).is_file()]
    if missing:
        raise DexFlexError(f"{root} lacks {', '.join(missing)}. {_REMEDY}")
    return info, files


_REMEDY = "Restore it, or record it again into another --root; nothing was uploaded."


def _indexed_files(root: Path, info: dict[str, Any]) -> Iterator[Path]:
    """Yield the episode tables, and the data and videos that their rows name."""
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    episodes = 0
    for table in root.glob("meta/episodes/*/*.parquet"):
        yield table.relative_to(root)
        columns = [
            f"{prefix}/{part}_index"
            for prefix in ("data", *(f"videos/{key}" for key in videos))
            for part in ("chunk", "file")
        ]
        for row in pq.read_table(table, columns=columns).to_pylist():
            episodes += 1
            yield Path(_path(info["data_path"], row, "data"))
            for key in videos:
                yield Path(_path(info["video_path"], row, f"videos/{key}", video_key=key))
    if episodes != info["total_episodes"]:
        raise ValueError(f"{episodes} episodes are indexed, meta/info.json counts {info['total_episodes']}")


def _path(template: str, row: dict[str, int], prefix: str, **names: str) -> str:
    indices = {f"{part}_index": row[f"{prefix}/{part}_index"] for part in ("chunk", "file")}
    return template.format(**indices, **names)
