"""Half, empty and full: whatever happens to the files of a recording, one clear error or a whole dataset."""

import contextlib
import json
import resource
import shutil
import zipfile

import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording import RecordConfig, attempt, record
from lerobot_dexflex.recording.cli import main
from lerobot_dexflex.recording.integrity import check_dataset
from lerobot_dexflex.recording.upload import build_upload
from lerobot_dexflex.runs.lock import locked

NAME = "lerobot-dexflex/count"


def config(task, root, **changes):
    return RecordConfig(**{"task": task, "episodes": 3, "root": root, "workers": 0} | changes)


def files_in(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


def content_of(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files_in(folder)}


def interrupt_after(monkeypatch, attempts):
    """Let the user press Ctrl-C after so many attempts."""
    original = attempt.run_attempt

    def run(hand, task, seed, index, **options):
        if index == attempts:
            raise KeyboardInterrupt
        return original(hand, task, seed, index, **options)

    monkeypatch.setattr(record, "run_attempt", run)


@pytest.fixture
def interrupted(counting_task, tmp_path, monkeypatch):
    """An interrupted recording: attempts 0 and 1 succeeded, 2 and 3 failed, the third success is missing."""
    with monkeypatch.context() as patch:
        interrupt_after(patch, 4)
        assert not record.record(config(counting_task, tmp_path / "count"), [])
    return tmp_path / "count"


@pytest.mark.parametrize("share", [0, 0.5])
def test_a_finished_recording_with_a_damaged_file_is_never_pushed(recorded, counting_task, tmp_path, share):
    files = files_in(recorded)
    assert len(files) == 10
    for file in files:
        whole = file.read_bytes()
        file.write_bytes(whole[: int(share * len(whole))])
        with contextlib.suppress(DexFlexError):
            assert record.record(config(counting_task, recorded, episodes=2), [])
        if share and file.name == "README.md":
            build_upload(recorded, NAME, tmp_path / "upload")
            shutil.rmtree(tmp_path / "upload")
        else:
            with pytest.raises(DexFlexError, match=file.name):
                build_upload(recorded, NAME, tmp_path / "upload")
        assert not (tmp_path / "upload").exists()
        file.write_bytes(whole)
    build_upload(recorded, NAME, tmp_path / "upload")


@pytest.mark.parametrize("share", [0, 0.5])
def test_an_interrupted_recording_with_a_damaged_file_names_it_and_is_kept(
    interrupted, counting_task, tmp_path, share
):
    staged = files_in(tmp_path / "count.partial")
    assert [file.name for file in staged] == [*(f"attempt_00000{k}.npz" for k in range(4)), "manifest.json"]
    for file in [*staged, interrupted / "meta/recording.json"]:
        whole, before = file.read_bytes(), content_of(interrupted)
        file.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(DexFlexError, match=rf"{file.name}(?s:.*)(delete|[Cc]hoose another)"):
            record.record(config(counting_task, interrupted), [])
        file.write_bytes(whole)
        assert content_of(interrupted) == before
    for file in set(files_in(interrupted)) - {interrupted / "meta/recording.json"}:
        file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    assert record.record(config(counting_task, interrupted), [])
    assert check_dataset(interrupted).info["total_episodes"] == 3


def test_a_damaged_attempt_is_recorded_again_once_it_is_deleted(interrupted, counting_task, tmp_path):
    record.record(config(counting_task, tmp_path / "whole"), [])
    (tmp_path / "count.partial/attempt_000001.npz").unlink()
    assert record.record(config(counting_task, interrupted), [])
    data = "data/chunk-000/file-000.parquet"
    assert (interrupted / data).read_bytes() == (tmp_path / "whole" / data).read_bytes()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("head.success", "False", "success must be true or false, got 'False'"),
        ("head.success", 1, "success must be true or false, got 1"),
        ("head.index", 7, "it is attempt 7"),
        ("head.steps", 5, r"columns of \[9\] frames in 5 steps"),
        ("head.mood", "good", "mood"),
    ],
)
def test_an_attempt_that_contradicts_itself_is_refused(
    interrupted, counting_task, tmp_path, key, value, message
):
    file = tmp_path / "count.partial/attempt_000000.npz"
    with np.load(file) as found:
        arrays = dict(found) | {key: value}
    np.savez_compressed(file, **arrays)
    with pytest.raises(
        DexFlexError, match=f"attempt_000000.npz is no recorded attempt.*{message}.*delete it"
    ):
        record.record(config(counting_task, interrupted), [])


