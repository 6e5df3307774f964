import numpy as np
import pytest

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.corpus.acquisition import Acquisition, find_opening, open_episode
from lerobot_dexflex.corpus.distortion import Distortion, sample_errors
from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.execution import Driven, run_interface, run_raw
from lerobot_dexflex.corpus.goal_follower import GoalFollower
from lerobot_dexflex.corpus.world import World
from lerobot_dexflex.interfaces import make_interface


def driven(episode, errors, steps=60, seed=0):
    rng = np.random.default_rng(seed)
    run = RunningEpisode(CorpusEnv(), episode, World(), 1, {})
    return Driven(run, GoalFollower(run, rng, steps), Distortion(errors, rng))


def test_corruptions_are_drawn_from_every_family():
    rng = np.random.default_rng(0)
    drawn = [sample_errors(rng) for _ in range(300)]
    families = [errors.name.partition("_")[0] for errors in drawn]
    assert set(families) == {"clean", "noise", "scale", "delay", "removal", "bias"}
    assert 0.1 < families.count("clean") / 300 < 0.2
    delays = {error.strength for errors in drawn for error in errors if error.family == "delay"}
    assert delays == {1.0, 2.0, 3.0, 4.0, 5.0}


def test_clean_and_corrupted_stretches_take_turns(episode):
    ride = driven(episode, CommandErrors.of(noise=0.001))
    run_raw(ride)
    rows = ride.run.finish().tensors
    lengths = np.diff(np.flatnonzero(np.diff(rows["expert"].astype(int))))
    assert rows["expert"][0]
    assert 0.2 < rows["expert"].mean() < 0.9
    assert lengths.min() >= 6
    assert lengths.max() <= 24
    assert np.abs(rows["draft"] - rows["label"])[~rows["expert"]].max() <= 0.001 + 1e-6


def test_the_operator_reaches_goals_with_clean_commands(episode):
    ride = driven(episode, NO_ERRORS, steps=120)
    run_raw(ride)
    assert isinstance(ride.leader, GoalFollower)
    assert ride.leader.solved >= 2
    assert ride.run.lost_steps == 0
    assert ride.run.finish().tensors["expert"].all()


@pytest.mark.parametrize("batch", [1, 2])
def test_the_raw_interface_does_what_raw_execution_does(episode, batch):
    reference = driven(episode, CommandErrors.of(bias=0.0005), steps=30)
    run_raw(reference)
    waiting = iter([driven(episode, CommandErrors.of(bias=0.0005), steps=30) for _ in range(3)])
    ended = list(run_interface(waiting, make_interface("raw"), batch))
    assert len(ended) == 3
    for ride in ended:
        found, expected = ride.run.finish().tensors, reference.run.finish().tensors
        np.testing.assert_allclose(found["command"][:12], expected["command"][:12], atol=1e-5)
        clean = expected["expert"]
        np.testing.assert_array_equal((found["draft"] == found["label"]).all((1, 2)), clean)


def test_an_object_is_taken_carried_and_given_back(episode):
    env, rng, world = CorpusEnv(), np.random.default_rng(1), World()
    opening = find_opening(env, episode, rng)
    assert opening is not None
    run = RunningEpisode(env, open_episode(episode, world, opening, rng), world, 2, {})
    run_raw(Driven(run, Acquisition(opening, rng), Distortion(NO_ERRORS, rng)))
    rows = run.finish().tensors
    first, second = world.supports
    assert first.stop is not None
    assert (rows["loads"][0] == 0).all()
    assert (rows["loads"][first.stop][opening.active] > 0.1).all()
    assert (rows["loads"][first.stop : second.start] > 0.05).sum(1).min() >= 2
    assert rows["loads"][-1].max() < 0.2
    assert not rows["lost"].any()
    assert np.linalg.norm(rows["executed"], axis=-1).max() < 0.02
    open_width = np.linalg.norm(rows["command"][0] - rows["command"][first.stop], axis=1)
    assert open_width[opening.active].min() > 0.01
