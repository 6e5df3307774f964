import functools
from dataclasses import replace

import pytest
from degraded_fakes import build_even, episode

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach import benchmark as module
from lerobot_dexflex.evaluation.reach import episodes
from lerobot_dexflex.evaluation.reach.benchmark import Benchmark
from lerobot_dexflex.evaluation.reach.bounds import ORACLE
from lerobot_dexflex.evaluation.reach.report import PAGE, TABLES, write_report
from lerobot_dexflex.evaluation.reach.summary import summarise
from lerobot_dexflex.hands import HANDS, LEAP, SHARPA
from lerobot_dexflex.interfaces import INTERFACES
from lerobot_dexflex.runs.provenance import imported
from lerobot_dexflex.runs.table import KEY, Table

run = functools.partial(module.run, workers=0, quiet=True)


@pytest.fixture(autouse=True)
def fresh_caches():
    module._chains.cache_clear()
    module._interface.cache_clear()


@pytest.fixture
def loop(monkeypatch):
    """Replace the simulation; returns the runs that were asked for: interface, error, seeds."""
    runs = []

    def run_chains(chains, errors, interface, *, source, batch):
        name = interface.name.partition(":")[0]
        runs.append((name, errors.name, [c.seed for c in chains]))
        assert source == "motion"
        removal = errors.name.startswith("removal")
        return [
            episode(
                40,
                label=0.004,
                selected=0.002 if name == "press" else 0.004,
                dropped=removal and name == "raw" and c.seed % 4 == 0,
                progress=0.25 if removal and name == "raw" else 0.75,
                event=range(10, 18) if removal else (),
                seed=c.seed,
            )
            for c in chains
        ]

    monkeypatch.setattr(episodes, "run_chains", run_chains)
    return runs


def benchmark(tmp_path, **changes):
    options = {
        "methods": ("raw", "press:2.5"),
        "conditions": ("clean", "removal_2mm"),
        "episodes": 5,
        "group": 2,
    }
    made = Benchmark(output=tmp_path / "out", chains=tmp_path / "chains", **(options | changes))
    made.book("clean").ensure(made.episodes, workers=0, quiet=True, build=build_even)
    return made


def test_all_methods_meet_the_same_chains_and_every_episode_runs_once(tmp_path, loop):
    rows = run(benchmark(tmp_path))
    assert len(rows) == len(rows[["method", "condition", "seed"]].drop_duplicates()) == 2 * 2 * 5
    for _, part in rows.groupby(["method", "condition"]):
        assert part["seed"].tolist() == [100_000 + 2 * k for k in range(5)]
    assert [seeds for name, error, seeds in loop if (name, error) == ("raw", "clean")] == [
        [100_000, 100_002],
        [100_004, 100_006],
        [100_008],
    ]


def test_a_kill_costs_the_running_group_and_nothing_else(tmp_path, loop):
    first = run(benchmark(tmp_path))
    file = benchmark(tmp_path).table
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-2]) + lines[-2][:50])
    loop.clear()
    again = run(benchmark(tmp_path))
    # One row was torn and the last one lost: the last group of `press`, and of `raw`, the one before it.
    assert [(name, error, len(seeds)) for name, error, seeds in loop] == [
        ("raw", "removal_2mm", 1),
        ("press", "removal_2mm", 1),
    ]
    assert again.equals(first)


def test_more_methods_conditions_and_episodes_extend_what_is_there(tmp_path, loop):
    run(benchmark(tmp_path, episodes=4))
    loop.clear()
    run(benchmark(tmp_path, episodes=6, methods=("raw", "forces"), conditions=("clean",)))
    assert [(name, len(seeds)) for name, _, seeds in loop] == [
        ("forces", 2),
        ("forces", 2),
        ("raw", 2),
        ("forces", 2),
    ]


def test_only_rows_of_another_version_of_their_method_are_run_again(tmp_path, loop, monkeypatch):
    first = run(benchmark(tmp_path))
    loop.clear()
    version = Benchmark.version

    def changed(self, method):
        found = version(self, method)
        return replace(found, code="new") if method == "raw" else found

    monkeypatch.setattr(Benchmark, "version", changed)
    rows = run(benchmark(tmp_path))
    assert {name for name, *_ in loop} == {"raw"}
    assert len(rows) == len(first)
    loop.clear()
    monkeypatch.setattr(Benchmark, "version", version)
    assert run(benchmark(tmp_path)).equals(first)  # The old rows stay.
    assert loop == []


