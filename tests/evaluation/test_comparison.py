"""Methods meet the same episodes; rows join and leave a table freely; nothing that is there runs again."""

import dataclasses
import random
import shutil

import pandas as pd
import pytest
from evaluation_fakes import NAMESPACE, TASKS, FakeController, FakePlayers

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation import rollout
from lerobot_dexflex.evaluation.comparison import Comparison, compare
from lerobot_dexflex.evaluation.report.page import write_report
from lerobot_dexflex.evaluation.summary import summarise
from lerobot_dexflex.runs.table import KEY, Table, read

METHODS = ("good", "lucky", "still")


@pytest.fixture
def comparison(tmp_path):
    return Comparison(
        {TASKS[0]: FakePlayers()}, METHODS, tmp_path / "out", seeds=range(10, 16), namespace=NAMESPACE
    )


@pytest.fixture
def ran(monkeypatch):
    """Return what runs from here on, as (task, method, condition, seeds)."""
    found = []
    run_job = rollout.run_job

    def spy(players, method, env_id, condition, seeds, *rest):
        found.append((env_id.partition("/")[2], method, condition.name, tuple(seeds)))
        return run_job(players, method, env_id, condition, seeds, *rest)

    monkeypatch.setattr("lerobot_dexflex.evaluation.comparison.run_job", spy)
    return found


def run(comparison, workers=0):
    return compare(comparison, workers, quiet=True)


def changed(comparison, **changes):
    return dataclasses.replace(comparison, **changes)


def test_all_methods_meet_the_same_seeds_and_noise(comparison):
    rows = run(comparison)
    for name in METHODS:
        assert rows.loc[rows["method"] == name, "seed"].tolist() == [10, 11, 12, 13, 14, 15]
    # Even seeds draw the same speeds under `good` and `lucky`, hence end after the same steps.
    steps = rows.set_index(["method", "seed"])["steps"]
    assert all(steps["good", seed] == steps["lucky", seed] for seed in (10, 12, 14))
    assert rows["success"].sum() == 9


def test_tasks_and_conditions_run_in_one_command(comparison, ran):
    players = {task: FakePlayers() for task in TASKS}
    rows = run(changed(comparison, players=players, conditions=("clean", "heavy"), methods=("good",)))
    assert len(rows) == 2 * 2 * 6
    assert {(task, condition) for task, _, condition, _ in ran} == {
        (task, condition) for task in TASKS for condition in ("clean", "heavy")
    }
    rates = rows.groupby("condition")["success"].mean()
    assert rates["clean"] == 1.0
    assert rates["heavy"] < 1.0


def test_adding_methods_tasks_or_episodes_runs_only_them(comparison, ran):
    run(changed(comparison, methods=("good",), seeds=range(10, 13)))
    ran.clear()
    run(changed(comparison, methods=("good", "lucky"), seeds=range(10, 13)))
    assert {method for _, method, _, _ in ran} == {"lucky"}
    ran.clear()
    rows = run(changed(comparison, methods=("good",)))
    assert [seeds for *_, seeds in ran] == [(13,), (14,), (15,)]
    assert len(rows) == 6


def test_only_the_method_whose_version_changed_runs_again(comparison, ran):
    before = run(comparison)
    ran.clear()
    players = {TASKS[0]: FakePlayers((("lucky", "b"),))}
    rows = run(changed(comparison, players=players))
    assert {method for _, method, _, _ in ran} == {"lucky"}
    assert len(read(comparison.table)) == 18 + 6
    new = set(rows["version"]) - set(before["version"])
    assert new == set(rows.loc[rows["method"] == "lucky", "version"])
    origins = Table(comparison.table).origins()
    assert origins["weights"].tolist() == ["a", "a", "a", "b"]


def test_folders_merge_by_concatenating_their_files(comparison, ran, tmp_path):
    here = changed(comparison, methods=("good",))
    there = changed(comparison, methods=("lucky", "still"), output=tmp_path / "there")
    run(here)
    run(there)
    ran.clear()
    with here.table.open("a") as file:
        file.write(there.table.read_text())
    rows = run(comparison)
    assert ran == []
    assert sorted(rows["method"].unique()) == sorted(METHODS)
    assert summarise(rows, METHODS).rates["lucky", TASKS[0]].n_success == 3


