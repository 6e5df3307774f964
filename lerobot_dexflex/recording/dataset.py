"""Assemble the LeRobotDataset from recorded attempts, always in the same order."""

import contextlib
import json
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import av.logging
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from datasets import disable_progress_bars
from lerobot.configs.video import RGBEncoderConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.recording.attempt import Attempt, attempt_path, load_attempt
from lerobot_dexflex.recording.card import write_card
from lerobot_dexflex.recording.integrity import DamagedDatasetError, check_dataset
from lerobot_dexflex.recording.moments import write_exact_moments
from lerobot_dexflex.recording.recipe import Recipe
from lerobot_dexflex.recording.schema import FPS, columns, lerobot_features, privileged_columns, robot_type
from lerobot_dexflex.recording.staging import RECORD_FILE

_KERNELS = "SSE2" if platform.machine() in ("x86_64", "AMD64") else "0"
"""Of x264: its AVX-512 kernels give other bytes each time in videos as narrow as ours; these do as C does."""
_FAILED_WRITES = (OSError, RuntimeError, pa.ArrowException, DamagedDatasetError)
"""As what a full disk comes: encoder threads raise RuntimeError, or nothing, and then frames are missing."""
_RECIPE_HEADER = """\
# Recorded by `{program}`; record it again with
#   {program} --config_path={root}/recipe.yaml --root=<new folder>
# Code: commit {commit}, digest {code}
# {successes} of {attempts} attempts succeeded. Seeds of all attempts: {record}
"""


def assemble(
    config: Recipe,
    staging: Path,
    attempts: Sequence[Attempt],
    origin: dict[str, Any],
    progress: Callable[[Iterable[Attempt]], Iterable[Attempt]] = iter,
) -> None:
    """Write the attempts that are kept to `config.root`, replacing what an interrupted run left there.

    The new dataset is built inside `staging`, read back, and takes its place in one rename.

    Args:
        config: The recipe.
        staging: Folder of the attempts' files.
        attempts: All finished attempts, without frames, in order; at least one is kept.
        origin: Result of `origin_of`.
        progress: Wraps the episodes that are written, for a progress bar.

    Raises:
        DexFlexError: If an attempt's file is damaged or the dataset could not be written; what was in
            `config.root` is still there, and so are the attempts.
    """
    root, build, previous = config.root.resolve(), staging / "dataset", staging / "previous"
    shutil.rmtree(build, ignore_errors=True)
    try:
        with _temporary_files_in(staging):
            _build(config, staging, attempts, origin, build, progress)
    except BaseException as error:
        shutil.rmtree(build, ignore_errors=True)
        if not isinstance(error, _FAILED_WRITES):
            raise
        raise DexFlexError(
            f"The dataset could not be written: {error} Nothing is lost: all {len(attempts)} attempts are in "
            f"{staging}. Is the disk full? Free some space, then run the same command again."
        ) from error
    shutil.rmtree(previous, ignore_errors=True)
    if root.exists():
        root.rename(previous)
    build.rename(root)
    shutil.rmtree(previous, ignore_errors=True)


def _build(
    config: Recipe,
    staging: Path,
    attempts: Sequence[Attempt],
    origin: dict[str, Any],
    build: Path,
    progress: Callable[[Iterable[Attempt]], Iterable[Attempt]],
) -> None:
    kept = [attempt for attempt in attempts if attempt.kept]
    _write_episodes(config, staging, kept, build, progress)
    for file in [*build.glob("data/*/*.parquet"), *build.glob("meta/episodes/*/*.parquet")]:
        compress(file)
    write_exact_moments(build)
    record = {
        "complete": len(kept) == config.episodes,
        "episodes": len(kept),
        "expert": {"successes": sum(a.success for a in attempts), "attempts": len(attempts)},
        "recipe": config.to_dict(),
        **origin,
        "episode_seeds": [attempt.seed for attempt in kept],
        "attempts": [attempt.summary() for attempt in attempts],
    }
    (build / RECORD_FILE).write_text(json.dumps(record, indent=1) + "\n")
    header = _RECIPE_HEADER.format(root=config.root, record=RECORD_FILE, **origin, **record["expert"])
    (build / "recipe.yaml").write_text(header + yaml.safe_dump(config.to_dict(), sort_keys=False))
    write_card(build)
    for video in build.rglob("*.mp4"):
        video.chmod(0o644)  # LeRobot moves them out of private temporary files.
    check_dataset(build)


@contextlib.contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    """Keep LeRobot's temporary files, as large as the videos, on this disk, and leave none behind."""
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        before, tempfile.tempdir = tempfile.tempdir, temporary
        try:
            yield
        finally:
            tempfile.tempdir = before


def _write_episodes(
    config: Recipe,
    staging: Path,
    kept: Sequence[Attempt],
    build: Path,
    progress: Callable[[Iterable[Attempt]], Iterable[Attempt]],
) -> None:
    av.logging.set_libav_level(av.logging.PANIC)  # LeRobot's encoder threads let x264 talk otherwise.
    disable_progress_bars()
    hand = get_hand(config.hand)
    joints = TASKS[config.task].joints(hand)
    first = load_attempt(attempt_path(staging, kept[0].index)).frames
    images = {key: frames.shape[1:] for key, frames in first.items() if key.startswith("observation.images.")}
    dataset = LeRobotDataset.create(
        config.repo_id,
        fps=FPS,
        features=lerobot_features(columns(hand, joints) | privileged_columns(hand), images),
        root=build,
        robot_type=robot_type(hand, joints),
        rgb_encoder=RGBEncoderConfig(
            vcodec="h264",
            pix_fmt="yuv420p",
            g=config.video.gop,
            crf=config.video.crf,
            preset="slow",
            extra_options={"x264-params": f"asm={_KERNELS}"},
        ),
        streaming_encoding=True,
        encoder_queue_maxsize=10_000,  # LeRobot drops frames when this queue is full; an episode must fit.
        encoder_threads=1,
        video_backend="pyav",
    )
    task = {"task": TASKS[config.task].description}
    try:
        for attempt in progress(kept):
            frames = load_attempt(attempt_path(staging, attempt.index)).frames
            for k in range(attempt.steps):
                dataset.add_frame({key: values[k] for key, values in frames.items()} | task)
            dataset.save_episode()
        dataset.finalize()
    except BaseException:
        if dataset.writer is not None:
            dataset.writer.cancel_pending_videos()  # Else its threads go on writing, ...
        with contextlib.suppress(Exception):
            dataset.meta.finalize()  # ... and it writes its index once it is forgotten.
        raise


def compress(file: Path) -> None:
    """Rewrite a parquet file as one group of rows, with zstd over byte-split float32: same values, smaller.

    Snappy and a group per episode, as LeRobot writes them, take half as much again.
    """
    source, temporary = pq.ParquetFile(file), file.with_suffix(".tmp")
    schema = source.metadata.schema
    leaves = [schema.column(k) for k in range(len(schema))]
    floats: Any = [leaf.path for leaf in leaves if leaf.physical_type == "FLOAT"]
    pq.write_table(
        source.read(),
        temporary,
        row_group_size=source.metadata.num_rows,
        compression="zstd",
        compression_level=15,
        use_dictionary=False,
        use_byte_stream_split=floats,
    )
    temporary.replace(file)
