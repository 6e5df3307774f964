import pytest
import torch

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.hand.kinematics import contact_torques, fingertips, joint_limits, pads, solve_fingertips
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.training.corpus_data import CorpusData, squeeze_of
from lerobot_dexflex.training.fit import FitConfig
from lerobot_dexflex.training.splitter import SplitterConfig, SplitterStage


@pytest.fixture(scope="module")
def splits(corpus):
    return CorpusData(corpus, "train"), CorpusData(corpus, "tune")


def stage_of(splits, **changes):
    torch.manual_seed(0)
    controller = DexFlexController().eval().requires_grad_(False)
    config = SplitterConfig(fit=FitConfig(batch_size=64), held_out_rows=64, **changes)
    return controller, SplitterStage(controller, splits[0], splits[1], config)


@pytest.mark.parametrize("hand", [LEAP, SHARPA], ids=lambda hand: hand.name)
def test_a_position_servo_that_is_commanded_so_far_in_exerts_the_forces(hand):
    """Whoever is led to tips + squeeze by inverse kinematics pushes with the forces' torques."""
    joints = torch.stack(joint_limits(hand)).mean(0)[None]
    forces = 1.5 * pads(hand, joints)[1]
    squeeze = squeeze_of(hand, joints, forces).double()
    led = solve_fingertips(hand, fingertips(hand, joints) + squeeze, joints, iterations=20)
    wanted = contact_torques(hand, joints, pads(hand, joints)[0], forces)
    exerted = torch.tensor(hand.position_gains) * (led - joints)
    # Four joints serve a point: the motion that moves no tip is free. So compare the work along the squeeze.
    work = [(torque * (led - joints)).sum() for torque in (exerted, wanted)]
    torch.testing.assert_close(*work, rtol=0.1, atol=0)
    assert 0.002 < squeeze.norm(dim=-1).min() < squeeze.norm(dim=-1).max() < 0.03


def test_drafts_of_motion_stay_as_they_are_and_those_that_press_are_led_alike_in_every_step(splits):
    _, stage = stage_of(splits, draft_share=0.0, strayed_share=0.0)
    batch = stage.batch()
    pressing = batch.squeeze.flatten(1).any(1)
    assert 0 < pressing.sum() < len(pressing)
    plans = splits[0].plan(splits[0].rows())

    def from_plans(drafts):
        return [bool((plans - draft).abs().flatten(1).amax(1).lt(1e-7).any()) for draft in drafts]

    assert all(from_plans(batch.draft[~pressing]))
    assert all(from_plans((batch.draft - batch.squeeze[:, None])[pressing]))


def test_the_stage_learns_a_batch_and_leaves_the_rest(splits, learn):
    controller, stage = stage_of(splits)
    before = {name: value.clone() for name, value in controller.state_dict().items()}
    first, last = learn(stage, steps=60)
    assert last < 0.5 * first
    changed = {name for name, value in controller.state_dict().items() if not value.equal(before[name])}
    assert {name.split(".")[0] for name in changed} == {"splitter"}
    with torch.no_grad():
        metrics = stage.evaluate()
    assert metrics["error_mm"] < metrics["squeeze_mm"]
    assert set(metrics) == {"squeeze_mm"} | {
        f"{name}_mm{touch}" for name in ("error", "invented") for touch in ("", "_no_touch")
    }


def test_fingers_stray_most_that_carry_no_load(splits):
    _, stage = stage_of(splits, draft_share=0.0, strayed_share=1.0, pressing_share=0.0)
    data, rows = splits[0], splits[0].rows()
    torch.manual_seed(0)
    batch = stage._gather(data, rows)
    strayed = batch.draft - data.plan(rows)
    torch.testing.assert_close(strayed[:, :1].expand_as(strayed), strayed, rtol=0, atol=1e-7)
    loaded = data.columns["loads"][rows] > 0.05
    assert strayed[:, 0][~loaded].std() == pytest.approx(0.006, rel=0.1)
    assert strayed[:, 0][loaded].std() == pytest.approx(0.0015, rel=0.1)
    assert not batch.squeeze.any()
