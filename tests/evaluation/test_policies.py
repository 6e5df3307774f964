import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.observed import ObservedInterface
from lerobot_dexflex.evaluation.policies import LeRobotPolicies
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.method import make_interface


@pytest.fixture(scope="module")
def policies(policy_checkpoint):
    """One checkpoint with random weights under all methods; fingertips of plans start from measured ones."""
    return LeRobotPolicies(LEAP, policy_checkpoint)


def observation(rows):
    rng = np.random.default_rng(0)
    images = {
        name: rng.integers(0, 255, (1, 96, 96, 3), np.uint8).repeat(rows, 0) for name in ("front", "wrist")
    }
    vectors = {"agent_pos": np.full((rows, 23), 0.3), "tactile": np.full((rows, 240), 0.01)}
    tips = fingertips(LEAP, torch.full((rows, 16), 0.3)).flatten(1).numpy()
    more = {"fingertips": tips, "gravity": np.tile([0.0, 0, -1], (rows, 1))}
    return {"pixels": images} | {key: value.astype(np.float32) for key, value in (vectors | more).items()}


def act(controller, seeds, steps=18):
    """Act past a second planning; shape (steps, rows, 23)."""
    controller.reset(seeds)
    return np.stack([controller.act(observation(len(seeds)), "task") for _ in range(steps)])


@pytest.mark.parametrize("interface", ["joint", "raw", "press"])
def test_a_seed_repeats_its_episode_bit_for_bit_and_another_differs(policies, interface):
    controller = policies(interface)
    first, other, again = act(controller, [5]), act(controller, [6]), act(controller, [5])
    assert first.shape == (18, 1, 23)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first[0] - other[0]).max() > 1e-3


@pytest.mark.parametrize("other", ["raw@0.5", "joint"])
def test_all_interfaces_get_the_same_plan(policies, other):
    # Arm targets come straight from the plan; only the hand differs.
    raw, others = act(policies("raw"), [5]), act(policies(other), [5])
    np.testing.assert_array_equal(raw[..., :7], others[..., :7])
    assert np.abs(raw[..., 7:] - others[..., 7:]).max() > 1e-3


def test_drafts_lead_to_measured_or_to_commanded_fingertips_of_the_same_plan(policies):
    measured, commanded = policies("raw"), replace(policies, draft="commanded")("raw")
    a, b = act(measured, [5]), act(commanded, [5])
    np.testing.assert_array_equal(a[..., :7], b[..., :7])
    assert np.abs(a[..., 7:] - b[..., 7:]).max() > 1e-3
    np.testing.assert_array_equal(act(replace(policies, draft="measured")("raw"), [5]), a)
    versions = [
        replace(policies, draft=d).version("raw", "PourCup-v0") for d in ("", "measured", "commanded")
    ]
    assert versions[0] == versions[1] != versions[2]
    joint = [replace(policies, draft=d).version("joint", "PourCup-v0") for d in ("", "commanded")]
    assert joint[0] == joint[1]


def test_a_row_does_not_depend_on_its_neighbours_noise(policies):
    controller = policies("raw")
    np.testing.assert_allclose(act(controller, [5, 6])[:, 0], act(controller, [5, 9])[:, 0], atol=1e-5)


def test_what_an_interface_did_to_the_draft_is_told_under_a_policy(policies):
    raw, damped = policies("raw"), policies("raw@0.5")
    act(raw, [5], steps=1)
    assert raw.motion.magnitude() < 1e-6
    act(damped, [5], steps=1)
    assert damped.motion.row(0).magnitude() == pytest.approx(0.5, abs=1e-3)


def test_joint_targets_have_no_draft_to_intervene_on(policies):
    controller = policies("joint")
    act(controller, [5], steps=1)
    assert controller.motion is None


def test_an_observer_sees_the_first_step_of_a_draft_and_the_motion_that_was_selected():
    interface = ObservedInterface(make_interface(LEAP, "raw@0.6"))
    draft = torch.zeros(1, 8, 4, 3)
    draft[0, :, 0, 0] = torch.arange(0.010, 0.018, 0.001)
    interface.step({"observation.state": torch.full((1, 23), 0.3)}, draft)
    assert interface.change is not None
    assert interface.change.draft[0, 0, 0] == pytest.approx(0.010)
    assert interface.change.selected[0, 0, 0] == pytest.approx(0.006)
    assert interface.change.row(0).magnitude() == pytest.approx(0.004 / 0.010001)
    interface.reset()
    assert interface.change is None


