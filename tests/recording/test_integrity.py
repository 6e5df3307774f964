"""Damage one thing in a finished dataset and see it named."""

import json
import re
import shutil

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.integrity import check_dataset
from lerobot_dexflex.recording.push import dry_run
from lerobot_dexflex.recording.upload import build_upload

NAME = "lerobot-dexflex/count"
DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
FILM = "videos/observation.images.front/chunk-000/file-000.mp4"


def refused(root, message):
    """Assert that neither a check nor an upload passes, and that the upload says why and leaves nothing."""
    with pytest.raises(DexFlexError, match=message):
        check_dataset(root)
    with pytest.raises(DexFlexError, match=f"(?s){message}.*nothing was uploaded"):
        build_upload(root, NAME, root.parent / "upload")
    assert not (root.parent / "upload").exists()


def change_json(file, **changes):
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def change_table(file, change):
    """Rewrite a parquet file with `change(frame)`; the columns keep their types."""
    table = pq.read_table(file)
    frame = change(table.to_pandas())
    schema = pa.schema([field for field in table.schema if field.name in frame])
    pq.write_table(pa.Table.from_pandas(frame, schema, preserve_index=False), file)


def test_a_whole_dataset_passes_with_all_its_files(recorded):
    info, files = check_dataset(recorded)
    assert info["total_frames"] == 18
    assert {DATA, EPISODES, FILM, "meta/info.json"} < {file.as_posix() for file in files}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"codebase_version": "v2.1"}, "codebase_version: v2.1 there, v3.0 expected"),
        ({"total_episodes": 3}, "2 episodes are indexed, meta/info.json counts 3"),
        ({"total_frames": 17}, "18 frames are indexed, meta/info.json counts 17"),
        ({"total_tasks": 2}, r"tasks.parquet is damaged: tasks: 1 there, 2 expected"),
        ({"total_frames": "18"}, "total_frames must be a positive integer. Got '18'"),
        ({"fps": 0}, "fps must be a positive integer. Got 0"),
        ({"fps": 10}, "mp4 is damaged: the index says that its episodes start elsewhere"),
        ({"data_path": "../secret.txt"}, r"data_path: ../secret.txt there"),
        ({"data_path": "{chunk_index.__class__}"}, "data_path"),
        ({"video_path": "/etc/passwd"}, "video_path: /etc/passwd there"),
        ({"features": []}, "info.json is damaged"),
    ],
)
def test_a_description_that_disagrees_is_refused(recorded, changes, message):
    (recorded.parent / "secret.txt").write_text("secret")
    change_json(recorded / "meta/info.json", **changes)
    refused(recorded, message)


def test_a_camera_named_like_a_way_out_is_refused(recorded):
    info = json.loads((recorded / "meta/info.json").read_text())
    text = json.dumps(info).replace("observation.images.front", "../../front")
    (recorded / "meta/info.json").write_text(text)
    table = pq.read_table(recorded / EPISODES)
    names = [name.replace("observation.images.front", "../../front") for name in table.column_names]
    pq.write_table(table.rename_columns(names), recorded / EPISODES)
    refused(recorded, "lies outside of")


@pytest.mark.parametrize(
    "name", ["README.md", DATA, FILM, "meta/info.json", "meta/recording.json", "data", "meta"]
)
def test_links_are_refused_by_name_and_never_followed(recorded, tmp_path, name):
    shutil.move(recorded / name, tmp_path / "elsewhere")
    (recorded / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DexFlexError, match=rf"{re.escape(str(recorded))}/\S+ is a link or lies outside"):
        build_upload(recorded, NAME, tmp_path / "upload")
    assert not (tmp_path / "upload").exists()


def test_the_folder_of_a_dataset_may_itself_be_reached_by_a_link(recorded, tmp_path):
    (tmp_path / "link").symlink_to(recorded)
    assert len(build_upload(tmp_path / "link", NAME, tmp_path / "upload").files) == 10


