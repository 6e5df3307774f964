"""How the operator holds the leg, rights it and screws it in with the fingers."""

import numpy as np
import pytest
from expert_checks import angle_between, run_expert, succeeding

from lerobot_dexflex.envs.assemble_table import CATCH_TILT
from lerobot_dexflex.experts.tool.grip import Handle
from lerobot_dexflex.experts.tool.hand import OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hands import LEAP

TOWARD, AWAY = (20, 11, 50), (6, 12, 13)
"""Seeds of legs that lean toward the robot, and away from it; one succeeds."""


def test_the_leg_is_lit_at_the_end():
    shown = succeeding("AssembleTable-v0", TOWARD)
    assert shown.env.lit
    assert set(np.round(6 * shown.progress)) == set(range(7))


@pytest.mark.parametrize(("seeds", "idle"), [(TOWARD, 2), (AWAY, 0)])
def test_the_lean_decides_which_two_fingers_hold_against_the_thumb(seeds, idle):
    shown = succeeding("AssembleTable-v0", seeds)
    assert (shown.env.episode.lean > 0) == (idle == 0)
    held = shown.forces[shown.during(2, 4)]
    used = np.setdiff1d(np.arange(4), [idle])
    assert ((held[:, used] > 0.05).mean(0) > 0.4).all()
    assert not held[:, idle].any()


def test_fingers_and_arm_share_the_righting_of_the_leg():
    shown = succeeding("AssembleTable-v0", TOWARD)
    lean = angle_between(shown.rotations[:, :, 2], np.array([0.0, 0.0, 1.0]))
    gripped, over = (int(np.argmax(shown.progress > stage)) for stage in (0.0, 2 / 6 + 1e-9))
    assert lean[gripped] == pytest.approx(abs(shown.env.episode.lean), abs=0.06)
    assert lean[over] < lean[gripped] - 0.12
    # The thread would not have caught it in this lean, so the palm leans against it.
    assert lean[over] > CATCH_TILT


@pytest.mark.parametrize("seeds", [TOWARD, AWAY])
def test_fingers_screw_the_leg_in_by_strokes_between_which_they_grasp_again(seeds, monkeypatch):
    grips, grip = [], OperatorHand.grip

    def counted(hand: OperatorHand, *values) -> None:
        grips.append(values)
        grip(hand, *values)

    monkeypatch.setattr(OperatorHand, "grip", counted)
    runs = (grips.clear() or run_expert("AssembleTable-v0", seed) for seed in seeds)
    shown = next(run for run in runs if run.infos[-1]["is_success"])
    assert len(grips) > 2
    # The palm stands still meanwhile.
    arm = np.array([command.joint_targets[:7] for command in shown.commands])[shown.during(4, 5)]
    assert np.ptp(arm[20:], axis=0).max() < 0.01


@pytest.mark.parametrize("habit", holds_of(LEAP).habits)
def test_the_three_pads_touch_an_upright_leg_and_stay_clear_while_open(habit):
    leg = Handle(habit.centre, np.array([0.0, 0.0, 1.0]), 0.012)
    grip = habit.grip(leg, room=0.02)
    used = list(habit.fingers)
    offsets, ahead = {}, {}
    for name in ("touch", "open"):
        centres, outward = kernels.pads(LEAP.tables, getattr(grip, name))
        offsets[name] = (centres - leg.centre)[used]
        # How far the leg's axis is in front of the pads' planes.
        ahead[name] = -(offsets[name] * outward[used]).sum(1)
    assert np.allclose(ahead["touch"], leg.radius, atol=1.5e-3)
    assert np.allclose(offsets["touch"][:, 2], 0, atol=1.5e-3)
    assert (ahead["open"] > leg.radius + 0.013).all()
    idle = np.repeat(~np.isin(np.arange(4), used), 4)
    assert np.array_equal(grip.touch[idle], habit.touch[idle])
