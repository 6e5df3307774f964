import os
import random

import pytest
from degraded_fakes import build_even, chain, episode

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach import chain_book
from lerobot_dexflex.evaluation.reach.chain_book import ChainBook, operator_steps
from lerobot_dexflex.experts.reach.chains import MAX_STEPS
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.runs.lock import locked


def test_chains_are_those_of_the_first_seeds_that_have_one(tmp_path):
    book = ChainBook(LEAP, tmp_path, 10)
    book.ensure(3, workers=0, quiet=True, build=build_even)
    assert [c.seed for c in book.load(3)] == [10, 12, 14]
    assert book.load(3)[1] == chain(12)
    with pytest.raises(DexFlexError, match="3 chains in a row, 4 are needed"):
        book.load(4)


def test_the_order_does_not_depend_on_which_worker_is_fast(tmp_path, monkeypatch):
    def in_any_order(function, next_number, workers):
        running, rng = [], random.Random(0)
        while True:
            while len(running) < workers and (number := next_number(len(running))) is not None:
                running.append(number)
            if not running:
                return
            yield function(running.pop(rng.randrange(len(running))))

    monkeypatch.setattr(chain_book, "run_each", in_any_order)
    book = ChainBook(LEAP, tmp_path, 10)
    book.ensure(3, workers=3, quiet=True, build=build_even)
    assert [c.seed for c in book.load(3)] == [10, 12, 14]


def test_what_is_there_is_not_built_again_but_a_torn_line_is(tmp_path):
    book = ChainBook(LEAP, tmp_path, 10)
    book.ensure(3, workers=0, quiet=True, build=build_even)
    built = []

    def build(hand, seed, verified):
        built.append(seed)
        return build_even(hand, seed, verified)

    book.ensure(3, workers=0, quiet=True, build=build)
    assert built == []
    lines = book.path.read_text().splitlines(keepends=True)
    book.path.write_text("".join(lines[:-1]) + lines[-1][:30])
    book.ensure(4, workers=0, quiet=True, build=build)
    assert built == [14, 15, 16]
    assert [c.seed for c in book.load(4)] == [10, 12, 14, 16]


def test_a_gap_left_by_a_kill_is_not_skipped(tmp_path):
    book = ChainBook(LEAP, tmp_path, 10)
    book.ensure(3, workers=0, quiet=True, build=build_even)
    lines = book.path.read_text().splitlines(keepends=True)
    book.path.write_text("".join(lines[:2] + lines[3:]))
    with pytest.raises(DexFlexError, match="1 chains in a row"):
        book.load(2)
    book.ensure(3, workers=0, quiet=True, build=build_even)
    assert [c.seed for c in book.load(3)] == [10, 12, 14]


def test_two_processes_do_not_build_into_one_folder(tmp_path):
    book = ChainBook(LEAP, tmp_path / "chains", 10)
    with locked(tmp_path / "chains"), pytest.raises(DexFlexError, match=f"in use by process {os.getpid()}"):
        book.ensure(3, workers=0, quiet=True, build=build_even)
    book.ensure(3, workers=0, quiet=True, build=build_even)
    with locked(tmp_path / "chains"):
        book.ensure(3, workers=0, quiet=True, build=build_even)  # Nothing is missing.


@pytest.mark.parametrize("line", ['{"chain": null}', '{"seed": 7, "chain": {"goals": 3}}', "[]"])
def test_a_line_that_is_no_chain_is_named(tmp_path, line):
    book = ChainBook(LEAP, tmp_path, 0)
    book.path.write_text(line + "\n")
    with pytest.raises(
        DexFlexError, match=rf"{LEAP.signature}_unverified_0\.jsonl holds a line that is no chain"
    ):
        book.load(1)


def test_a_chain_is_kept_with_the_steps_that_the_operator_takes(tmp_path, monkeypatch):
    monkeypatch.setattr("lerobot_dexflex.commands.loop.GOAL_STEPS", 2)  # Eight goals in sixteen steps.
    book = ChainBook(LEAP, tmp_path, 50_003)
    book.ensure(1, workers=0, quiet=True)
    (found,) = book.load(1)
    assert found.steps == 16 == operator_steps(LEAP, found)


def test_an_operator_that_drops_the_object_has_all_the_time_there_is(monkeypatch):
    fallen = episode(20, dropped=True)
    monkeypatch.setattr(chain_book, "run_chains", lambda *_: [fallen])
    assert operator_steps(LEAP, fallen.chain) == MAX_STEPS
    fallen.dropped = False
    assert operator_steps(LEAP, fallen.chain) == 20
