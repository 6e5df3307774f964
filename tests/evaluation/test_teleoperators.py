import gymnasium
import numpy as np
import pytest

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation import teleoperators
from lerobot_dexflex.evaluation.rollout import run_group
from lerobot_dexflex.evaluation.teleoperators import Teleoperators
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.command import Command, fingertips_of
from lerobot_dexflex.hands import LEAP

TASK = "PlaceHammer-v0"


def environments(count):
    return [
        gymnasium.make(f"lerobot_dexflex/{TASK}", cameras=(), disable_env_checker=True) for _ in range(count)
    ]


def observations(envs, seeds):
    """Reset the environments; returns their observations, stacked."""
    rows = [env.reset(seed=seed)[0] for env, seed in zip(envs, seeds, strict=True)]
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def act(controller, envs, seeds, steps):
    """Execute some steps; returns the joint targets, (steps, batch, 23)."""
    controller.reset(seeds)
    observation = observations(envs, seeds)
    controller.see(envs)
    actions = []
    for _ in range(steps):
        actions.append(controller.act(observation, "task"))
        rows = [env.step(action)[0] for env, action in zip(envs, actions[-1], strict=True)]
        observation = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return np.array(actions)


def test_without_a_glove_joint_is_what_the_expert_does_bit_for_bit():
    (env,) = environments(1)
    actions = act(Teleoperators(LEAP, TASK)("joint"), [env], [7], 60)[:, 0]
    env.reset(seed=7)
    commands = make_expert(TASK)(env.unwrapped, np.random.default_rng((7, 2)))
    for action in actions:
        command = next(commands)
        np.testing.assert_array_equal(action, command.executed)
        env.step(command.executed)


def test_a_teleoperator_without_a_glove_solves_its_task_and_its_motion_is_told():
    controller = Teleoperators(LEAP, TASK, source="pressing")("raw")
    [recorder] = run_group(environments(1), controller, [7])
    assert recorder.success
    assert controller.motion is not None
    assert recorder.outcome("raw", 7).intervention == pytest.approx(0, abs=1e-6)


def test_drafts_of_motion_alone_hold_nothing():
    [recorder] = run_group(environments(1), Teleoperators(LEAP, TASK, source="motion")("raw"), [7])
    assert not recorder.success


@pytest.mark.parametrize("interface", ["raw", "press"])
def test_rows_have_their_own_glove_and_interface(interface):
    controller = Teleoperators(LEAP, TASK)(interface, CommandErrors.of(noise=0.004))
    envs = environments(2)
    both = act(controller, envs, [7, 8], 6)
    alone = [act(controller, [env], [seed], 6)[:, 0] for env, seed in zip(envs, (7, 8), strict=True)]
    np.testing.assert_allclose(both[:, 0], alone[0], atol=1e-9)
    np.testing.assert_allclose(both[:, 1], alone[1], atol=1e-9)
    again = act(controller, envs, [7, 8], 6)
    np.testing.assert_array_equal(both, again)


def test_the_glove_shakes_the_hand_by_its_noise_and_not_the_arm():
    envs = environments(1)
    steady, shaken = (
        act(Teleoperators(LEAP, TASK)("raw", errors), envs, [7], 12)[:, 0]
        for errors in (NO_ERRORS, CommandErrors.of(noise=0.004))
    )
    # The arm follows the expert, which sees the shaken hand's object only after the grasp.
    np.testing.assert_allclose(shaken[:, :7], steady[:, :7], atol=1e-9)
    before, after = (np.array([fingertips_of(LEAP, a[7:]) for a in actions]) for actions in (steady, shaken))
    assert 0.002 < np.abs(after - before).max() < 0.005


def test_a_person_in_the_glove_leads_joints_and_drafts_and_is_drawn_by_the_seed():
    envs, errors = environments(1), CommandErrors.parse("novice")
    for interface in ("joint", "raw"):
        steady, first, again, other = (
            act(Teleoperators(LEAP, TASK)(interface, wrong), envs, [seed], 12)[:, 0]
            for wrong, seed in ((NO_ERRORS, 7), (errors, 7), (errors, 7), (errors, 8))
        )
        np.testing.assert_array_equal(first, again)
        tips = [np.array([fingertips_of(LEAP, a[7:]) for a in actions]) for actions in (steady, first, other)]
        assert 0.001 < np.abs(tips[1] - tips[0]).max() < 0.03
        assert np.abs(tips[2] - tips[1]).max() > 1e-3


def test_an_expert_that_is_done_keeps_its_last_command(monkeypatch):
    def brief(env, rng):
        for k in range(2):
            joints = env.command + 0.01 * (k + 1)
            yield Command(joints, joints, np.tile(fingertips_of(LEAP, joints[7:]), (8, 1, 1)))

    monkeypatch.setattr(teleoperators, "make_expert", lambda task: brief)
    actions = act(Teleoperators(LEAP, TASK)("raw"), environments(1), [7], 4)[:, 0]
    assert np.abs(actions[1] - actions[0]).max() > 1e-3
    np.testing.assert_allclose(actions[2:, :7], actions[[1, 1], :7], atol=1e-12)
    np.testing.assert_allclose(actions[2:, 7:], actions[[1, 1], 7:], atol=5e-3)


def test_what_cannot_run_is_refused_early(controller_folder, tmp_path):
    Teleoperators(LEAP, TASK, str(controller_folder)).check(["raw", "dexflex"])
    Teleoperators(LEAP, TASK).check(["raw", "joint"])
    with pytest.raises(DexFlexError, match="Unknown interface 'telepathy'"):
        Teleoperators(LEAP, TASK).check(["raw", "telepathy"])
    with pytest.raises(DexFlexError, match="No expert for task 'Reach-v0'"):
        Teleoperators(LEAP, "Reach-v0").check(["raw"])
    with pytest.raises(DexFlexError, match="No controller for"):
        Teleoperators(LEAP, TASK, str(tmp_path)).check(["dexflex"])


def test_a_version_holds_expert_interface_and_controller(controller_folder):
    raw = Teleoperators(LEAP, TASK).version("raw", TASK)
    assert raw == Teleoperators(LEAP, TASK, str(controller_folder)).version("raw", TASK)
    assert raw.code != Teleoperators(LEAP, TASK).version("press", TASK).code
    pressing = Teleoperators(LEAP, TASK, source="pressing")
    assert raw.name != pressing.version("raw", TASK).name
    assert Teleoperators(LEAP, TASK).version("joint", TASK) == pressing.version("joint", TASK)
    assert raw.code != Teleoperators(LEAP, "PourCup-v0").version("raw", "PourCup-v0").code
    shipped, other = (
        Teleoperators(LEAP, TASK, c).version("dexflex", TASK) for c in ("", str(controller_folder))
    )
    assert shipped.code == other.code
    assert shipped.weights != other.weights
