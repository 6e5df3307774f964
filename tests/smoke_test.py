"""Check an installed wheel or sdist away from the checkout; run by `.ci/smoke dist/<package>`, not pytest."""

import importlib
import importlib.metadata
import subprocess
import sys
from pathlib import Path

import gymnasium
from lerobot.configs import PreTrainedConfig
from lerobot.envs import EnvConfig
from lerobot.teleoperators import TeleoperatorConfig
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_dexflex.envs.registration import TASKS

register_third_party_plugins()
assert "dexflex_flow" in PreTrainedConfig.get_known_choices(), "LeRobot did not discover the policy"
assert "dexflex" in EnvConfig.get_known_choices(), "LeRobot did not discover the environment"
assert "dexflex_glove" in TeleoperatorConfig.get_known_choices(), "LeRobot did not discover the teleoperator"
for task in TASKS:
    assert f"lerobot_dexflex/{task}" in gymnasium.registry, f"{task} is not registered"

for name in ("lerobot_dexflex", "lerobot_policy_dexflex"):
    path = Path(importlib.import_module(name).__file__ or "")
    assert path.is_relative_to(sys.prefix), f"{name} comes from {path}, not from the installed package"

files = importlib.metadata.files("lerobot_policy_dexflex") or []
packages = {file.parts[0] for file in files if file.suffix == ".py"}
assert packages == {"lerobot_dexflex", "lerobot_policy_dexflex"}, f"the wheel holds {sorted(packages)}"

env = gymnasium.make("lerobot_dexflex/Reach-v0")
observation, info = env.reset(seed=0)
assert env.observation_space.contains(observation)
assert info["is_success"] is False
env.step(observation["agent_pos"])
env.close()

for command in ("dexflex-hand", "dexflex-record", "dexflex-teleop", "lerobot-train", "lerobot-eval"):
    subprocess.run([Path(sys.prefix, "bin", command), "--help"], check=True, stdout=subprocess.DEVNULL)
print("installed package works")
