"""Every expert solves its task, in a way that can be learned: its drafts are motion, its joints press."""

import numpy as np
import pytest
from expert_checks import demonstrate, make_env, seed_of

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hands import LEAP

EXPERTS = ("AssembleTable-v0", "PlaceHammer-v0", "PourCup-v0", "Screwdriver-v0")


@pytest.fixture(params=EXPERTS)
def task(request):
    return request.param


def commanded_tips(commands) -> np.ndarray:
    return np.array([kernels.fingertips(LEAP.tables, command.joint_targets[7:]) for command in commands])


def test_the_expert_solves_its_task_well_within_the_time_limit(task):
    shown = demonstrate(task)
    assert shown.infos[-1]["is_success"]
    assert shown.infos[-1]["progress"] == 1
    assert len(shown.commands) < 0.85 * TASKS[task].max_episode_steps


@pytest.mark.parametrize("seed", [3, 8])
def test_the_expert_solves_other_seeds(task, seed):
    assert demonstrate(task, seed).infos[-1]["is_success"]


def test_progress_never_falls(task):
    assert (np.diff(demonstrate(task).progress) >= 0).all()


def test_a_seed_decides_every_command(task):
    env = make_env(task)
    env.reset(seed=seed_of(task))
    commands = make_expert(task)(env, np.random.default_rng(seed_of(task)))
    for expected, _ in zip(demonstrate(task).commands, range(60), strict=False):
        command = next(commands)
        for mine, other in zip(command, expected, strict=True):
            assert np.array_equal(mine, other)
        env.step(command.executed)


def test_drafts_say_where_the_fingertips_will_be(task):
    shown = demonstrate(task)
    drafts = np.array([command.draft for command in shown.commands])
    misses = np.linalg.norm(drafts[:, 0] - shown.tips, axis=-1)
    assert np.median(misses) < 0.002
    held = shown.during(2, 4)
    assert np.percentile(misses[held], 95) < 0.006


def test_commanded_fingertips_of_holding_fingers_press_deeper_than_the_draft(task):
    shown = demonstrate(task)
    held = shown.during(2, 4)
    drafts = np.array([command.draft[0] for command in shown.commands])
    deeper = np.linalg.norm(commanded_tips(shown.commands) - drafts, axis=-1)[held]
    holding = np.median(shown.forces[held], axis=0) > 0.5
    assert holding.sum() >= 3
    assert (np.median(deeper, axis=0)[holding] > 0.004).all()
    # Where fingers are free, before the first touch, commanded tips are the draft.
    free = shown.progress[:30] == 0
    assert free.all()
    assert np.allclose(commanded_tips(shown.commands)[:30], drafts[:30], atol=1e-9)


def test_no_finger_exceeds_what_the_thumb_can_do_for_long(task):
    """The thumb presses with 6 N at its motors' limit (`hands.leap`); a pinch lets none do much more."""
    shown = demonstrate(task)
    held = shown.forces[shown.during(2, 4)]
    assert np.percentile(held, 95, axis=0).max() < 7.0
    assert (np.median(held, axis=0)[:3] < 4.0).all()


def test_unsteadiness_is_small_and_only_executed(task):
    offsets = np.array([command.executed - command.joint_targets for command in demonstrate(task).commands])
    assert 0.001 < offsets[:, :7].std() < 0.02
    assert 0.0005 < offsets[:, 7:].std() < 0.01


def test_joint_7_never_turns_a_full_turn(task):
    wrist = np.array([command.joint_targets[6] for command in demonstrate(task).commands])
    assert np.ptp(wrist) < np.pi / 2


@pytest.mark.parametrize("task", ["PlaceHammer-v0", "PourCup-v0"])
def test_replaying_the_recorded_commands_without_noise_succeeds(task):
    """But for the leg: strokes react to how it turned."""
    env, commands = make_env(task), demonstrate(task).commands
    _, info = env.reset(seed=seed_of(task))
    for command in [*commands, *[commands[-1]] * 20]:
        *_, done, _, info = env.step(command.joint_targets)
        if done:
            break
    assert info["is_success"]


def test_unknown_task_is_refused_with_the_valid_ones():
    with pytest.raises(DexFlexError, match=r"'Juggle-v0'.*PlaceHammer-v0"):
        make_expert("Juggle-v0")
