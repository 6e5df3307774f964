"""Record demonstrations of privileged operators as LeRobotDatasets."""

from lerobot_dexflex.recording.config import RecordConfig as RecordConfig
from lerobot_dexflex.recording.recipe import VideoConfig as VideoConfig
