"""Runs among the published results: whole cells, with their origins, nothing lost by mistake."""

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.provenance import Version
from lerobot_dexflex.runs.table import Table, read


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("publish")


@pytest.fixture
def make_run(tmp_path):
    def make(name, table, method, code, successes, condition="clean"):
        path = tmp_path / name / table
        path.parent.mkdir(exist_ok=True)
        run, version = Table(path, ["success", "holding"]), Version(code)
        run.remember(method, version)
        key = {"method": method, "version": version.name, "task": "T-v0", "condition": condition}
        run.append([key | {"seed": k, "success": s, "holding": 0.1} for k, s in enumerate(successes)])
        return path.parent

    return make


def test_a_cell_makes_way_with_its_origin_and_all_others_stay(script, make_run):
    published = make_run("results", "tasks.csv", "raw", "a", [True, True])
    make_run("results", "tasks.csv", "raw", "a", [True], condition="noise")
    make_run("results", "tasks.csv", "dexflex", "b", [True])
    make_run("results", "tasks_seed1.csv", "raw", "a", [True])
    run = make_run("run", "tasks.csv", "dexflex", "c", [False, True])
    before = (published / "tasks.csv").read_text().splitlines()
    script.publish([run], published / "tasks.csv")
    after = (published / "tasks.csv").read_text().splitlines()
    assert [line for line in before if ",dexflex," not in f",{line}"] == after[: len(after) - 2]
    rows = read(published / "tasks.csv")
    assert rows.loc[rows["method"] == "dexflex", "success"].tolist() == [False, True]
    assert sorted(read(published / "runs.csv")["version"]) == sorted({Version(c).name for c in "ac"})


def test_publishing_twice_changes_nothing(script, make_run):
    published = make_run("results", "tasks.csv", "raw", "a", [True])
    run = make_run("run", "tasks.csv", "raw", "b", [True])
    script.publish([run], published / "tasks.csv")
    once = (published / "tasks.csv").read_text(), (published / "runs.csv").read_text()
    script.publish([run], published / "tasks.csv")
    assert once == ((published / "tasks.csv").read_text(), (published / "runs.csv").read_text())


def test_a_label_tells_controllers_apart(script, make_run):
    published = make_run("results", "reach.csv", "dexflex", "a", [True])
    run = make_run("run", "reach.csv", "dexflex", "b", [False])
    for _ in range(2):
        script.publish([run], published / "reach.csv", "both")
    rows, origins = read(published / "reach.csv"), read(published / "runs.csv")
    assert rows.set_index("method")["success"].to_dict() == {"dexflex": True, "both/dexflex": False}
    assert origins.set_index("version")["method"].to_dict() == {
        Version("a").name: "dexflex",
        Version("b").name: "both/dexflex",
    }


def test_an_unfinished_run_is_refused_by_name(script, make_run, capsys):
    published = make_run("results", "reach.csv", "raw", "a", [True, True])
    run = make_run("run", "reach.csv", "raw", "b", [True])
    before = (published / "reach.csv").read_text()
    with pytest.raises(DexFlexError, match=r"raw, T-v0, clean has 1 episodes, but .* has 2\. Finish"):
        script.publish([run], published / "reach.csv")
    assert (published / "reach.csv").read_text() == before
    arguments = [f"--folders={run}", f"--into={published / 'tasks.csv'}"]
    assert script.main(arguments) == 1
    assert "not found. Name the folder of a run." in capsys.readouterr().err
