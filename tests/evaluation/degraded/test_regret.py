"""Candidates are judged where dexflex decides, and what it does stays the same."""

import numpy as np
import pytest

from lerobot_dexflex.commands.corruption import Corruption
from lerobot_dexflex.commands.loop import run_chains
from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.degraded import regret
from lerobot_dexflex.evaluation.degraded.regret import (
    CHOOSERS,
    METRICS,
    JudgedInterface,
    Judgements,
    Judging,
    judge,
    markdown,
    summarise,
)
from lerobot_dexflex.evaluation.degraded.runner import Benchmark
from lerobot_dexflex.experts.reach.chains import build_chain
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface


@pytest.fixture(scope="module")
def chain():
    return build_chain(ReachEnv(cameras=()), 50_001, verify=False)


def test_judging_changes_nothing_and_nobody_beats_the_oracle(chain, controller):
    corruption, found = Corruption("noise", 0.002), Judgements("noise_2mm", 0)
    (plain,) = run_chains([chain], corruption, DexFlexInterface(controller), max_steps=10)
    (judged,) = run_chains([chain], corruption, JudgedInterface(controller, found), max_steps=10)
    np.testing.assert_array_equal(judged.executed, plain.executed)
    assert found.chain == [chain.seed] * 2  # Steps 0 and 8.
    cost = {name: np.array(found.outcome[name])[:, 0] for name in CHOOSERS}
    assert all((cost["oracle"] <= values).all() for values in cost.values())
    assert len(found.grasp) == 2 * SelectionSettings().n_candidates
    assert Judgements.parse(found.line()).outcome == found.outcome


def test_without_draft_or_projection_there_is_nothing_to_compare(controller):
    with pytest.raises(DexFlexError, match="must be candidates"):
        JudgedInterface(controller, Judgements("clean", 0), SelectionSettings(project=False))


def test_regret_and_agreement_are_means_over_episodes():
    found = Judgements("clean", 0, chain=[1, 1, 2])
    for name in CHOOSERS:
        found.outcome[name] = [[1.0, 0.0, 0.0, 0.0]] * 3
    found.outcome["draft"] = [[1.0, 0.0, 0.0, 0.0], [3.0, 0.0, 0.0, 0.0], [5.0, 0.0, 1.0, 0.0]]
    found.contact = [(0.1, False), (0.9, True)]
    summary = summarise([found], "clean")
    draft = summary["choosers"]["draft"]
    assert (summary["episodes"], summary["decisions"]) == (2, 3)
    assert draft["regret"]["mean"] == pytest.approx((1 + 4) / 2)
    assert draft["as_good"]["mean"] == pytest.approx((0.5 + 0) / 2)
    assert draft["lost_fingers"]["mean"] == pytest.approx(0.5)
    assert set(draft) == {*METRICS, "regret", "as_good"}
    assert (summary["contact_loss_auc"], summary["grasp_loss_auc"]) == (1.0, None)


def test_judging_continues_where_it_was(tmp_path, controller_folder, monkeypatch):
    monkeypatch.setattr(regret, "GROUP", 1)
    monkeypatch.setattr(regret, "EVERY", 80)
    benchmark = Benchmark(
        ("dexflex",), ("clean_unverified",), tmp_path / "out", tmp_path / "chains", episodes=1,
        controller=controller_folder, tuning=True,
    )  # fmt: skip
    first = judge(Judging(benchmark), workers=0, quiet=True)
    monkeypatch.setattr(Judging, "run_job", lambda *_: pytest.fail("It was finished."))
    assert judge(Judging(benchmark), workers=0, quiet=True) == first
    assert "| clean_unverified | oracle | 0.0 | 100 % |" in markdown(first)
