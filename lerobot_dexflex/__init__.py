"""Contact-aware dexterous hand control for LeRobot."""

from lerobot_dexflex._gl import select_backend
from lerobot_dexflex.envs.registration import register_tasks

select_backend()
register_tasks()