def test_a_version_holds_checkpoint_plugin_task_and_settings(policies):
    raw, same = (policies.version("raw", "PlaceHammer-v0", batch_size=1) for _ in range(2))
    assert raw == same
    assert policies.version("press", "PlaceHammer-v0", batch_size=1).weights == raw.weights
    assert policies.version("joint", "PlaceHammer-v0", batch_size=1).weights == raw.weights
    assert policies.version("raw", "PourCup-v0", batch_size=1).code != raw.code
    assert policies.version("press", "PlaceHammer-v0", batch_size=1).code != raw.code
    assert policies.version("raw", "PlaceHammer-v0", batch_size=2).name != raw.name
    assert "device=cpu executes=measured" in raw.settings


@pytest.mark.parametrize(
    "module",
    ["evaluation/policies.py", "commands/stream.py", "interfaces/raw.py", "envs/place_hammer.py", "plugin"],
)
def test_a_byte_in_any_module_that_plays_changes_the_version(policies, monkeypatch, module):
    before = policies.version("raw", "PlaceHammer-v0")
    plugin = "lerobot_policy_dexflex/chunk_execution.py"
    read_bytes, changed = Path.read_bytes, plugin if module == "plugin" else module

    def read(path):
        return read_bytes(path) + b"#" * str(path).endswith(changed)

    monkeypatch.setattr(Path, "read_bytes", read)
    assert policies.version("raw", "PlaceHammer-v0").code != before.code


def test_a_method_can_have_a_checkpoint_of_its_own(policies, make_policy_checkpoint):
    nowhere = Path("/nowhere")
    both = LeRobotPolicies(LEAP, nowhere, own=(("raw", policies.policy), ("press", policies.policy)))
    both.check(["raw", "press"])  # The shared checkpoint is not needed.
    assert both.version("raw", "PourCup-v0") == policies.version("raw", "PourCup-v0")
    np.testing.assert_array_equal(act(both("raw"), [5]), act(policies("raw"), [5]))
    with pytest.raises(DexFlexError, match="No checkpoint at /nowhere"):
        both.check(["raw", "press", "raw@0.5"])
    with pytest.raises(DexFlexError, match="A checkpoint is given for press, but compared are raw"):
        both.check(["raw"])
    motion = make_policy_checkpoint(learns=["measured"])
    replace(policies, own=(("raw", motion),)).check(["joint", "raw"])
    with pytest.raises(DexFlexError, match=r"executes joint targets, but .* measured fingertips only"):
        replace(policies, own=(("joint", motion),)).check(["joint"])


@pytest.mark.parametrize("method", ["dexgen", "dexflex"])
def test_a_controller_moves_the_hand_and_belongs_to_the_version(policies, controller_folder, method):
    with_controller = replace(policies, controller=str(controller_folder))
    with_controller.check(["raw", method])
    version = with_controller.version(method, "PourCup-v0")
    assert version.weights != policies.version(method, "PourCup-v0").weights
    assert with_controller.version("raw", "PourCup-v0") == policies.version("raw", "PourCup-v0")
    raw, ours = act(policies("raw"), [5], steps=2), act(with_controller(method), [5], steps=2)
    np.testing.assert_array_equal(raw[..., :7], ours[..., :7])
    assert np.abs(raw[..., 7:] - ours[..., 7:]).max() > 1e-3


def test_a_comparison_without_its_controller_is_refused(policies, tmp_path):
    with pytest.raises(DexFlexError, match="No controller for"):
        replace(policies, controller=str(tmp_path)).check(["dexflex"])


def test_the_card_of_a_checkpoint_is_not_its_version_but_its_configuration_is(policies, tmp_path):
    shutil.copytree(policies.policy, tmp_path, dirs_exist_ok=True)
    config = json.loads((policies.policy / "config.json").read_text())
    copied = LeRobotPolicies(LEAP, tmp_path)
    (tmp_path / "config.json").write_text(json.dumps(config))
    before = copied.version("raw", "PourCup-v0")
    (tmp_path / "README.md").write_text("A card.")
    assert copied.version("raw", "PourCup-v0") == before
    (tmp_path / "config.json").write_text(json.dumps(config | {"euler_steps": 2}))
    assert copied.version("raw", "PourCup-v0") != before


