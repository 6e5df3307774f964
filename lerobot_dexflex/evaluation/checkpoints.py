"""Checkpoints of LeRobot policies: refused early if they do not fit, loaded through LeRobot's own API."""

import contextlib
import io
import json
from pathlib import Path
from typing import Any, NamedTuple

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.plan_parts import OLD_LAYOUT, executed_part
from lerobot_dexflex.evaluation.policy_files import check_policy_files, missing_files
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.method import Method

_PLUGIN = "lerobot_policy_dexflex"
_ADAPTER = "dexflex_adapter"


class LoadedPolicy(NamedTuple):
    """A policy with LeRobot's pipelines before and after it."""

    policy: Any
    preprocess: Any
    postprocess: Any


def check_checkpoint(hand: Hand, folder: Path, method: Method, draft: str = "") -> str:
    """Refuse a folder that is no checkpoint for this interface; reads its configuration only.

    Args:
        hand: The hand that it is to move.
        folder: Folder `pretrained_model`.
        method: The interface.
        draft: Which fingertips it executes if it reads drafts; empty leaves it to the checkpoint.

    Returns:
        The part of the checkpoint's plans that the interface executes.

    Raises:
        DexFlexError: Says how to train what is missing.
    """
    remedy = (
        "Give --policy=<run>/checkpoints/last/pretrained_model, or train one: lerobot-train "
        "--config_path=configs/policy/place_hammer.yaml, or that of its task."
    )
    if missing := missing_files(folder):
        raise DexFlexError(f"No checkpoint at {folder}: {', '.join(missing)} not found. {remedy}")
    config = _config(folder)
    if config.get("type") != "dexflex_flow":
        raise DexFlexError(
            f"The checkpoint {folder} is a policy of the type {config.get('type')!r}, not 'dexflex_flow'. "
            f"Give it as --backbone={folder}, or another: {remedy}"
        )
    if (trained := config.get("hand", "leap")) != hand.name:
        raise DexFlexError(
            f"The checkpoint {folder} was trained for the hand {trained!r}, not {hand.name!r}. Give "
            f"--hand={trained}, or another: {remedy}"
        )
    if "learns" not in config:
        raise DexFlexError(f"{folder / 'config.json'}: {OLD_LAYOUT}")
    return executed_part(config["learns"], method, draft or str(config.get("draft", "")))


def check_backbone(folder: Path) -> None:
    """Refuse a folder that is no checkpoint at all.

    Raises:
        DexFlexError: If files are missing.
    """
    if missing := missing_files(folder):
        raise DexFlexError(
            f"No checkpoint at {folder}: {', '.join(missing)} not found. Give "
            "--backbone=<run>/checkpoints/last/pretrained_model of a policy that lerobot-train trained, "
            "e.g. with --policy.type=act."
        )
    check_policy_files(folder)


def policy_modules(folder: Path) -> tuple[str, ...]:
    """Return the plugin's modules that run a checkpoint of ours."""
    return _modules(policy_type(folder))


def policy_type(folder: Path) -> str:
    """Return LeRobot's name for the kind of a checkpoint's policy, such as `act`.

    Raises:
        DexFlexError: If the folder is no checkpoint.
    """
    check_backbone(folder)
    return str(_config(folder).get("type"))


def adapter_modules() -> tuple[str, ...]:
    """Return the plugin's modules that put interfaces under other policies."""
    return _modules(_ADAPTER)


def load_checkpoint(
    hand: Hand, checkpoint: Path, method: Method, device: str, controller: str = "", draft: str = ""
) -> LoadedPolicy:
    """Load a policy of our own.

    Args:
        hand: The hand that it is to move.
        checkpoint: Folder `pretrained_model`.
        method: Overrides the checkpoint's interface.
        device: Torch device.
        controller: Overrides the checkpoint's controller; empty is the shipped one.
        draft: Overrides which fingertips interfaces that read drafts execute; empty leaves it as it is.
    """
    # LeRobot takes seconds to import; only workers pay.
    from draccus.utils import DraccusException
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors
    from lerobot.utils.import_utils import register_third_party_plugins

    check_checkpoint(hand, checkpoint, method, draft)
    register_third_party_plugins()
    overrides = [f"--interface={method.name}", f"--device={device}"]
    if draft:
        overrides.append(f"--draft={draft}")
    if method.learned:
        overrides.append(f"--controller={method.weights(hand, controller)[0].parent}")
    try:
        config = PreTrainedConfig.from_pretrained(checkpoint, cli_overrides=overrides)
    except (ValueError, DraccusException) as error:
        raise DexFlexError(
            f"{checkpoint / 'config.json'} holds settings that this version does not know: {error}"
        ) from error
    config.pretrained_path = checkpoint
    with contextlib.redirect_stdout(io.StringIO()):  # LeRobot announces every load; the bar would break.
        policy: Any = get_policy_class(config.type).from_pretrained(str(checkpoint), config=config)
    processors = make_pre_post_processors(
        config, str(checkpoint), preprocessor_overrides={"device_processor": {"device": device}}
    )
    return LoadedPolicy(policy.eval(), *processors)


def load_adapter(
    hand: Hand, backbone: Path, method: Method, device: str, controller: str = ""
) -> LoadedPolicy:
    """Put an interface under another policy; arguments as for `load_checkpoint`."""
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_policy_config, make_pre_post_processors
    from lerobot.utils.import_utils import register_third_party_plugins

    check_policy_files(backbone)
    register_third_party_plugins()
    config: Any = make_policy_config(
        _ADAPTER,
        hand=hand.name,
        backbone_path=str(backbone),
        interface=method.name,
        controller=controller,
        device=device,
    )
    config.input_features = PreTrainedConfig.from_pretrained(backbone).input_features
    with contextlib.redirect_stdout(io.StringIO()):
        policy = get_policy_class(config.type)(config)
    return LoadedPolicy(policy.eval(), *make_pre_post_processors(config))


def _modules(policy_type: str) -> tuple[str, ...]:
    return tuple(f"{_PLUGIN}.{part}_{policy_type}" for part in ("configuration", "modeling", "processor"))


def _config(folder: Path) -> dict[str, Any]:
    check_policy_files(folder)
    return json.loads((folder / "config.json").read_text())
