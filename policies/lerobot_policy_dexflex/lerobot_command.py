"""What the running LeRobot command was told but does not pass on to its policy.

`lerobot-train` knows whether it resumes, which features it renames and where it evaluates. LeRobot reads
its command line again wherever its configuration does not say enough (`lerobot.configs.parser`), and so does
this. Outside of a command all is untold: a policy that a program builds starts fresh and renames nothing.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from lerobot.configs import parser
from lerobot.configs.train import TRAIN_CONFIG_NAME

from lerobot_policy_dexflex.configuration_env import DexflexEnvConfig


def told(option: str) -> Any:
    """Return the value of a dotted option: of the command line, else of its --config_path, else None."""
    said = parser.parse_arg(option)
    if said is not None:
        return yaml.safe_load(said)
    value: Any = _configuration_file()
    for part in option.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def resuming() -> bool:
    """Tell whether this is `lerobot-train --resume=true`, which goes on where its checkpoint ended."""
    return told("resume") is True


def renamed[Value](features: Mapping[str, Value]) -> dict[str, Value]:
    """Return what belongs to features under the names that --rename_map gives them."""
    names = told("rename_map") or {}
    return {names.get(key, key): value for key, value in features.items()}


def told_environment() -> DexflexEnvConfig | None:
    """Return task and options of `--env.type=dexflex`, or None if this command runs no such environment."""
    if told("env.type") != "dexflex" or told("env_eval_freq") == 0:
        return None
    settings = {name: told(f"env.{name}") for name in ("task", "options")}
    return DexflexEnvConfig(**{name: value for name, value in settings.items() if value is not None})


def worker_processes() -> int:
    """Return how many processes load a training's data; 0 outside of `lerobot-train`."""
    if told("dataset.repo_id") is None:
        return 0
    workers = told("num_workers")
    return 4 if workers is None else workers  # LeRobot's default.


def _configuration_file() -> Any:
    path = Path(parser.parse_arg("config_path") or "")
    file = path / TRAIN_CONFIG_NAME if path.is_dir() else path
    return yaml.safe_load(file.read_text()) if file.is_file() else {}
