"""Do what LeRobot's commands do up to their first step, in this process."""

import sys
from types import SimpleNamespace

from lerobot.configs import PreTrainedConfig, parser
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets.factory import make_train_eval_datasets
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.envs import close_envs, make_env, make_env_pre_post_processors
from lerobot.policies import make_policy, make_pre_post_processors
from lerobot.scripts.lerobot_eval import rollout
from lerobot.utils.import_utils import register_third_party_plugins

REPOSITORY = "--dataset.repo_id=lerobot-dexflex/synthetic"


def begin_training(monkeypatch, *arguments):
    """Return configuration, dataset, policy and processors of `lerobot-train <arguments>`."""

    @parser.wrap()
    def train(config: TrainPipelineConfig):
        config.validate()
        policy_config = config.policy
        assert policy_config is not None
        train_set, _ = make_train_eval_datasets(config)
        assert isinstance(train_set, LeRobotDataset)
        policy = make_policy(cfg=policy_config, ds_meta=train_set.meta, rename_map=config.rename_map)
        overrides = {"rename_observations_processor": {"rename_map": config.rename_map}}
        processors = make_pre_post_processors(
            policy_config, _path(policy_config), preprocessor_overrides=overrides
        )
        return SimpleNamespace(config=config, train_set=train_set, policy=policy, processors=processors)

    return _run(monkeypatch, train, REPOSITORY, "--dataset.video_backend=pyav", "--num_workers=0", *arguments)


def begin_evaluation(monkeypatch, *arguments):
    """Run one episode of two steps as `lerobot-eval <arguments>` does; returns its actions."""

    @parser.wrap()
    def evaluate(config: EvalPipelineConfig):
        assert config.policy is not None
        envs = make_env(config.env, n_envs=1)
        policy = make_policy(cfg=config.policy, env_cfg=config.env, rename_map=config.rename_map).eval()
        overrides = {"rename_observations_processor": {"rename_map": config.rename_map}}
        before, after = make_pre_post_processors(
            config.policy, _path(config.policy), preprocessor_overrides=overrides
        )
        env_before, env_after = make_env_pre_post_processors(config.env, config.policy)
        try:
            data = rollout(envs["dexflex"][0], policy, env_before, env_after, before, after, seeds=[1])
            return data["action"]
        finally:
            close_envs(envs)

    return _run(monkeypatch, evaluate, "--env.type=dexflex", "--env.episode_length=2", *arguments)


def _run(monkeypatch, command, *arguments):
    register_third_party_plugins()
    monkeypatch.setattr(sys, "argv", ["lerobot", *map(str, arguments)])
    return command()


def _path(config: PreTrainedConfig) -> str | None:
    return str(config.pretrained_path) if config.pretrained_path else None
