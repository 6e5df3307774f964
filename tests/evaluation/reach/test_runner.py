import json

import pytest
from degraded_fakes import build_even, episode

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach import runner
from lerobot_dexflex.evaluation.reach.report import PAGE, RESULT, TABLES, make_result, write_report
from lerobot_dexflex.evaluation.reach.runner import Benchmark, run
from lerobot_dexflex.evaluation.store import EPISODES


@pytest.fixture(autouse=True)
def fresh_caches():
    runner._chains.cache_clear()
    runner._version.cache_clear()


@pytest.fixture
def loop(monkeypatch):
    """Replace the simulation; returns the runs that were asked for."""
    runs = []

    def run_chains(chains, corruption, interface, *, batch, teacher):
        runs.append((interface.name, corruption.name, [c.seed for c in chains], teacher is not None))
        removal = corruption.family == "removal"
        return [
            episode(
                40,
                label=0.004,
                executed=0.002 if interface.name == "shrink:0.5" else 0.004,
                dropped=removal and interface.name == "raw" and c.seed % 4 == 0,
                progress=0.25 if removal and interface.name == "raw" else 0.75,
                event=range(10, 18) if removal else (),
                seed=c.seed,
            )
            for c in chains
        ]

    monkeypatch.setattr(runner, "run_chains", run_chains)
    return runs


def benchmark(tmp_path, **changes):
    options = {"methods": ("raw", "shrink:0.5"), "cells": ("clean", "removal_2mm"), "episodes": 5, "group": 2}
    made = Benchmark(output=tmp_path / "out", chains=tmp_path / "chains", **(options | changes))
    made.book(True).ensure(made.episodes, workers=0, quiet=True, build=build_even)
    return made


def test_all_methods_meet_the_same_chains_and_every_episode_runs_once(tmp_path, loop):
    _, records = run(benchmark(tmp_path), workers=0, quiet=True)
    assert len(records) == len({(r.method, r.cell, r.episode) for r in records}) == 2 * 2 * 5
    assert {r.episode: r.seed for r in records} == {k: 100_000 + 2 * k for k in range(5)}
    assert [seeds for name, cell, seeds, _ in loop if (name, cell) == ("raw", "clean")] == [
        [100_000, 100_002],
        [100_004, 100_006],
        [100_008],
    ]


def test_a_kill_costs_the_running_group_and_nothing_else(tmp_path, loop):
    first = run(benchmark(tmp_path), workers=0, quiet=True)[1]
    file = tmp_path / "out" / EPISODES
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-2]) + lines[-2][:50])
    loop.clear()
    again = run(benchmark(tmp_path), workers=0, quiet=True)[1]
    # One record was torn and the last one lost: the last group of `shrink`, and of `raw`, the one before it.
    assert [(name, cell, len(seeds)) for name, cell, seeds, _ in loop] == [
        ("raw", "removal_2mm", 1),
        ("shrink:0.5", "removal_2mm", 1),
    ]
    assert {r.line() for r in again} == {r.line() for r in first}


def test_more_methods_cells_and_episodes_extend_what_is_there(tmp_path, loop):
    run(benchmark(tmp_path, episodes=4), workers=0, quiet=True)
    loop.clear()
    run(benchmark(tmp_path, episodes=6, methods=("raw", "hold"), cells=("clean",)), workers=0, quiet=True)
    assert [(name, len(seeds)) for name, _, seeds, _ in loop] == [
        ("hold", 2),
        ("hold", 2),
        ("raw", 2),
        ("hold", 2),
    ]


def test_records_of_another_version_of_a_method_are_run_again(tmp_path, loop, monkeypatch):
    run(benchmark(tmp_path), workers=0, quiet=True)
    loop.clear()
    old = runner._version("shrink:0.5", None)
    monkeypatch.setattr(runner, "_version", lambda name, controller: "new" if name == "raw" else old)
    records = run(benchmark(tmp_path), workers=0, quiet=True)[1]
    assert {name for name, *_ in loop} == {"raw"}
    assert len(records) == 20


def test_other_chains_under_the_same_seeds_are_refused(tmp_path, loop):
    run(benchmark(tmp_path), workers=0, quiet=True)
    runner._chains.cache_clear()
    book = benchmark(tmp_path).book(True).path
    book.write_text(book.read_text().replace('"friction": 1.0', '"friction": 0.9'))
    with pytest.raises(DexFlexError, match="another chain"):
        run(benchmark(tmp_path), workers=0, quiet=True)


def test_tuning_uses_other_seeds_and_refuses_the_folder_of_the_test(tmp_path, loop):
    run(benchmark(tmp_path), workers=0, quiet=True)
    tuning = benchmark(tmp_path, tuning=True)
    assert tuning.book(True).load(1)[0].seed == 50_000
    with pytest.raises(DexFlexError, match="seed: 100000 in the folder, 50000 now"):
        run(tuning, workers=0, quiet=True)


def test_the_clean_operator_runs_with_a_teacher_and_oracles_run_fewer_episodes(tmp_path, loop):
    run(benchmark(tmp_path, methods=("clean",), cells=("removal_2mm",)), workers=0, quiet=True)
    assert all(taught for *_, taught in loop)
    few = benchmark(tmp_path, methods=("raw", "oracle"), oracle_episodes=3)
    assert [group for method, cell, group in few.jobs() if (method, cell) == ("oracle", "clean")] == [
        (0, 2),
        (2, 3),
    ]


@pytest.mark.parametrize(
    "changes",
    [
        {"methods": ()},
        {"cells": ("clean", "clean")},
        {"episodes": 0},
        {"cells": ("noise_2.0mm",)},
        {"batch": 0},
    ],
)
def test_senseless_benchmarks_are_refused(tmp_path, changes):
    with pytest.raises(DexFlexError, match=r"must be|Write"):
        benchmark(tmp_path, **changes)


def test_the_report_is_one_file_and_the_result_says_where_it_comes_from(tmp_path, loop):
    ours = benchmark(tmp_path, methods=("raw", "shrink:0.5", "shrink:0.7", "reflex", "clean"))
    store, records = run(ours, workers=0, quiet=True)
    result = make_result(ours, store, records, "reflex")
    assert json.loads((tmp_path / "out" / RESULT).read_text()) == json.loads(json.dumps(result))
    assert result["seeds"] == [100_000, 100_008]
    assert {"command", "commit", "wall_time_s"} <= set(result["provenance"])
    assert result["cells"]["removal_2mm"]["raw"]["drops"] == 3
    page = write_report(ours, result, records, films=False).read_text()
    assert (tmp_path / "out" / PAGE).exists()
    assert page.count("data:image/png;base64") >= 3
    assert "http" not in page.replace("http-equiv", "")
    tables = (tmp_path / "out" / TABLES).read_text()
    assert "| raw | 0.25 [0.25, 0.25] | 0.75 [0.75, 0.75] | 0.25 [0.25, 0.25] |" in tables
