"""Refuse datasets and environments that do not fit a policy, before its first step and in one message."""

import json
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from lerobot.configs import PolicyFeature
from lerobot.envs.utils import env_to_policy_features
from lerobot.utils.constants import ACTION, DEFAULT_FEATURES, OBS_IMAGES, OBS_STATE, OBS_STR
from lerobot.utils.feature_utils import dataset_to_policy_features
from torch import Tensor

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import HANDS, Hand
from lerobot_dexflex.recording.schema import FPS, columns, robot_type
from lerobot_policy_dexflex.configuration_env import CAMERAS
from lerobot_policy_dexflex.lerobot_command import renamed, told_environment
from lerobot_policy_dexflex.normalization import tip_numbers

Shapes = Mapping[str, tuple[int, ...]]
"""Shape of one sample of each feature, images as (channels, height, width)."""

_REMEDY = "Train on a dataset recorded with `dexflex-record`."


def shapes(features: Mapping[str, PolicyFeature] | None) -> dict[str, tuple[int, ...]]:
    """Return the shapes of LeRobot's features."""
    return {key: tuple(feature.shape) for key, feature in (features or {}).items()}


def check_dataset(hand: Hand, meta: Any, inputs: Shapes) -> None:
    """Compare a `LeRobotDatasetMetadata` with our robot and with what the policy reads.

    Args:
        hand: The policy's.
        meta: Metadata of the training dataset; its features count under the names of --rename_map.
        inputs: What the policy reads.

    Raises:
        DexFlexError: If they differ; the message names the difference and the remedy.
    """
    robots = _robots(hand)
    if meta.robot_type not in robots:
        others = [name for name, other in HANDS.items() if meta.robot_type in _robots(other)]
        raise DexFlexError(
            f"The dataset's robot_type is {meta.robot_type!r}, but this policy drives "
            f"{' or '.join(robots)}. "
            + (f"Give --policy.hand={others[0]}, for a new policy." if others else _REMEDY)
        )
    if meta.fps != FPS:
        raise DexFlexError(f"The dataset runs at {meta.fps} fps, but the hand at {FPS}. {_REMEDY}")
    features = renamed(meta.features)
    for key, column in columns(hand, robots[meta.robot_type]).items():
        _check_column(features, key, column.names, f"{column.meaning} [{column.unit}]")
    offered = shapes(dataset_to_policy_features(features))
    _compare(inputs, offered, "the dataset", _dataset_remedy(inputs, offered))


def _robots(hand: Hand) -> dict[str, tuple[str, ...]]:
    """Return the joints of the robots with a hand by their names."""
    return {robot_type(hand, joints): joints for joints in (robot_joints(hand), hand.joint_names)}


def unread(features: Mapping[str, Any], inputs: Shapes) -> list[str]:
    """Return what a training does not read of a dataset's features, by their names in the dataset.

    Args:
        features: Of the dataset.
        inputs: What the policy reads, by the names of --rename_map.
    """
    read = {*inputs, ACTION, *DEFAULT_FEATURES}
    return [old for new, old in renamed({key: key for key in features}).items() if new not in read]


def _check_column(features: Mapping[str, Any], key: str, names: list[str], meaning: str) -> None:
    if key not in features:
        raise DexFlexError(
            f"The dataset lacks {key!r} ({meaning}). It has: {', '.join(sorted(features))}. {_REMEDY}"
        )
    found, shape = features[key].get("names"), tuple(features[key]["shape"])
    if key in (ACTION, OBS_STATE) and list(found or ()) != names:
        raise DexFlexError(
            f"The elements of the dataset's {key!r} must be named {names}. Got {found}. {_REMEDY}"
        )
    if shape != (len(names),):
        raise DexFlexError(f"The dataset's {key!r} must have shape ({len(names)},). Got {shape}. {_REMEDY}")


def check_told_environment(hand: Hand, inputs: Shapes) -> None:
    """Compare what the policy reads with the environment that the running LeRobot command names, if any.

    Raises:
        DexFlexError: If the environment has another hand, or does not offer it.
    """
    if environment := told_environment():
        if getattr(environment, "hand", hand.name) != hand.name:
            raise DexFlexError(
                f"The policy moves the hand {hand.name!r}, but the environment has {environment.hand!r}. "
                f"Give --env.hand={hand.name}, or another policy."
            )
        offered = renamed(shapes(env_to_policy_features(environment)))
        _compare(inputs, offered, f"the environment {environment.task}", _environment_remedy(hand, inputs))


def check_observation(hand: Hand, inputs: Shapes, batch: Mapping[str, Any]) -> None:
    """Compare what the policy reads with an observation.

    Raises:
        DexFlexError: If something is missing or has another shape.
    """
    tensors = {key: value for key, value in batch.items() if isinstance(value, Tensor)}
    check_offer(hand, inputs, {k: tuple(v.shape[1:]) for k, v in tensors.items() if k.startswith(OBS_STR)})