def test_a_version_follows_what_runs_the_method_and_nothing_else(tmp_path):
    ours = benchmark(tmp_path)
    names = {name: ours.version(name).code for name in ("raw", "press:2.5", "press:4.5", "forces")}
    assert names["press:2.5"] == names["press:4.5"]
    assert len(set(names.values())) == 3
    assert ours.version("raw") != benchmark(tmp_path, batch=8).version("raw")
    everywhere = set(imported(module._RUN_BY))
    assert not {"lerobot_dexflex.runs.jobs", "lerobot_dexflex.evaluation.reach.benchmark"} & everywhere


def test_other_chains_under_the_same_seeds_are_refused_before_anything_runs(tmp_path, loop):
    run(benchmark(tmp_path))
    module._chains.cache_clear()
    loop.clear()
    book = benchmark(tmp_path).book("clean").path
    book.write_text(book.read_text().replace('"friction": 1.0', '"friction": 0.9'))
    with pytest.raises(DexFlexError, match=r"seed 100000 .* another chain .* choose another --output"):
        run(benchmark(tmp_path, methods=("raw", "forces")))
    assert loop == []


def test_tuning_and_test_use_other_seeds_and_verified_goals_another_book(tmp_path, loop):
    run(benchmark(tmp_path))
    tuning = benchmark(tmp_path, tuning=True)
    assert tuning.book("clean").load(1)[0].seed == 50_000
    assert run(tuning)["seed"].min() == 50_000
    assert set(Table(tuning.table).load()["seed"] // 50_000) == {1, 2}
    names = ("clean", "removal_2mm", "noise_2mm+pressing", "removal_2mm+verified")
    books = [tuning.book(name) for name in names]
    assert books[0] == books[1] == books[2] != books[3]
    assert [book.verified for book in books] == [False, False, False, True]


def test_oracles_run_fewer_episodes(tmp_path, monkeypatch):
    monkeypatch.setitem(INTERFACES, ORACLE, INTERFACES["forces"])
    few = benchmark(tmp_path, methods=("raw", "oracle"), oracle_episodes=3)
    versions = {name: few.version("raw") for name in few.methods}
    groups = [job.seeds for job in few.jobs(versions) if (job.method, job.condition) == ("oracle", "clean")]
    assert groups == [(100_000, 100_002), (100_004,)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"methods": ()}, "`methods` must be one or more different names"),
        ({"conditions": ("clean", "clean")}, "`conditions` must be one or more different names"),
        ({"episodes": 0}, "`episodes` must be at least 1"),
        ({"batch": 0}, "`batch` must be at least 1"),
        ({"conditions": ("noise_2.0mm",)}, "Write 'noise_2.0mm' as 'noise_2mm'"),
        ({"conditions": ("removal_2mm+heavy",)}, "no heavy hand.*errors of commands, pressing, verified"),
    ],
)
def test_senseless_benchmarks_are_refused(tmp_path, changes, message):
    with pytest.raises(DexFlexError, match=message):
        benchmark(tmp_path, **changes)


def test_the_report_is_one_file_and_says_where_its_rows_come_from(tmp_path, loop):
    ours = benchmark(
        tmp_path, methods=("raw", "press:4", "press:blocked=True", "press@0.5", "press", "operator")
    )
    rows = run(ours)
    assert set(KEY) < set(rows)
    page = write_report(ours, summarise(rows, reference="press"), films=False).read_text()
    assert (tmp_path / "out" / PAGE).exists()
    assert page.count("data:image/png;base64") >= 3
    assert "http" not in page.replace("http-equiv", "")
    assert all(version in page for version in rows["version"])
    tables = (tmp_path / "out" / TABLES).read_text()
    assert "| raw | 0.25 [0.25, 0.25] | 0.75 [0.75, 0.75] | 0.25 [0.25, 0.25] |" in tables
    assert "| raw | 0/5 (0-43 %) | 3/5 (23-88 %) |" in tables


def test_rows_and_chains_of_another_hand_stay_apart(tmp_path):
    leap, sharpa = (Benchmark(("raw",), ("clean",), tmp_path, tmp_path, hand=hand) for hand in HANDS)
    assert leap.version("raw") != sharpa.version("raw")
    assert f"hand={SHARPA.signature}" in sharpa.version("raw").settings
    assert leap.book("clean").path.name == f"{LEAP.signature}_unverified_100000.jsonl"
    assert sharpa.book("clean").path.name == f"{SHARPA.signature}_unverified_100000.jsonl"
    assert sharpa.book("clean").hand is SHARPA


def test_an_unknown_hand_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(DexFlexError, match=r"no hand 'claw'. Choose from .*'sharpa'"):
        Benchmark(("raw",), ("clean",), tmp_path, tmp_path, hand="claw")
