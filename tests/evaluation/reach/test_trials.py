"""Trying chunks out tells what they would come to and leaves no trace."""

import numpy as np
import pytest

from lerobot_dexflex.commands.families import NO_ERRORS
from lerobot_dexflex.commands.loop import Slot
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.evaluation.reach.trials import LOST_GRASP, try_out
from lerobot_dexflex.experts.reach.chains import build_chain


@pytest.fixture
def slot():
    chain = build_chain(ReachEnv(cameras=()), 50_006, verify=False)
    assert chain is not None
    running = Slot(ReachEnv(cameras=()), chain, NO_ERRORS)
    for _ in range(5):
        running.ask()
        assert running.guidance is not None
        running.advance(running.guidance.joints, np.zeros((4, 3)), None)
    running.ask()
    return running


def test_letting_go_costs_a_grasp_and_trying_it_out_changes_nothing(slot):
    before = slot.held.env.snapshot()
    follow = slot.guidance.tips - slot.state.tips
    away = slot.state.tips - slot.state.position
    open_hand = follow + 0.008 * np.arange(1, 9)[:, None, None] * away / np.linalg.norm(away, axis=1)[:, None]
    found = try_out(slot, np.stack([follow, open_hand, follow]), follow, lambda _: slot.guidance.forces)
    assert found.grasp_lost.tolist() == [False, True, False]
    assert found.lost[1].sum() >= 2
    assert found.cost[0] == found.cost[2] < LOST_GRASP < found.cost[1]
    after = slot.held.env.snapshot()
    np.testing.assert_array_equal(before.physics, after.physics)
    assert before.rng == after.rng


def test_without_a_grip_the_same_motion_loses_the_grasp(slot):
    follow = (slot.guidance.tips - slot.state.tips)[None]
    assert try_out(slot, follow, follow[0], lambda _: np.zeros((4, 3))).grasp_lost.all()


def test_a_chunk_is_tried_for_as_many_steps_as_asked(slot):
    still = np.zeros((8, 4, 3))
    late = still.copy()
    late[2:, :, 2] = 0.002

    def cost(chunk, moving=8):
        return try_out(slot, chunk[None], still, lambda _: slot.guidance.forces, moving).cost[0]

    assert cost(late, 2) == cost(still)
    assert cost(late) > cost(still)
