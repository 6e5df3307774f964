"""Refuse datasets that were not recorded with this robot, with one clear message."""

from typing import Any

from lerobot.utils.constants import ACTION

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.model import HAND_JOINTS, JOINTS
from lerobot_dexflex.recording.schema import FPS, columns, robot_type

_REMEDY = "Train on a dataset recorded with `dexflex-record`."


def check_dataset(meta: Any) -> None:
    """Compare robot, rate and column names of a `LeRobotDatasetMetadata` with ours.

    Raises:
        DexFlexError: If they differ; the message names the difference and the remedy.
    """
    robots = {robot_type(joints): joints for joints in (JOINTS, HAND_JOINTS)}
    if meta.robot_type not in robots:
        raise DexFlexError(
            f"The dataset's robot_type is {meta.robot_type!r}, but dexflex_flow drives "
            f"{' or '.join(robots)}. {_REMEDY}"
        )
    if meta.fps != FPS:
        raise DexFlexError(f"The dataset runs at {meta.fps} fps, but the hand at {FPS}. {_REMEDY}")
    for key, column in columns(robots[meta.robot_type]).items():
        if key not in meta.features:
            raise DexFlexError(
                f"The dataset lacks {key!r} ({column.meaning} [{column.unit}]). "
                f"It has: {', '.join(sorted(meta.features))}. {_REMEDY}"
            )
        names = meta.features[key].get("names")
        if key in (ACTION, "observation.state") and list(names or ()) != column.names:
            raise DexFlexError(
                f"The elements of the dataset's {key!r} must be named {column.names}. Got {names}. {_REMEDY}"
            )
        if tuple(meta.features[key]["shape"]) != (len(column.names),):
            raise DexFlexError(
                f"The dataset's {key!r} must have shape ({len(column.names)},). "
                f"Got {tuple(meta.features[key]['shape'])}. {_REMEDY}"
            )