def test_a_dry_run_never_writes_behind_a_link(recorded, tmp_path):
    (tmp_path / "hub").mkdir()
    (tmp_path / "precious").mkdir()
    (tmp_path / "hub/lerobot-dexflex").symlink_to(tmp_path / "precious")
    with pytest.raises(DexFlexError, match=f"is {tmp_path / 'precious'}.*behind a link"):
        dry_run(recorded, NAME, tmp_path / "hub")
    assert list((tmp_path / "precious").iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.iloc[:-1], "rows: 17 there, 18 expected"),
        (lambda t: t.drop(columns="action"), "columns: "),
        (lambda t: t.iloc[::-1], "column episode_index does not count"),
        (lambda t: t.assign(frame_index=0), "column frame_index does not count"),
        (lambda t: t.assign(action=[row[:-1] for row in t["action"]]), "."),
        (lambda t: t.assign(action=[np.full(35, np.nan, np.float32)] * 18), "action holds NaN or infinity"),
    ],
)
def test_data_that_disagree_with_the_description_are_refused(recorded, change, message):
    if message == ".":
        table = pq.read_table(recorded / DATA)
        rows = pa.array([row[:-1] for row in table["action"].to_pylist()], pa.list_(pa.float32()))
        pq.write_table(table.set_column(table.column_names.index("action"), "action", rows), recorded / DATA)
        refused(recorded, f"{DATA} is damaged: numbers in a row of action: 34 there, 35 expected")
    else:
        change_table(recorded / DATA, change)
        refused(recorded, f"{DATA} is damaged: {message}")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.iloc[:1], "1 episodes are indexed, meta/info.json counts 2"),
        (lambda t: t.assign(length=[9, 10]), "19 frames are indexed"),
        (lambda t: t.assign(length=[8, 10]), "column dataset_to_index does not count"),
        (lambda t: t.drop(columns="data/file_index"), "episodes is damaged: no entry"),
    ],
)
def test_an_index_that_disagrees_with_the_description_is_refused(recorded, change, message):
    change_table(recorded / EPISODES, change)
    refused(recorded, message)


def test_a_film_that_lacks_a_frame_is_refused(recorded):
    frames = []
    with av.open(str(recorded / FILM)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    write_film(recorded / FILM, frames[:-1])
    refused(recorded, f"{FILM} is damaged: frames: 17 there, 18 expected")


def test_a_film_of_another_size_is_refused(recorded):
    write_film(recorded / FILM, np.zeros((18, 64, 64, 3), np.uint8))
    refused(recorded, r"height and width: \(64, 64\) there, \(96, 96\) expected")


def test_a_film_whose_pictures_are_overwritten_is_refused(recorded):
    """Decoders make up what they cannot read, unless told not to."""
    content = bytearray((recorded / FILM).read_bytes())
    start = content.index(b"mdat") + 800  # After x264's own words.
    content[start : start + 200] = bytes(200)
    (recorded / FILM).write_bytes(content)
    refused(recorded, f"{FILM} is damaged")


def write_film(file, frames):
    with av.open(str(file), "w") as container:
        stream = container.add_stream("h264", 20)
        stream.height, stream.width = frames[0].shape[:2]
        for image in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())


def test_statistics_of_other_data_are_refused(recorded):
    stats = json.loads((recorded / "meta/stats.json").read_text())
    stats["action"]["count"] = [17]
    (recorded / "meta/stats.json").write_text(json.dumps(stats))
    refused(
        recorded, r"stats.json is damaged: frames in the statistics of action: \[17\] there, \[18\] expected"
    )
    del stats["action"]
    (recorded / "meta/stats.json").write_text(json.dumps(stats))
    refused(recorded, "stats.json is damaged: statistics of")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"episodes": 3}, r"it counts \(3, 2, 2\) episodes, seeds and kept attempts, 2 exist"),
        ({"attempts": [{"success": "no"}] * 2}, "`success` and `kept` of an attempt must be true or false"),
        ({"recipe": {"repo_id": NAME, "episodes": 2}}, "recipe.yaml is damaged: it is another recipe"),
    ],
)
def test_a_record_that_disagrees_with_the_dataset_is_refused(recorded, changes, message):
    change_json(recorded / "meta/recording.json", **changes)
    with pytest.raises(DexFlexError, match=message):
        build_upload(recorded, NAME, recorded.parent / "upload")


def test_the_datasets_of_this_repository_are_whole(request):
    folders = sorted((request.config.rootpath / "datasets").glob("*/meta/info.json"))
    assert len(folders) >= 3
    frames = [check_dataset(file.parents[1]).info["total_frames"] for file in folders]
    assert min(frames) > 1000
