import copy
import warnings

import pytest
import torch
from draccus.utils import ParsingError
from lerobot.configs import PreTrainedConfig
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.policies import make_policy, make_pre_post_processors
from lerobot_commands import begin_evaluation

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_policy_dexflex import DexflexEnvConfig, DexflexFlowConfig
from lerobot_policy_dexflex.compatibility import check_dataset
from lerobot_policy_dexflex.modeling_dexflex_flow import DexflexFlowPolicy


@pytest.fixture
def meta(synthetic_dataset):
    return LeRobotDatasetMetadata("lerobot-dexflex/synthetic", root=synthetic_dataset)


def test_a_dataset_in_our_schema_is_accepted(meta):
    check_dataset(LEAP, meta, {})


def test_another_robot_is_refused(meta):
    meta.info.robot_type = "so101"
    with pytest.raises(DexFlexError, match="robot_type is 'so101', but this policy drives leap_xarm7"):
        check_dataset(LEAP, meta, {})


def test_another_rate_is_refused(meta):
    meta.info.fps = 30
    with pytest.raises(DexFlexError, match="runs at 30 fps, but the hand at 20"):
        check_dataset(LEAP, meta, {})


def test_a_missing_observation_is_refused(meta):
    meta.info.features = {k: v for k, v in meta.features.items() if k != "observation.tactile"}
    with pytest.raises(DexFlexError, match=r"lacks 'observation.tactile' \(taxel normal forces"):
        check_dataset(LEAP, meta, {})


@pytest.mark.parametrize("key", ["action", "observation.state"])
def test_joints_of_another_order_are_refused(meta, key):
    meta.info.features = copy.deepcopy(meta.features)
    meta.features[key]["names"] = meta.features[key]["names"][::-1]
    with pytest.raises(DexFlexError, match=rf"elements of the dataset's '{key}' must be named"):
        check_dataset(LEAP, meta, {})


def test_a_policy_refuses_a_foreign_dataset_when_it_is_built(build, meta):
    meta.info.robot_type = "so101"
    with pytest.raises(DexFlexError, match="so101"):
        build(meta)


def test_an_environment_without_touch_is_refused(tiny):
    env = DexflexEnvConfig()
    del env.features["tactile"]
    with pytest.raises(DexFlexError, match=r"Missing: observation.tactile. Got: observation.fingertips"):
        make_policy(DexflexFlowConfig(**tiny), env_cfg=env)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"interface": "psychic"},
            r"Unknown interface 'psychic' in 'psychic'\. Valid: joint, raw, press",
        ),
        (
            {"learns": ["torque"]},
            r"`learns` must name one or more of joint, commanded, measured.*\['torque'\]",
        ),
        ({"learns": []}, r"as in --policy.learns=\[measured\]. Got \[\]"),
        ({"dropout": 1.0}, r"`dropout` must be in \[0, 1\)"),
        ({"draft": "felt"}, r"`draft` must be measured or commanded, or empty. Got 'felt'"),
        ({"n_action_steps": 25}, r"between 1 and `chunk_size` \(24\)\. Got 25"),
        ({"chunk_size": 25}, r"`chunk_size` must be even. Got 25"),
        ({"dim": 33}, r"multiple of `n_heads`"),
        ({"touch_dropout": 1.5}, r"`touch_dropout` must be in \[0, 1\]"),
        ({"euler_steps": 11}, r"`euler_steps` must be at most 10"),
        ({"noise_draws": 0}, r"`noise_draws` must be at least 1"),
        ({"normalization_mapping": {"STATE": "MEAN_STD"}}, "must be IDENTITY"),
    ],
)
def test_settings_that_cannot_work_are_refused(settings, message):
    with pytest.raises(ParsingError, match=message):
        DexflexFlowConfig(device="cpu", **settings)


@pytest.mark.parametrize("text", ["[measured,joint]", "measured, joint", ["measured", "joint", "joint"]])
def test_what_is_learned_may_be_written_as_a_list_or_as_names(text):
    assert DexflexFlowConfig(device="cpu", learns=text).learns == ["joint", "measured"]


