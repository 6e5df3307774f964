"""How the operator turns the slice over, and what of that its fingers do."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from expert_checks import Demonstration, angle_between, check_drafts_press, run_expert

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.experts.flip_toast import TIPPED, WOUND_UP
from lerobot_dexflex.experts.tool.bar import HELD
from lerobot_dexflex.experts.tool.spatula import straight, tipped

SEEDS = (0, 1, 2, 3)
_UNDER, _ON_EDGE = 0.3, 0.6


@pytest.fixture(scope="module")
def shown() -> list[Demonstration]:
    """Four demonstrations, those that succeed first: another processor may fail in another one."""
    found = [run_expert("FlipToast-v0", seed) for seed in SEEDS]
    return sorted(found, key=lambda demo: not demo.infos[-1]["is_success"])


def pitch(demo: Demonstration) -> np.ndarray:
    """Return by how much the blade is raised in the palm [rad]. Shape (steps,)."""
    return np.arcsin(demo.rotations[:, 2, 2])


def first(demo: Demonstration, progress: float) -> int:
    return int(np.argmax(demo.progress > progress - 1e-9))


def test_the_operator_turns_the_slice_over_well_within_the_time_limit(shown):
    succeeded = [demo for demo in shown if demo.infos[-1]["is_success"]]
    assert len(succeeded) >= 3
    for demo in succeeded:
        assert (np.diff(demo.progress) >= 0).all()
        assert demo.progress[-1] == 1
        assert len(demo.commands) < 0.85 * TASKS["FlipToast-v0"].max_episode_steps
        assert demo.env.turned > np.radians(150)


def test_the_slice_is_pushed_over_its_edge_and_not_thrown(shown):
    for demo in shown[:3]:
        rising = demo.progress[first(demo, 0.5) :]
        assert 4 <= int(np.argmax(rising > _ON_EDGE)) <= 30


def test_the_slice_loads_the_grasp(shown):
    for demo in shown[:3]:
        under = first(demo, _UNDER)
        squeeze = demo.forces.sum(1)
        free = np.median(squeeze[under - 40 : under - 20])
        assert np.median(squeeze[under + 20 : under + 35]) > 1.05 * free


def test_the_spatula_is_gripped_askew_and_turned_straight_in_the_hand(shown):
    for demo in shown[:3]:
        askew = angle_between(demo.rotations[:, :, 2], HELD[:, 2])
        episode = demo.env.episode
        gripped = int(np.argmax([info["holding"] for info in demo.infos]))
        assert askew[gripped] == pytest.approx(abs(episode.stand[2] + episode.spatula_yaw), abs=0.08)
        assert askew[first(demo, _UNDER)] < 0.12


def test_the_fingers_wind_the_spatula_up_and_tip_it(shown):
    assert WOUND_UP > 0 > TIPPED
    swings = []
    for demo in shown[:3]:
        over = first(demo, _ON_EDGE)
        swings.append(np.ptp(pitch(demo)[over - 40 : over + 1]))
    assert np.median(swings) > 0.15


def test_a_spatula_is_tipped_about_where_it_is_gripped():
    script: Any = SimpleNamespace(grasp_centre=np.array([-0.04, -0.03, -0.14]))
    held = straight(script)
    turned = tipped(script, held, -0.2)
    assert np.arcsin(turned.rotation[2, 2]) == pytest.approx(-0.2)
    back = tipped(script, turned, 0.2)
    assert np.allclose(back.position, held.position)
    assert np.allclose(back.rotation, held.rotation)


def test_drafts_are_motion_and_joint_targets_press(shown):
    demo = shown[0]
    held = np.array([info["holding"] for info in demo.infos])
    check_drafts_press(demo.commands, demo.tips, demo.forces, held)
