"""The loop pairs methods, refills its slots, tells what happened, and judges drops."""

import numpy as np
import pytest
import torch

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.loop import PRESSING, run_chains
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.evaluation.reach import bounds
from lerobot_dexflex.experts.reach.chains import N_GOALS, Chain, build_chain
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface
from lerobot_dexflex.interfaces.method import make_interface

STEPS = 30
NOISE = CommandErrors.of(noise=0.001)


@pytest.fixture(scope="module")
def chains():
    env = ReachEnv(cameras=())
    found = [chain for seed in range(50_000, 50_012) if (chain := build_chain(env, seed, verify=False))]
    assert len(found) >= 3
    return found[:3]


def same(first, second, *names):
    for name in names:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)


@pytest.mark.parametrize("source", ["motion", "pressing"])
@pytest.mark.parametrize("name", ["press:2.5+smoothing=0.4", "projection"])
def test_the_batch_size_changes_nothing(chains, name, source):
    """Three slots at once, or one that is refilled: resets by row included."""

    def run(batch):
        return run_chains(
            chains, NOISE, make_interface(LEAP, name), source=source, batch=batch, max_steps=STEPS
        )

    wide, narrow, mixed = (run(batch) for batch in (3, 1, 2))
    assert max(episode.steps for episode in wide) == STEPS or name == "projection"
    for first, *others in zip(wide, narrow, mixed, strict=True):
        for other in others:
            same(first, other, "goal_error", "selected", "draft", "loads", "progress_at")
            assert first.chain == other.chain


def test_methods_meet_the_same_errors(chains):
    errors = CommandErrors.parse("bias_1mm+noise_2mm")
    firm, loose = (
        run_chains(chains[:2], errors, make_interface(LEAP, name), max_steps=8)
        for name in ("press:3", "press:2")
    )
    for first, second in zip(firm, loose, strict=True):
        np.testing.assert_allclose(first.draft - first.label, second.draft - second.label, atol=1e-12)
        assert np.abs(first.draft - first.label).max() > 0.001
        np.testing.assert_array_equal(first.label[0], second.label[0])
        assert not np.array_equal(first.loads, second.loads)  # They are told the same and do not the same.


def test_another_seed_gives_other_errors(chains):
    first, second = (
        run_chains(chains[:1], NOISE, make_interface(LEAP, "raw"), max_steps=2, seed=seed)[0]
        for seed in (0, 1)
    )
    assert np.abs((first.draft - first.label) - (second.draft - second.label)).max() > 1e-4


def test_people_lead_in_the_hand_too_each_chain_another(chains):
    errors = CommandErrors.parse("typical")
    first, second = run_chains(chains[:2], errors, make_interface(LEAP, "press:2.5"), max_steps=STEPS)
    for episode in (first, second):
        assert 5e-4 < np.abs(episode.draft - episode.label)[5:].max() < 0.02
    assert np.abs((first.draft - first.label)[0] - (second.draft - second.label)[0]).max() > 1e-4
    (again,) = run_chains(chains[:1], errors, make_interface(LEAP, "press:2.5"), max_steps=STEPS)
    same(first, again, "draft", "goal_error")


def test_chains_may_have_errors_of_their_own(chains):
    removal = CommandErrors.of(removal=0.002)
    first, second = run_chains(
        chains[:2], [removal, NO_ERRORS], make_interface(LEAP, "press:2.5"), max_steps=STEPS
    )
    assert (second.events, second.in_event.any()) == ([], False)
    np.testing.assert_allclose(second.draft, second.label, atol=1e-15)
    steps = [k for event in first.events for k in range(event.onset, event.end)]
    assert steps == np.flatnonzero(first.in_event).tolist()
    event = first.events[0]
    assert event.finger == first.loads[event.onset].argmax()
    changed = np.abs(first.draft - first.label).max(2) > 1e-9
    assert changed[event.onset : event.end, event.finger].all()
    assert changed.sum() == len(steps)


def test_a_hand_that_opens_is_a_drop_and_raw_opens(chains):
    (episode,) = run_chains(chains[:1], CommandErrors.of(scale=0.0), make_interface(LEAP, "raw"))
    assert episode.dropped
    assert episode.steps < 60
    assert episode.progress < 0.5


def test_a_pressing_source_commands_into_the_object_by_its_own_share(chains):
    """The labels are those of motion; what the draft has more goes into the object."""
    motion = run_chains(chains[:2], NO_ERRORS, make_interface(LEAP, "raw"), max_steps=1)
    pressing = run_chains(chains[:2], NO_ERRORS, make_interface(LEAP, "raw"), max_steps=1, source="pressing")
    shares = []
    for plain, pressed in zip(motion, pressing, strict=True):
        same(plain, pressed, "label", "loads")
        extra = (pressed.draft - pressed.label)[0]
        loaded = pressed.loads[0] > 0.5
        assert (np.linalg.norm(extra, axis=1)[loaded] > 0.001).all()
        shares.append(np.linalg.norm(extra))
    assert shares[0] != shares[1]
    assert PRESSING[0] > 0


def test_pressing_drafts_hold_the_object_without_a_grip_longer_than_those_of_motion(chains):
    steps = {
        source: sum(
            episode.steps
            for episode in run_chains(
                chains, NO_ERRORS, make_interface(LEAP, "raw"), source=source, max_steps=2 * STEPS
            )
        )
        for source in ("motion", "pressing")
    }
    assert steps["pressing"] > steps["motion"]


def test_what_is_told_of_an_episode_fits_together(chains):
    (episode,) = run_chains(chains[:1], NOISE, make_interface(LEAP, "press:2.5"), max_steps=STEPS)
    assert isinstance(episode.chain, Chain)
    assert len(episode.chain.goals) == N_GOALS
    lengths = {name: len(getattr(episode, name)) for name in ("draft", "selected", "loads", "in_event")}
    assert set(lengths.values()) == {episode.steps}
    assert episode.progress_at.shape == (episode.steps,)
    assert (np.diff(episode.progress_at) >= -1e-12).all()
    assert episode.progress_at[-1] == episode.progress
    assert len(episode.goal_steps) == episode.goals_reached
    np.testing.assert_allclose(episode.selected, episode.draft, atol=1e-12)  # `press` selects nothing.


class Blind(CommandedInterface):
    """Does nothing and says why."""

    name = "blind"

    class _Why:
        def row(self, index):
            return index

    explanation = _Why()

    def step(self, observation, draft):
        measured = self._hand.look(observation)
        return self.move(measured, torch.zeros_like(draft[:, 0])).to(draft.dtype)


def test_explanations_are_kept_row_by_row_and_steps_can_be_watched(chains):
    seen = []
    episodes = run_chains(
        chains[:2],
        NO_ERRORS,
        Blind(LEAP),
        max_steps=3,
        watch=lambda n, slot: seen.append((n, slot.steps)),
    )
    assert [episode.explanations for episode in episodes] == [[0] * 3, [1] * 3]
    assert seen == [(0, 1), (1, 1), (0, 2), (1, 2), (0, 3), (1, 3)]


def test_the_operators_own_targets_get_further_than_a_hand_that_does_nothing(chains):
    (operator,) = run_chains(
        chains[:1], NO_ERRORS, make_interface(LEAP, bounds.OPERATOR), max_steps=2 * STEPS
    )
    (nothing,) = run_chains(chains[:1], NO_ERRORS, Blind(LEAP), max_steps=2 * STEPS)
    assert operator.progress > nothing.progress + 0.05
    np.testing.assert_allclose(operator.selected, operator.label, atol=1e-12)
