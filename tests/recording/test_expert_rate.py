import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.recording.attempt import Attempt
from lerobot_dexflex.recording.expert_rate import expert_rate


def every_fourth_fails(index):
    solved = index % 4 != 3
    return Attempt(index, 100 + index, solved, 7, 1.0, {}, kept=solved)


def measure(table, run=every_fourth_fails, episodes=8, seed=100):
    return expert_rate(LEAP, "PlaceHammer-v0", episodes, seed, 0, table, run, quiet=True)


def test_every_attempt_leaves_a_row(tmp_path):
    rows = measure(tmp_path / "tasks.csv")
    assert rows["seed"].tolist() == list(range(100, 108))
    assert rows["success"].tolist() == [True, True, True, False] * 2
    assert set(rows["seconds"]) == {0.35}  # 7 steps at 20 Hz.
    assert set(rows["method"]) == {"expert"}


def test_an_interrupted_measurement_continues(tmp_path):
    def interrupted(index):
        if index == 5:
            raise KeyboardInterrupt
        return every_fourth_fails(index)

    whole, broken = tmp_path / "a/tasks.csv", tmp_path / "b/tasks.csv"
    measure(whole)
    with pytest.raises(KeyboardInterrupt):
        measure(broken, interrupted)
    assert len(broken.read_text().splitlines()) == 1 + 5
    ran = []
    measure(broken, lambda index: ran.append(index) or every_fourth_fails(index))
    assert ran == [5, 6, 7]
    assert broken.read_text() == whole.read_text()


def test_attempts_of_another_first_seed_are_other_episodes(tmp_path):
    ran = []

    def run(index):
        ran.append(index)
        return every_fourth_fails(index)

    measure(tmp_path / "tasks.csv", episodes=4)
    measure(tmp_path / "tasks.csv", run, episodes=4, seed=102)
    assert ran == [0, 1, 2, 3]


def test_bad_numbers_and_other_files_are_refused(tmp_path):
    with pytest.raises(DexFlexError, match="`episodes` must be at least 1"):
        measure(tmp_path / "tasks.csv", episodes=0)
    (tmp_path / "tasks.csv").write_text("notes\n")
    with pytest.raises(DexFlexError, match="no table of episodes"):
        measure(tmp_path / "tasks.csv")
    assert (tmp_path / "tasks.csv").read_text() == "notes\n"


def test_the_real_expert_solves_an_unseen_state(tmp_path):
    rows = expert_rate(LEAP, "PlaceHammer-v0", 1, 200_000, 0, tmp_path / "tasks.csv", quiet=True)
    assert rows["success"].tolist() == [True]
