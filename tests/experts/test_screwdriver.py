"""How the operator holds the driver, presses it into the screw and turns it with the fingers."""

import numpy as np
import pytest
from expert_checks import angle_between, demonstrate, run_expert

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.experts.screwdriver import AXIS, STROKES
from lerobot_dexflex.experts.tool.grip import Handle, without
from lerobot_dexflex.experts.tool.hand import OperatorHand
from lerobot_dexflex.experts.tool.holds import PADS_TURN
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hands import LEAP

TASK, SEED = "Screwdriver-v0", 53_003
DRIVER, TURNING = holds_of(LEAP).driver, without(LEAP, -1)


def test_the_operator_succeeds_in_three_of_four_seeds_well_within_the_time_limit():
    shown = [demonstrate(TASK, seed) for seed in (3, 8, 11, 53_000)]
    assert sum(each.infos[-1]["is_success"] for each in shown) >= 3
    assert np.median([len(each.commands) for each in shown]) < 0.85 * TASKS[TASK].max_episode_steps
    for each in shown:
        assert (np.diff(each.progress) >= 0).all()


def test_fingers_right_the_driver_while_the_palm_stays_level():
    shown = demonstrate(TASK, 53_000)
    lean = angle_between(shown.rotations[:, :, 2], AXIS)
    gripped, seated = (int(np.argmax(shown.progress > stage)) for stage in (0.0, 2 / 6 + 1e-9))
    assert lean[gripped] == pytest.approx(abs(shown.env.episode.lean), abs=0.06)
    assert lean[seated] < 0.05


def test_three_fingers_turn_the_screw_by_strokes_while_the_palm_stands_still(monkeypatch):
    grips, grip = [], OperatorHand.grip

    def counted(hand: OperatorHand, *values) -> None:
        grips.append(values)
        grip(hand, *values)

    monkeypatch.setattr(OperatorHand, "grip", counted)
    shown = run_expert(TASK, SEED)
    assert len(grips) > 2
    turning = (shown.progress > 3.2 / 6) & (shown.progress < 5 / 6 - 0.01)
    arm = np.array([command.joint_targets[:7] for command in shown.commands])[turning]
    assert np.ptp(arm, axis=0).max() < 0.01
    # Thumb and fingers press while they turn, and the ring finger does not.
    loads = np.percentile(shown.forces[turning], 90, axis=0)
    assert (loads[list(TURNING)] > 1.0).all()
    assert loads[3] > 3.0
    assert loads[2] < 0.1


@pytest.mark.parametrize("radius", [0.011, 0.014])
def test_pads_lie_on_the_handle_wherever_a_stroke_begins(radius):
    handle = Handle(DRIVER.bar.centre, AXIS, radius)
    used = list(TURNING)
    for back in (0.0, STROKES.angle / 4, STROKES.angle / 2):
        grip = DRIVER.grip(TURNING, handle, back)
        centres, outward = kernels.pads(LEAP.tables, grip.touch)
        ahead = -((centres - DRIVER.bar.centre) * outward).sum(1)[used]
        assert np.allclose(ahead, radius, atol=5e-3), back
        # Middles of the pads move along the handle's skin, fingers one way and the thumb the other.
        aside = np.cross(AXIS, grip.inward)
        assert np.allclose(
            ((centres - DRIVER.bar.centre) * aside).sum(1)[used],
            np.array([0, 0, 0.002]) - radius * (1 - PADS_TURN) * back,
            atol=3e-3,
        ), back
