"""LeRobot plugin: `--policy.type=dexflex_flow` or `dexflex_adapter`, and `--env.type=dexflex`."""

from lerobot_policy_dexflex.configuration_dexflex_adapter import DexflexAdapterConfig as DexflexAdapterConfig
from lerobot_policy_dexflex.configuration_dexflex_flow import DexflexFlowConfig as DexflexFlowConfig
from lerobot_policy_dexflex.configuration_env import DexflexEnvConfig as DexflexEnvConfig
