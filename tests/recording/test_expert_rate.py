import json

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording import expert_rate as module
from lerobot_dexflex.recording.attempt import Attempt
from lerobot_dexflex.recording.expert_rate import expert_rate


@pytest.fixture(autouse=True)
def fixed_code(monkeypatch):
    monkeypatch.setattr(module, "code_digest", lambda modules: "digest")


def every_fourth_fails(index):
    return Attempt(index, 100 + index, index % 4 != 3, 7, 1.0, {})


def test_the_rate_counts_all_attempts(tmp_path):
    rate = expert_rate("PlaceHammer-v0", 8, 100, 0, tmp_path / "rate.json", every_fourth_fails)
    # 6 of 8; Wilson 95 % from the closed form: (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n).
    assert (rate.n_success, rate.n_episodes, rate.pc_success) == (6, 8, 75.0)
    assert rate.pc_success_ci95 == pytest.approx((40.93, 92.85), abs=0.01)
    found = json.loads((tmp_path / "rate.json").read_text())
    assert [a["seed"] for a in found["attempts"]] == list(range(100, 108))


def test_an_interrupted_measurement_continues(tmp_path):
    def interrupted(index):
        if index == 5:
            raise KeyboardInterrupt
        return every_fourth_fails(index)

    whole, broken = tmp_path / "whole.json", tmp_path / "broken.json"
    expert_rate("PlaceHammer-v0", 8, 100, 0, whole, every_fourth_fails)
    with pytest.raises(KeyboardInterrupt):
        expert_rate("PlaceHammer-v0", 8, 100, 0, broken, interrupted)
    assert json.loads(broken.read_text())["n_episodes"] == 5
    expert_rate("PlaceHammer-v0", 8, 100, 0, broken, every_fourth_fails)
    assert json.loads(broken.read_text()) == json.loads(whole.read_text())


def test_another_measurement_is_not_overwritten(tmp_path):
    output = tmp_path / "rate.json"
    expert_rate("PlaceHammer-v0", 2, 100, 0, output, every_fourth_fails)
    before = output.read_text()
    with pytest.raises(DexFlexError, match=r"'seed': 100.*'seed': 7"):
        expert_rate("PlaceHammer-v0", 2, 7, 0, output, every_fourth_fails)
    assert output.read_text() == before
    output.write_text("notes")
    with pytest.raises(DexFlexError, match="no measurement of the expert"):
        expert_rate("PlaceHammer-v0", 2, 100, 0, output, every_fourth_fails)


def test_the_real_expert_solves_an_unseen_state(tmp_path):
    rate = expert_rate("PlaceHammer-v0", 1, 200_000, 0, tmp_path / "rate.json")
    assert rate.n_success == 1
