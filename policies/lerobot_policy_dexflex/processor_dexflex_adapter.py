"""Pre- and post-processors of `dexflex_adapter`."""

from typing import Any

from lerobot.processor import PolicyProcessorPipeline, make_default_pre_post_processors

from lerobot_policy_dexflex.configuration_dexflex_adapter import DexflexAdapterConfig


def make_dexflex_adapter_pre_post_processors(
    config: DexflexAdapterConfig,
    dataset_stats: dict[str, Any] | None = None,
    dataset_meta: Any = None,
) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
    """Return LeRobot's default pipelines; they rescale nothing, since the backbone brings its own inside."""
    del dataset_meta
    return make_default_pre_post_processors(config, dataset_stats)