@pytest.mark.parametrize(
    ("learns", "draft", "method", "message"),
    [
        (["measured"], "", "joint", r"'joint' executes joint targets, but .* Choose --policy.interface=raw"),
        (["joint"], "", "raw", r"'raw' executes measured fingertips, but .* Choose --policy.interface=joint"),
        (["joint", "measured"], "commanded", "press", r"Choose --policy.draft=measured, or .*=\[joint,comm"),
    ],
)
def test_a_part_that_was_not_learned_is_refused_with_the_choices(
    policies, tmp_path, learns, draft, method, message
):
    shutil.copytree(policies.policy, tmp_path, dirs_exist_ok=True)
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps(config | {"learns": learns}))
    players = LeRobotPolicies(LEAP, tmp_path, draft)
    for refused in (
        players.check,
        lambda names: players.version(names[0], "PourCup-v0"),
        lambda n: players(n[0]),
    ):
        with pytest.raises(DexFlexError, match=message):
            refused([method])


def test_commanded_fingertips_are_executed_where_only_they_were_learned(make_policy_checkpoint):
    players = LeRobotPolicies(LEAP, make_policy_checkpoint(learns=["commanded"]))
    assert "executes=commanded" in players.version("raw", "PourCup-v0").settings
    assert act(players("raw"), [5], steps=1).shape == (1, 1, 23)


def test_a_checkpoint_of_the_old_layout_is_refused_with_the_command_that_trains_a_new_one(policies, tmp_path):
    from draccus.utils import ParsingError
    from lerobot.configs import PreTrainedConfig

    shutil.copytree(policies.policy, tmp_path, dirs_exist_ok=True)
    config = json.loads((tmp_path / "config.json").read_text())
    del config["learns"]
    (tmp_path / "config.json").write_text(json.dumps(config | {"action_space": "draft", "draft": "measured"}))
    message = (
        r"one policy learned all parts.*Train again: lerobot-train --config_path=configs/policy/place_ham"
    )
    with pytest.raises(DexFlexError, match=message):
        LeRobotPolicies(LEAP, tmp_path).check(["raw"])
    with pytest.raises(DexFlexError, match=message):
        LeRobotPolicies(LEAP, tmp_path)("raw")
    with pytest.raises(ParsingError, match=message):
        PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--interface=raw"])


def test_a_checkpoint_of_another_policy_is_not_ours(policies, tmp_path):
    shutil.copytree(policies.policy, tmp_path, dirs_exist_ok=True)
    (tmp_path / "config.json").write_text('{"type": "act"}')
    with pytest.raises(DexFlexError, match=r"type 'act', not 'dexflex_flow'. Give it as --backbone="):
        LeRobotPolicies(LEAP, tmp_path).check(["raw"])


def test_a_missing_checkpoint_says_how_to_train_it(tmp_path):
    with pytest.raises(DexFlexError, match=r"No checkpoint at .*lerobot-train --config_path=configs/policy/"):
        LeRobotPolicies(LEAP, tmp_path).check(["joint", "raw"])


@pytest.mark.parametrize("text", ["", "{", "[]"])
def test_a_damaged_configuration_is_refused_by_its_name(policies, tmp_path, text):
    shutil.copytree(policies.policy, tmp_path, dirs_exist_ok=True)
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(DexFlexError, match=r"config\.json is damaged"):
        LeRobotPolicies(LEAP, tmp_path).check(["raw"])


def drafts(controller, steps=18):
    """Return the first steps of the drafts of an episode past a second planning, (steps, 4, 3)."""
    controller.reset([5])
    found = []
    for _ in range(steps):
        controller.act(observation(1), "task")
        found.append(controller.motion.row(0).draft)
    return np.stack(found)


def test_noise_on_plans_is_new_in_every_step_and_does_not_add_up(policies):
    errors = CommandErrors.of(noise=0.004)
    clean, shaken = drafts(policies("raw")), drafts(policies("raw", errors))
    errors_seen = shaken - clean
    assert 0.0035 < np.abs(errors_seen).max() < 0.004 + 1e-6
    assert np.abs(np.diff(errors_seen, axis=0)).max((1, 2)).min() > 1e-3
    actions = act(policies("raw", errors), [5])
    np.testing.assert_array_equal(actions[..., :7], act(policies("raw"), [5])[..., :7])


def test_errors_reach_planned_joints_too_and_spare_the_arm(policies):
    clean, shaken = (act(policies("joint", e), [5]) for e in (NO_ERRORS, CommandErrors.of(noise=0.004)))
    np.testing.assert_array_equal(clean[..., :7], shaken[..., :7])
    assert 0.01 < np.median(np.abs(clean - shaken)[..., 7:].max(-1)) < 0.5
