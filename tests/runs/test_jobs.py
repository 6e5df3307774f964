"""Jobs: only what is missing runs, rows join and leave freely, one process per folder, no orphans."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.jobs import Job, run_missing
from lerobot_dexflex.runs.lock import locked
from lerobot_dexflex.runs.provenance import Version

OLD, NEW = Version("old"), Version("new")


def jobs(methods, version=OLD, episodes=4):
    return [Job(m, version.name, "T-v0", "clean", (k, k + 1)) for m in methods for k in range(0, episodes, 2)]


def run(folder, wanted, ran):
    def job(job):
        ran.append((job.method, job.seeds))
        return [{"success": seed % 2 == 0} for seed in job.seeds]

    return run_missing(folder / "t.csv", ["success"], wanted, [OLD, NEW], job, workers=0, quiet=True)


def test_only_missing_rows_run_and_others_stay(tmp_path):
    ran = []
    run(tmp_path, jobs(["raw"]), ran)
    found = run(tmp_path, jobs(["joint", "raw"]), ran)
    assert ran == [("raw", (0, 1)), ("raw", (2, 3)), ("joint", (0, 1)), ("joint", (2, 3))]
    assert found["method"].tolist() == ["joint"] * 4 + ["raw"] * 4
    assert found["success"].tolist() == [True, False] * 4


def test_only_the_method_whose_version_changed_runs_again(tmp_path):
    ran = []
    run(tmp_path, jobs(["raw", "joint"]), ran)
    ran.clear()
    changed = jobs(["raw"]) + jobs(["joint"], NEW)
    found = run(tmp_path, changed, ran)
    assert ran == [("joint", (0, 1)), ("joint", (2, 3))]
    assert set(found["version"]) == {OLD.name, NEW.name}


def test_a_group_of_which_rows_are_missing_runs_again_as_a_whole(tmp_path):
    ran = []
    run(tmp_path, jobs(["raw"]), ran)
    path = tmp_path / "t.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]) + "\n")
    ran.clear()
    found = run(tmp_path, jobs(["raw"]), ran)
    assert ran == [("raw", (2, 3))]
    assert found["seed"].tolist() == [0, 1, 2, 3]


def test_a_second_process_is_refused_and_told_who_holds_the_folder(tmp_path):
    holder = "import sys, time; from pathlib import Path; from lerobot_dexflex.runs.lock import locked\n"
    holder += "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", holder, str(tmp_path / "f")], stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        with (
            pytest.raises(DexFlexError, match=rf"in use by process {process.pid} on .*"),
            locked(tmp_path / "f"),
        ):
            pass
    finally:
        process.kill()
        process.wait()
    with locked(tmp_path / "f"):
        assert (tmp_path / ".f.lock").exists()
    assert not (tmp_path / ".f.lock").exists()


def sleep(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def test_workers_end_with_a_process_that_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        "import os, sys, time\n"
        "from lerobot_dexflex.runs.workers import run_each\n"
        "def work(seconds):\n"
        "    open(f'{sys.argv[1]}/{os.getpid()}', 'w').close(); time.sleep(seconds)\n"
        "if __name__ == '__main__':\n"
        "    list(run_each(work, lambda running: 60.0, 2))\n"
    )
    folder = tmp_path / "pids"
    folder.mkdir()
    parent = subprocess.Popen([sys.executable, str(script), str(folder)])
    try:
        deadline = time.monotonic() + 60
        while len(list(folder.iterdir())) < 2 and time.monotonic() < deadline:
            time.sleep(0.1)
        workers = [int(file.name) for file in folder.iterdir()]
        assert len(workers) == 2
    finally:
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()]
