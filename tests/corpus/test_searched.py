import dataclasses

import numpy as np
import pytest

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.replays import replay
from lerobot_dexflex.corpus.schema import FAILED, HORIZON, SEARCH, check_rows
from lerobot_dexflex.corpus.searched import search_episode
from lerobot_dexflex.corpus.world import World


@pytest.fixture(scope="module")
def branches(episode):
    return searched(episode)


@pytest.fixture(scope="module")
def hard_branches(episode):
    """Search with an object that is heavy and slippery."""
    spec = dataclasses.replace(episode.object_spec, friction=0.35, mass=0.15)
    return searched(dataclasses.replace(episode, object_spec=spec))


def searched(episode):
    world, rng = World(gravity_rate=0.1), np.random.default_rng(2)
    return list(search_episode(CorpusEnv(), episode, world, rng, {"seed": 4}))


def test_the_episode_reaches_goals_and_never_loses_the_object(branches):
    kept = branches[-1]
    check_rows(kept.tensors, kept.episodes)
    assert (kept.tensors["kind"] == SEARCH).all()
    assert kept.tensors["expert"].all()
    np.testing.assert_array_equal(kept.tensors["draft"], kept.tensors["label"])
    lost = kept.tensors["lost"]
    assert not (lost[:-2] & lost[1:-1] & lost[2:]).any()
    assert kept.episodes[0]["goals_solved"] >= 2


def test_failed_branches_end_with_a_lost_object(hard_branches):
    failed = [branch for branch in hard_branches if branch.episodes[0]["kind"] == FAILED]
    assert failed
    for branch in failed:
        check_rows(branch.tensors, branch.episodes)
        assert (branch.tensors["kind"] == FAILED).all()
        assert not branch.tensors["expert"].any()
        assert branch.tensors["lost"][-3:].all()


def test_what_is_left_after_backtracking_is_one_consistent_episode(branches, hard_branches):
    for branch in (branches[-1], hard_branches[0], hard_branches[-1]):
        tensors = branch.tensors
        kept = np.flatnonzero(tensors["snapshot_step"] + HORIZON < len(tensors["step"]))
        rows = tensors["snapshot_step"][kept][:, None]
        chunks = tensors["executed"][rows + np.arange(HORIZON)].astype(float)
        found = replay(branch, kept, chunks)
        after = rows + 1 + np.arange(HORIZON)
        np.testing.assert_array_equal(found["joints"].astype(np.float32), tensors["joints"][after])
        np.testing.assert_array_equal(found["loads"].astype(np.float32), tensors["loads"][after])
