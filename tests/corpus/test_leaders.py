"""Who leads an episode, and how its drafts are spoilt."""

from dataclasses import replace

import numpy as np

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.corpus.acquisition import Acquisition, find_opening, open_episode
from lerobot_dexflex.corpus.distortion import Distortion, UnsteadyGrip, sample_errors
from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.goal_follower import GoalFollower
from lerobot_dexflex.corpus.schema import ACQUIRED, OPERATED, TURNED
from lerobot_dexflex.corpus.turning import Turning, find_turn
from lerobot_dexflex.corpus.world import World
from lerobot_dexflex.experts.reach.operator import Operator
from lerobot_dexflex.hand.poses import rotation_between
from lerobot_dexflex.hands import LEAP


def followed(hand, episode, errors, steps=60, strength=1.0):
    """Return the running episode and the leader, at the end."""
    rng = np.random.default_rng(0)
    run = RunningEpisode(CorpusEnv(hand), episode, World(), OPERATED, {})
    leader = GoalFollower(run, rng, steps, strength)
    run.run(leader, Distortion(hand, errors, rng))
    return run, leader


def test_errors_are_drawn_from_every_family():
    rng = np.random.default_rng(0)
    drawn = [sample_errors(rng) for _ in range(300)]
    families = [errors.name.partition("_")[0] for errors in drawn]
    assert set(families) == {"clean", "noise", "scale", "delay", "removal", "bias"}
    assert 0.1 < families.count("clean") / 300 < 0.2
    assert families.count("removal") > 80  # They alone take a contact away.
    delays = {error.strength for errors in drawn for error in errors if error.family == "delay"}
    assert delays == {1.0, 2.0, 3.0, 4.0}
    assert not any(sample_errors(rng, clean_share=1.0) for _ in range(20))


def test_even_shares_meet_every_family_as_often():
    rng = np.random.default_rng(0)
    families = [sample_errors(rng, clean_share=0.0, even=True).errors[0].family for _ in range(400)]
    shares = [families.count(family) / len(families) for family in sorted(set(families))]
    assert len(shares) == 5
    np.testing.assert_allclose(shares, 0.2, atol=0.06)


