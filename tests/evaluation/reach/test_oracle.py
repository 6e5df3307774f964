"""The oracle sees the true outcome of candidates and leaves no trace."""

import numpy as np
import pytest

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.loop import Slot, run_chains
from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.oracle import LOST_GRASP, OracleInterface, try_out
from lerobot_dexflex.experts.reach.chains import build_chain


@pytest.fixture(scope="module")
def chain():
    return build_chain(ReachEnv(cameras=()), 50_001, verify=False)


def test_letting_go_costs_a_grasp_and_trying_it_out_changes_nothing(chain):
    slot = Slot(ReachEnv(cameras=()), chain, NO_ERRORS)
    before = slot.held.env.snapshot()
    hold, open_hand = np.zeros((2, 8, 4, 3))
    away = slot.held.command - slot.state.position
    open_hand[:] = 0.008 * away / np.linalg.norm(away, axis=1, keepdims=True)
    cost, lost, grasp = try_out(slot, np.stack([hold, open_hand]), hold)
    assert grasp.tolist() == [0, 1]
    assert lost[1].sum() >= 2
    assert cost[0] < LOST_GRASP < cost[1]
    after = slot.held.env.snapshot()
    np.testing.assert_array_equal(before.physics, after.physics)
    assert before.rng == after.rng


def test_a_chunk_is_tried_for_as_many_steps_as_asked(chain):
    slot = Slot(ReachEnv(cameras=()), chain, NO_ERRORS)
    late = np.zeros((1, 8, 4, 3))
    late[0, 2:] = 0.005
    whole, two = (try_out(slot, late, np.zeros((8, 4, 3)), moving)[0][0] for moving in (8, 2))
    assert two == try_out(slot, np.zeros((1, 8, 4, 3)), np.zeros((8, 4, 3)))[0][0]
    assert whole > two


def test_with_the_draft_alone_the_oracle_is_raw_and_explains_itself(chain, controller):
    settings = SelectionSettings(n_pure=0, n_seeded=0, project=False)
    oracle = OracleInterface(controller, "clean", settings=settings)
    (episode,) = run_chains([chain], CommandErrors.of(noise=0.001), oracle, max_steps=3)
    np.testing.assert_allclose(episode.executed, episode.draft, atol=1e-7)  # Chunks are single precision.
    assert [row["branch"] for row in episode.explanations] == ["draft"] * 3


@pytest.mark.parametrize("moving", [0, 9, 1.5])
def test_a_horizon_that_no_chunk_has_is_refused(controller, moving):
    with pytest.raises(DexFlexError, match="from 1 to 8"):
        OracleInterface(controller, moving=moving)


def test_an_unknown_reference_is_refused(controller):
    with pytest.raises(DexFlexError, match="'draft' or 'clean'"):
        OracleInterface(controller, "goal")  # pyright: ignore[reportArgumentType]
