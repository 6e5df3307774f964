"""Pre- and post-processors of `dexflex_flow`."""

from typing import Any

from lerobot.processor import PolicyProcessorPipeline, make_default_pre_post_processors

from lerobot_policy_dexflex.configuration_dexflex_flow import DexflexFlowConfig


def make_dexflex_flow_pre_post_processors(
    config: DexflexFlowConfig,
    dataset_stats: dict[str, Any] | None = None,
    dataset_meta: Any = None,
) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
    """Return LeRobot's default pipelines; they rescale nothing, since the policy normalises inside.

    LeRobot resolves this function by its name and overrides the default steps on resume and evaluation.
    """
    del dataset_meta
    return make_default_pre_post_processors(config, dataset_stats)
