"""Record demonstrations of privileged operators as LeRobotDatasets."""

from lerobot_dexflex.recording.config import RecordConfig as RecordConfig
from lerobot_dexflex.recording.config import VideoConfig as VideoConfig