def test_an_unsteady_grip_errs_by_a_share_of_its_forces_that_lasts_some_steps():
    grip = np.array([[3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
    sizes, correlations = [], []
    for seed in range(30):
        unsteady = UnsteadyGrip(LEAP, np.random.default_rng(seed))
        errors = np.array([unsteady.step(grip) for _ in range(200)])
        assert not errors[:, 3].any()
        share = errors[:, :3] / np.linalg.norm(grip[:3], axis=1)[:, None]
        sizes.append(np.sqrt((share**2).sum(-1).mean()))
        correlations.append(np.corrcoef(share[1:].ravel(), share[:-1].ravel())[0, 1])
    assert max(sizes) <= 0.6
    assert 0.1 < np.mean(sizes) < 0.4
    assert 0.7 < np.mean(correlations) < 0.85


def test_an_error_of_the_grip_changes_what_is_executed_and_not_what_is_recorded_as_right(hand, episode):
    found = []
    for error in (None, np.full((hand.n_fingers, 3), 0.4)):
        run = RunningEpisode(CorpusEnv(hand), episode, World(), OPERATED, {})
        guidance = Operator(run.senses, np.random.default_rng(0)).guide(run.now)
        run.step(guidance, guidance.tips - run.now.tips, False, error)
        found.append(run.finish().tensors)
    steady, unsteady = found
    np.testing.assert_array_equal(steady["forces"], unsteady["forces"])
    np.testing.assert_array_equal(steady["wanted"], unsteady["wanted"])
    assert np.abs(steady["joint_targets"] - unsteady["joint_targets"]).max() > 0.005


def test_the_operators_command_and_spoilt_drafts_take_turns(hand, episode):
    run, _ = followed(hand, episode, CommandErrors.of(noise=0.001), steps=150)
    rows = run.finish().tensors
    lengths = np.diff(np.flatnonzero(np.diff(rows["expert"].astype(int))))
    assert rows["expert"][0]
    assert 0.2 < rows["expert"].mean() < 0.9
    assert lengths.min() >= 6
    assert lengths.max() <= 24
    difference = np.abs(rows["draft"].astype(float) - rows["plan"]).max((1, 2, 3))
    assert (difference > 1e-4).all()  # Drafts are spoilt throughout, whoever is executed.
    assert difference[~rows["expert"]].max() <= 0.001 + 2e-5


def test_clean_drafts_are_the_plan_and_reach_goals(hand, episode):
    run, leader = followed(hand, episode, NO_ERRORS, steps=120)
    rows = run.finish().tensors
    assert leader.solved >= 2
    assert leader.attempted >= leader.solved
    assert run.lost_steps == 0
    assert len(rows["step"]) == 120
    np.testing.assert_array_equal(rows["draft"], rows["plan"])
    assert not rows["expert"].all()


def test_another_strength_is_exerted_but_the_right_forces_are_recorded(hand, episode):
    found = {}
    for strength in (0.8, 1.6):
        run, _ = followed(hand, episode, NO_ERRORS, steps=20, strength=strength)
        rows = run.finish().tensors
        found[strength] = rows["forces"][0], rows["loads"][-10:].sum(1).mean()
    np.testing.assert_array_equal(found[0.8][0], found[1.6][0])  # In the first state, which is the same.
    assert found[1.6][1] > 1.3 * found[0.8][1]


def test_an_object_is_taken_carried_and_given_back(hand, episode):
    env, rng, world = CorpusEnv(hand), np.random.default_rng(1), World()
    opening = find_opening(env, episode, rng)
    assert opening is not None
    run = RunningEpisode(env, open_episode(episode, world, opening, rng), world, ACQUIRED, {})
    run.run(Acquisition(opening, rng), Distortion(hand, NO_ERRORS, rng))
    rows = run.finish().tensors
    taken, given = world.supports
    assert taken.stop is not None
    assert (rows["loads"][0] == 0).all()
    assert (rows["loads"][taken.stop : given.start] > 0.05).sum(1).min() >= 2
    assert rows["loads"][-1].max() < 0.2
    assert not rows["lost"].any()
    forces = np.linalg.norm(rows["forces"], axis=-1)
    assert not forces[0].any()  # Approach,
    squeezed = rows["loads"][taken.stop] > 0.1
    assert (squeezed & opening.active).sum() >= 3
    assert ((forces[taken.stop - 1] > 0.5) == squeezed).all()  # squeeze,
    assert not forces[-1].any()  # retreat.
    first = np.flatnonzero((rows["loads"] > 0.1).any(1))[0]
    assert not forces[:first].any()
    touching = rows["loads"][first] > 0.1
    assert (forces[first][touching] > 0.1).all()  # A finger presses from its first touch on,
    leaving = np.linalg.norm(rows["plan"][given.start :, -1].astype(float), axis=-1) > 0.01
    step, finger = np.argwhere(leaving)[0]
    assert forces[given.start + step + 8, finger] == 0  # and no more once its plan leads away.
    motion = np.linalg.norm(rows["wanted"] - rows["fingertips"], axis=-1)
    assert motion.max() < 0.02
    width = np.linalg.norm(rows["fingertips"][0] - rows["fingertips"][taken.stop], axis=1)
    assert width[opening.active].min() > 0.01


def test_an_object_on_a_hinge_is_turned_by_strokes_with_regrasps(hand, episode):
    env, rng = CorpusEnv(hand), np.random.default_rng(1)
    opening = find_opening(env, episode, rng)
    assert opening is not None
    turn = find_turn(hand, opening, episode, rng)
    assert turn is not None
    assert abs(turn.end - turn.begin) > 0.15
    joints = tuple(opening.joints.tolist())
    start = replace(episode, hand_joints=joints, joint_targets=joints)
    run = RunningEpisode(env, start, World(hinge=turn.hinge), TURNED, {})
    leader = Turning(opening, rng, 1.0, turn)
    run.run(leader, Distortion(hand, NO_ERRORS, rng))
    rows = run.finish().tensors
    assert leader.strokes >= 2
    assert leader.done > 0.6 * leader.wanted
    axis = np.array(turn.hinge.axis)
    first, last = rows["object"][0, 3:].astype(float), rows["object"][-1, 3:].astype(float)
    turned = rotation_between(first, last)
    assert np.linalg.norm(turned - (turned @ axis) * axis) < 0.05
    assert np.ptp(rows["object"][:, :3], 0).max() < 0.003
    assert not rows["lost"].any()
    holding = (rows["loads"] > 0.1).sum(1) >= 2  # It is let go between strokes.
    assert np.diff(holding.astype(int)).clip(0).sum() >= leader.strokes
    assert not rows["forces"][0].any()


def test_an_object_that_no_finger_can_turn_is_left_out(hand, episode):
    env, rng = CorpusEnv(hand), np.random.default_rng(1)
    opening = find_opening(env, episode, rng)
    assert opening is not None
    far = opening._replace(closed=opening.closed + np.array([0.0, 0.0, -0.2]))
    assert find_turn(hand, far, episode, rng) is None


def test_a_dropped_object_ends_the_episode(hand, episode):
    class LettingGo(GoalFollower):
        """Asks for what it wants without any grip, away from the object."""

        def guide(self, run):
            guidance = super().guide(run)
            if guidance is None:
                return None
            return guidance._replace(
                joints=run.now.joints + 0.15 * (np.array(hand.relaxed_joints) - run.now.joints)
            )

    rng = np.random.default_rng(0)
    run = RunningEpisode(CorpusEnv(hand), episode, World(), OPERATED, {})
    run.run(LettingGo(run, rng, 100), Distortion(hand, NO_ERRORS, rng))
    rows = run.finish().tensors
    assert len(rows["step"]) < 100
    assert rows["lost"][-1]
