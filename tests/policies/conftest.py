import sys
from pathlib import Path
from typing import Any, cast

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parent))  # lerobot_commands


@pytest.fixture(scope="session")
def tiny():
    """Settings that make the network small and the test quick."""
    return {"dim": 64, "n_layers": 2, "n_heads": 2, "n_keypoints": 8, "device": "cpu", "push_to_hub": False}


@pytest.fixture
def build(synthetic_dataset, tiny):
    """Return a function that makes a fresh policy for the synthetic dataset."""
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
    from lerobot.policies import make_policy

    from lerobot_policy_dexflex import DexflexFlowConfig

    def build_policy(meta=None, **settings):
        torch.manual_seed(0)
        config = DexflexFlowConfig(**{**tiny, "cache_dataset": False, **settings})
        meta = meta or LeRobotDatasetMetadata("lerobot-dexflex/synthetic", root=synthetic_dataset)
        return make_policy(config, ds_meta=meta)

    return build_policy


@pytest.fixture(scope="session")
def samples(synthetic_dataset):
    """Return a batch of 16 samples as a training sees them, spread over the episodes."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from lerobot_policy_dexflex.measured_tips import add_measured_tips

    windows = {"action": [k / 20 for k in range(24)]}
    dataset = LeRobotDataset(
        "lerobot-dexflex/synthetic", root=synthetic_dataset, delta_timestamps=windows, video_backend="pyav"
    )
    add_measured_tips(dataset.meta)
    rows = range(0, len(dataset), len(dataset) // 16)
    return torch.utils.data.default_collate([dataset[row] for row in list(rows)[:16]])


@pytest.fixture(scope="session")
def observation(samples):
    """Return the observations of four samples of three episodes, without actions."""
    rows = [0, 4, 8, 14]
    keys = [key for key in samples if key.startswith("observation.") and "next" not in key]
    return {key: samples[key][rows] for key in keys}


@pytest.fixture(scope="session")
def backbone(synthetic_dataset, tmp_path_factory):
    """Save an untrained ACT with its processors, as lerobot-train does."""
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
    from lerobot.policies import make_policy
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.factory import make_pre_post_processors

    torch.manual_seed(0)
    meta = LeRobotDatasetMetadata("lerobot-dexflex/synthetic", root=synthetic_dataset)
    config = ACTConfig(
        dim_model=32,
        n_heads=2,
        dim_feedforward=32,
        n_encoder_layers=1,
        n_vae_encoder_layers=1,
        pretrained_backbone_weights=None,
        chunk_size=12,
        n_action_steps=12,
        device="cpu",
        push_to_hub=False,
    )
    policy = make_policy(config, ds_meta=meta)
    folder = tmp_path_factory.mktemp("act")
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(config, dataset_stats=cast(Any, meta.stats)):
        processor.save_pretrained(folder)
    return folder


@pytest.fixture
def adapter(backbone):
    """Return a function that puts an interface under it, as lerobot-eval does."""
    from lerobot.policies import make_policy

    from lerobot_policy_dexflex import DexflexAdapterConfig, DexflexEnvConfig

    def build(**settings):
        config = DexflexAdapterConfig(
            **{"backbone_path": str(backbone), "device": "cpu", "push_to_hub": False, **settings}
        )
        return make_policy(config, env_cfg=DexflexEnvConfig(task="PlaceHammer-v0"))

    return build