def test_an_attempt_that_lost_its_frames_is_refused(interrupted, counting_task, tmp_path):
    file = tmp_path / "count.partial/attempt_000000.npz"
    with zipfile.ZipFile(file) as whole:
        heads = {name: whole.read(name) for name in whole.namelist() if name.startswith("head.")}
    with zipfile.ZipFile(file, "w") as rest:
        for name, content in heads.items():
            rest.writestr(name, content)
    with pytest.raises(DexFlexError, match=r"attempt_000000.npz is no recorded attempt"):
        record.record(config(counting_task, interrupted), [])


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("count.partial/manifest.json", "[]"),
        ("count.partial/manifest.json", '{"recipe": [], "code": "x"}'),
        ("count.partial/manifest.json", '{"recipe": {}}'),
        ("count/meta/recording.json", "[]"),
        ("count/meta/recording.json", '{"complete": "no"}'),
        ("count/meta/recording.json", None),
    ],
)
def test_files_that_hold_something_else_are_named(interrupted, counting_task, tmp_path, file, content):
    if content is None:
        record_file = json.loads((tmp_path / file).read_text())
        content = json.dumps(record_file | {"complete": "false"})
    (tmp_path / file).write_text(content)
    with pytest.raises(DexFlexError, match=rf"{file.rsplit('/', 1)[1]}.*(must be of type|was expected)"):
        record.record(config(counting_task, interrupted), [])


@contextlib.contextmanager
def no_file_larger_than(size):
    """A disk that is full: whoever writes on gets an OSError, as with ENOSPC."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_disk_that_fills_while_a_dataset_is_written_keeps_the_attempts_and_no_half_dataset(
    counting_task, tmp_path
):
    root, staging = tmp_path / "count", tmp_path / "count.partial"
    record.record(config(counting_task, tmp_path / "whole"), [])
    largest = max(file.stat().st_size for file in files_in(tmp_path / "whole"))
    with no_file_larger_than(100), pytest.raises(DexFlexError, match=r"Recording stopped.*Is the disk full"):
        record.record(config(counting_task, root), [])
    assert not root.exists()
    kept = set()
    for size in np.linspace(1500, largest - 1, 6).astype(int).tolist():
        with no_file_larger_than(size), pytest.raises(DexFlexError, match=r"disk full.*same command again"):
            record.record(config(counting_task, root), [])
        assert not root.exists()
        names = {path.name for path in staging.iterdir()}
        assert names >= kept, "an attempt was lost"
        assert names <= {"manifest.json", *(f"attempt_00000{k}.npz" for k in range(5))}
        kept = names
    assert len(kept) == 6, "no size let the attempts pass"
    assert record.record(config(counting_task, root), [])
    for name, content in content_of(tmp_path / "whole").items():
        if name.startswith(("data/", "videos/")) or name == "meta/stats.json":
            assert (root / name).read_bytes() == content


def test_a_disk_that_fills_keeps_what_an_interrupted_run_left(interrupted, counting_task):
    before = content_of(interrupted)
    with no_file_larger_than(8000), pytest.raises(DexFlexError, match="Nothing is lost: all 5 attempts"):
        record.record(config(counting_task, interrupted), [])
    assert content_of(interrupted) == before
    assert record.record(config(counting_task, interrupted), [])


def test_a_disk_that_fills_leaves_no_half_of_a_dry_run(recorded, tmp_path):
    with no_file_larger_than(5000), pytest.raises(OSError, match="File too large"):
        build_upload(recorded, NAME, tmp_path / "upload")
    assert not (tmp_path / "upload").exists()


def test_a_second_recording_into_a_folder_is_refused_and_told_who_works_there(
    counting_task, tmp_path, monkeypatch, capsys
):
    root = tmp_path / "count"
    words = [f"--task={counting_task}", "--episodes=1", "--workers=0"]
    statuses = []
    original = attempt.run_attempt

    def meanwhile(hand, task, seed, index, **options):
        statuses.append(main([*words, f"--root={root}"]))
        return original(hand, task, seed, index, **options)

    monkeypatch.setattr(record, "run_attempt", meanwhile)
    assert main([*words, f"--root={root}"]) == 0
    assert statuses == [1]
    error = capsys.readouterr().err
    assert f"{root} is in use by process" in error
    assert "Traceback" not in error
    assert check_dataset(root).info["total_episodes"] == 1
    assert [path.name for path in tmp_path.iterdir()] == ["count"]


def test_a_finished_recording_can_be_pushed_while_another_process_looks_at_it(recorded, counting_task):
    with locked(recorded):
        assert record.record(config(counting_task, recorded, episodes=2), [])


def test_a_recording_killed_before_its_manifest_was_written_starts_again(counting_task, tmp_path):
    (tmp_path / "count.partial").mkdir()
    (tmp_path / "count.partial/manifest.json.tmp").write_text('{"rec')
    assert record.record(config(counting_task, tmp_path / "count", episodes=1), [])
