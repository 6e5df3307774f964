"""The folder that goes to the Hub: the dataset's own files, named by the dataset itself."""

import re
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.integrity import DamagedDatasetError, check_dataset, reading, require
from lerobot_dexflex.recording.repo import check_repo_id
from lerobot_dexflex.recording.staging import RECORD_FILE, read_record

_CARD, _RECIPE = Path("README.md"), Path("recipe.yaml")


class Upload(NamedTuple):
    """A folder ready for the Hub."""

    folder: Path
    files: list[Path]
    """Relative to the folder, in order."""
    tag: str
    """Revision tag by which LeRobot finds the data: the format's version, e.g. `v3.0`."""


def build_upload(root: Path, repo_id: str, folder: Path) -> Upload:
    """Copy what belongs on the Hub from a finished recording to `folder`.

    Every file is read and every frame counted first. Only files that the dataset's own index names are taken.
    Card and recipe get the name `repo_id`, in case the dataset was recorded under another one; everything
    else is copied byte by byte.

    Args:
        root: Folder of the dataset.
        repo_id: Its name on the Hub.
        folder: Created; may exist if empty.

    Raises:
        DexFlexError: If the Hub allows no such name, the recording is unfinished or damaged, or the folder
            holds anything.
    """
    check_repo_id(repo_id)
    record = read_record(root)
    if not record["complete"]:
        raise DexFlexError(
            f"{root} is unfinished ({record['episodes']} of {record['recipe']['episodes']} episodes), so "
            "nothing was uploaded. Finish it with the command that started it, then push."
        )
    if folder.is_symlink() or (folder.exists() and (not folder.is_dir() or any(folder.iterdir()))):
        raise DexFlexError(f"{folder} exists. Choose another folder, or delete it; nothing was changed.")
    try:
        require(root, [_CARD, _RECIPE, RECORD_FILE])
        info, own = check_dataset(root)
        _check_record(root, record, info)
    except DamagedDatasetError as error:
        raise DexFlexError(
            f"{error} Restore it, or record it again into another --root; nothing was uploaded."
        ) from error
    files = sorted({_CARD, _RECIPE, RECORD_FILE, *own})
    try:
        _copy(root, files, folder, record["recipe"]["repo_id"], repo_id)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)  # Half of a dataset must not be taken for one.
        raise
    return Upload(folder, files, info["codebase_version"])


def _check_record(root: Path, record: dict[str, Any], info: dict[str, Any]) -> None:
    """Check that card, recipe and record belong to the dataset."""
    with reading(root, RECORD_FILE):
        # Early records have successes only.
        kept = [attempt.get("kept", attempt["success"]) for attempt in record["attempts"]]
        if not all(type(one) is bool for one in kept):
            raise ValueError("`success` and `kept` of an attempt must be true or false")
        counts = (record["episodes"], len(record["episode_seeds"]), sum(kept))
        if set(counts) != {info["total_episodes"]}:
            raise ValueError(
                f"it counts {counts} episodes, seeds and kept attempts, {info['total_episodes']} exist"
            )
    with reading(root, _RECIPE):
        try:
            recipe = yaml.safe_load((root / _RECIPE).read_text())
        except yaml.YAMLError as error:
            raise ValueError(str(error)) from error
        if recipe != record["recipe"]:
            raise ValueError(f"it is another recipe than that in {RECORD_FILE}")
    with reading(root, _CARD):
        if not (root / _CARD).read_text().strip():
            raise ValueError("it is empty")


def _copy(root: Path, files: list[Path], folder: Path, recorded_as: str, repo_id: str) -> None:
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / file, folder / file)
    name = rf"(?<![\w.-]){re.escape(recorded_as)}(?![\w.-])"
    for file in (_CARD, _RECIPE):  # They tell the reader the dataset's name on the Hub.
        (folder / file).write_text(re.sub(name, repo_id, (root / file).read_text()))