def check_offer(hand: Hand, inputs: Shapes, offered: Shapes) -> None:
    """Compare what the policy reads with what an environment offers.

    Raises:
        DexFlexError: If something is missing or has another shape.
    """
    _compare(inputs, offered, "the environment", _environment_remedy(hand, inputs))


def check_action(hand: Hand, n_joints: int, output_features: Mapping[str, PolicyFeature] | None) -> None:
    """Refuse an environment that drives another number of joints than the policy.

    Args:
        hand: The policy's.
        n_joints: Joints that the policy drives.
        output_features: LeRobot's: of the dataset in training, of the environment in evaluation.

    Raises:
        DexFlexError: If the action has another size.
    """
    feature = (output_features or {}).get(ACTION)
    if feature is not None and tuple(feature.shape) not in ((n_joints,), (n_joints + tip_numbers(hand),)):
        raise DexFlexError(
            f"The policy drives {n_joints} joints, but the action of this environment has shape "
            f"{tuple(feature.shape)}. It fits {_environments_of(hand, n_joints)}."
        )


def warn_of_another_task(trained: Sequence[str], asked: Sequence[str] | str | None) -> None:
    """Warn if a policy is asked for another task than it was trained on.

    Args:
        trained: Instructions in the training dataset; empty if the checkpoint does not tell.
        asked: Instruction or instructions of the environment.
    """
    wanted = {asked} if isinstance(asked, str) else set(asked or ())
    if trained and (strange := sorted(wanted - {"", *trained})):
        names = {task.description: name for name, task in TASKS.items()}
        remedy = [names[text] for text in trained if text in names]
        warnings.warn(
            f"This policy was trained on {_quoted(trained, names)}, but is asked to do "
            f"{_quoted(strange, names)}." + (f" Valid --env.task: {', '.join(remedy)}." if remedy else ""),
            stacklevel=2,
        )


def _quoted(texts: Sequence[str], names: Mapping[str, str]) -> str:
    return ", ".join(f"{text!r} ({names[text]})" if text in names else repr(text) for text in texts)


def _compare(inputs: Shapes, offered: Shapes, source: str, remedy: str) -> None:
    if missing := [key for key in inputs if key not in offered]:
        raise DexFlexError(
            f"The policy reads {', '.join(missing)}, which {source} does not offer. "
            f"It offers: {', '.join(sorted(set(offered) - {ACTION}))}. {remedy}"
        )
    for key, shape in inputs.items():
        if offered[key] != shape:
            raise DexFlexError(
                f"The policy reads {key} of shape {shape}, but {source} offers shape {offered[key]}. {remedy}"
            )


def _dataset_remedy(inputs: Shapes, offered: Shapes) -> str:
    spare = [key for key in offered if key.startswith(OBS_IMAGES) and key not in inputs]
    missing = [key for key in inputs if key.startswith(OBS_IMAGES) and key not in offered]
    anew = "train a new policy on this dataset with --policy.type=dexflex_flow instead of --policy.path"
    if missing and len(spare) >= len(missing):
        names = json.dumps(dict(zip(spare, missing, strict=False)))
        return f"Say which camera is which, e.g. --rename_map='{names}', or {anew}."
    return f"{anew[0].upper()}{anew[1:]}."


def _environment_remedy(hand: Hand, inputs: Shapes) -> str:
    """Say which environments of ours fit the policy."""
    images = {
        key.removeprefix(f"{OBS_IMAGES}."): s for key, s in inputs.items() if key.startswith(OBS_IMAGES)
    }
    remedy = f"It fits {_environments_of(hand, *inputs.get(OBS_STATE, (0,)))}"
    if strangers := sorted(set(images) - set(CAMERAS)):
        names = {
            f"{OBS_IMAGES}.{ours}": f"{OBS_IMAGES}.{key}" for ours, key in zip(CAMERAS, images, strict=False)
        }
        return (
            f"Its cameras {', '.join(strangers)} are none of ours ({', '.join(CAMERAS)}): say which is "
            f"which, e.g. --rename_map='{json.dumps(names)}'. {remedy}."
        )
    sizes = {size for shape in images.values() for size in shape[1:]}
    if len(sizes) == 1:
        options = {"cameras": list(images), "image_size": sizes.pop()}
        return f"{remedy} with --env.options='{json.dumps(options)}'."
    return f"{remedy}."


def _environments_of(hand: Hand, n_joints: int) -> str:
    tasks = "|".join(name for name, task in TASKS.items() if len(task.joints(hand)) == n_joints)
    return f"--env.task={tasks} --env.hand={hand.name}"
