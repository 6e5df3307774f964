"""LeRobot plugin: policies `dexflex_flow|dexflex_adapter`, env `dexflex`, teleop `dexflex_glove`, steps."""

from lerobot_policy_dexflex.config_dexflex_glove import DexflexGloveConfig as DexflexGloveConfig
from lerobot_policy_dexflex.configuration_dexflex_adapter import DexflexAdapterConfig as DexflexAdapterConfig
from lerobot_policy_dexflex.configuration_dexflex_flow import DexflexFlowConfig as DexflexFlowConfig
from lerobot_policy_dexflex.configuration_env import DexflexEnvConfig as DexflexEnvConfig
from lerobot_policy_dexflex.interface_steps import InterfaceProcessorStep as InterfaceProcessorStep
from lerobot_policy_dexflex.interface_steps import (
    RememberObservationProcessorStep as RememberObservationProcessorStep,
)
from lerobot_policy_dexflex.interface_steps import set_interface as set_interface