def test_an_interrupted_comparison_continues_to_the_same_rows(comparison, tmp_path, monkeypatch):
    whole = run(comparison)
    partial = changed(comparison, output=tmp_path / "elsewhere")
    act, calls = FakeController.act, iter(range(10_000))

    def interrupted(self, observation, task):
        if next(calls) == 40:
            raise KeyboardInterrupt
        return act(self, observation, task)

    monkeypatch.setattr(FakeController, "act", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(partial)
    monkeypatch.setattr(FakeController, "act", act)
    assert 0 < len(read(partial.table)) < 18
    pd.testing.assert_frame_equal(run(partial), whole)


def test_worker_processes_change_no_row(comparison, tmp_path):
    here = run(comparison)
    there = run(changed(comparison, output=tmp_path / "elsewhere"), workers=2)
    pd.testing.assert_frame_equal(there, here)


def test_a_label_tells_policies_apart(comparison):
    run(changed(comparison, methods=("good",)))
    rows = run(changed(comparison, methods=("good",), label="act"))
    assert set(rows["method"]) == {"act/good"}
    assert set(read(comparison.table)["method"]) == {"good", "act/good"}


def test_batches_are_other_versions_by_where_they_begin(comparison):
    versions = [
        changed(comparison, batch_size=size, seeds=range(first, first + 6)).versions()[TASKS[0], "good"].name
        for size, first in ((1, 10), (1, 11), (2, 10), (2, 11), (2, 12))
    ]
    assert versions[0] == versions[1]
    assert versions[2] == versions[4]
    assert len(set(versions)) == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": range(0)}, "`episodes` must be at least 1"),
        ({"batch_size": 0}, "`batch_size` must be at least 1"),
        ({"batch_size": 4}, "fill batches of 4"),
        ({"seeds": range(-1, 5)}, "must not be negative"),
        ({"methods": ("good", "good")}, "`methods` must be one or more different names"),
        ({"conditions": ()}, "`conditions` must be one or more"),
        ({"conditions": ("rain",)}, "Unknown word 'rain'"),
        ({"conditions": ("heavy+removal_2mm",)}, r"Write .* as 'removal_2mm\+heavy'"),
        ({"conditions": ("noise_2mm+verified",)}, "in-hand benchmark"),
    ],
)
def test_settings_that_mean_nothing_are_refused(comparison, change, message):
    with pytest.raises(DexFlexError, match=message):
        changed(comparison, **change)


def test_what_cannot_be_run_is_refused_before_anything_runs(comparison):
    with pytest.raises(DexFlexError, match="telepathy"):
        run(changed(comparison, methods=("good", "telepathy")))
    assert not comparison.output.exists()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished comparison with films and a report."""
    comparison = Comparison(
        {TASKS[0]: FakePlayers()},
        ("good", "lucky"),
        tmp_path_factory.mktemp("finished") / "out",
        seeds=range(10, 13),
        videos=1,
        namespace=NAMESPACE,
    )
    rows = run(comparison)
    write_report(comparison, rows)
    return comparison, rows


@pytest.mark.parametrize("empty", [True, False])
def test_files_cut_off_anywhere_stop_no_later_run(finished, tmp_path, empty):
    """As a kill or a full disk may leave them: the next run repeats what is lost or names file and remedy."""
    comparison, rows = finished
    rng = random.Random(0)
    files = [path.relative_to(comparison.output) for path in comparison.output.rglob("*.*") if path.is_file()]
    assert {"tasks.csv", "runs.csv", "summary.json", "report.html"} <= {path.name for path in files}
    refused = []
    for name in files:
        again = changed(comparison, output=tmp_path / name.name)
        shutil.copytree(comparison.output, again.output)
        whole = (again.output / name).read_bytes()
        (again.output / name).write_bytes(whole[: 0 if empty else rng.randrange(len(whole))])
        try:
            write_report(again, run(again))
        except DexFlexError as error:
            refused.append((name, str(error)))
        pd.testing.assert_frame_equal(run(again), rows)
        assert not read(again.table).duplicated(list(KEY)).any()
    assert refused
    for name, message in refused:
        assert name.suffix in (".mp4", ".npy")
        assert "Remove that folder: the rows are kept" in message