@pytest.fixture
def pour_cup(tiny, tmp_path):
    """Return the folder of a policy that was trained on another task than the environment's default."""
    config = DexflexFlowConfig(**tiny, interface="raw", tasks=[TASKS["PourCup-v0"].description])
    policy = make_policy(config, env_cfg=DexflexEnvConfig(task="PourCup-v0"))
    policy.save_pretrained(tmp_path)
    for processor in make_pre_post_processors(policy.config):
        processor.save_pretrained(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        (
            ["--env.task=Reach-v0"],
            r"state of shape \(23,\), but the environment Reach-v0 offers shape \(16,\). "
            r"It fits --env.task=AssembleTable-v0\|BrushSweep-v0\|FlipToast-v0\|HammerNail-v0\|"
            r"PlaceHammer-v0\|PourCup-v0\|ScrewNut-v0\|Screwdriver-v0\|SpatulaServe-v0 --env.hand=leap with "
            r"--env.options='\{\"cameras\": \[\"front\", \"wrist\"\], \"image_size\": 96\}'",
        ),
        (['--env.options={"cameras": ["front"]}'], r"reads observation.images.wrist, which the environment"),
        (
            ['--env.options={"cameras": []}'],
            r"reads observation.images.front, observation.images.wrist, which",
        ),
        (
            ['--env.options={"image_size": 128}'],
            r"front of shape \(3, 96, 96\), but .* shape \(3, 128, 128\)",
        ),
        (
            ['--rename_map={"observation.images.front": "observation.images.top"}'],
            "reads observation.images.front",
        ),
    ],
)
def test_an_environment_that_does_not_fit_the_checkpoint_is_refused(
    pour_cup, monkeypatch, environment, message
):
    with pytest.raises(DexFlexError, match=message):
        begin_evaluation(monkeypatch, f"--policy.path={pour_cup}", *environment)


@pytest.mark.parametrize("task", [[], ["--env.task=AssembleTable-v0"]])
def test_evaluating_another_task_than_the_trained_one_warns(pour_cup, monkeypatch, task):
    name = task[0].split("=")[1] if task else "PlaceHammer-v0"
    message = rf"trained on 'Pour .*' \(PourCup-v0\), but is .* \({name}\). Valid --env.task: PourCup-v0"
    with pytest.warns(UserWarning, match=message):
        assert begin_evaluation(monkeypatch, f"--policy.path={pour_cup}", *task).shape == (1, 2, 23)


def test_the_trained_task_and_a_checkpoint_that_names_none_do_not_warn(pour_cup, monkeypatch):
    path = f"--policy.path={pour_cup}"
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*was trained on")
        begin_evaluation(monkeypatch, path, "--env.task=PourCup-v0")
        begin_evaluation(monkeypatch, path, "--policy.tasks=[]", "--env.task=PlaceHammer-v0")


def test_a_training_notes_the_tasks_of_its_dataset(build):
    assert build().config.tasks == ["follow"]


def test_a_program_that_brings_another_environment_gets_the_same_errors(build, observation):
    policy = build(interface="raw").eval()
    seen = {key: value for key, value in observation.items() if key != "observation.images.wrist"}
    with pytest.raises(
        DexFlexError, match=r"reads observation.images.wrist.*fits --env.task=AssembleTable-v0"
    ):
        policy.select_action(seen)
    with pytest.raises(
        DexFlexError, match=r"state of shape \(23,\), but the environment offers shape \(16,\)"
    ):
        policy.select_action(observation | {"observation.state": torch.zeros(4, 16)})


def test_a_checkpoint_whose_environment_has_another_action_is_refused(build, tmp_path):
    policy = build(interface="raw")
    policy.save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    config.pretrained_path = tmp_path
    with pytest.raises(
        DexFlexError, match=r"drives 23 joints, but .* \(16,\). It fits --env.task=AssembleTable-v0"
    ):
        make_policy(config, env_cfg=DexflexEnvConfig(task="Reach-v0"))


def test_the_hand_without_an_arm_is_driven_too(tiny):
    config = DexflexFlowConfig(**tiny, interface="raw")
    policy = make_policy(config, env_cfg=DexflexEnvConfig(task="Reach-v0")).eval()
    assert isinstance(policy, DexflexFlowPolicy)
    observation = {key: torch.zeros(2, *ft.shape) for key, ft in (config.input_features or {}).items()}
    assert policy.select_action(observation).shape == (2, 16)
    assert policy.plan.size == 16 + 12 + 12
    assert policy.predict_action_chunk(observation).shape == (2, 24, 12)
