import json
import shutil
from pathlib import Path

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.policies import AdaptedPolicies, LeRobotPolicies, load_checkpoint
from lerobot_dexflex.evaluation.policy_files import POLICY_FILES, check_policy_files
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import Method

SHIPPED = Path(__file__).parents[2] / "policies/checkpoints"
STATE = "policy_preprocessor_step_3_normalizer_processor.safetensors"


@pytest.fixture
def folder(policy_checkpoint, tmp_path):
    return Path(shutil.copytree(policy_checkpoint, tmp_path / "checkpoint"))


def test_every_shipped_policy_is_whole():
    for file in SHIPPED.glob("*/policy_preprocessor.json"):
        check_policy_files(file.parent)
        LeRobotPolicies(LEAP, file.parent).check(["joint", "raw"])


@pytest.mark.parametrize("name", [*POLICY_FILES, STATE])
@pytest.mark.parametrize("damage", ["half", "empty", "gone"])
def test_a_checkpoint_with_a_damaged_file_is_refused_by_the_files_name(folder, name, damage):
    file = folder / name
    whole = file.read_bytes()
    if damage == "gone":
        file.unlink()
    else:
        file.write_bytes(whole[: len(whole) // 2] if damage == "half" else b"")
    with pytest.raises(DexFlexError, match=name.replace(".", r"\.")):
        check_policy_files(folder)
    with pytest.raises(DexFlexError, match=name.replace(".", r"\.")):
        LeRobotPolicies(LEAP, folder).check(["raw"])
    with pytest.raises(DexFlexError, match=name.replace(".", r"\.")):
        AdaptedPolicies(LEAP, folder).check(["raw"])
    with pytest.raises(DexFlexError, match=name.replace(".", r"\.")):
        load_checkpoint(LEAP, folder, Method.parse("raw"), "cpu")


@pytest.mark.parametrize("text", ["[]", "null", '"raw"'])
def test_settings_that_are_no_table_are_refused(folder, text):
    (folder / "config.json").write_text(text)
    with pytest.raises(DexFlexError, match=r"config\.json is damaged: it holds no settings"):
        check_policy_files(folder)


@pytest.mark.parametrize("steps", [None, 3, ["normalizer"], [{"registry_name": "x", "state_file": 5}]])
def test_a_processor_without_a_list_of_steps_is_refused(folder, steps):
    (folder / "policy_preprocessor.json").write_text(json.dumps({"name": "x", "steps": steps}))
    with pytest.raises(DexFlexError, match=r"policy_preprocessor\.json is damaged: its steps are no list"):
        check_policy_files(folder)


def test_a_setting_of_another_version_is_refused_by_its_name(folder):
    settings = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(settings | {"speed": 3}))
    with pytest.raises(DexFlexError, match=r"config\.json .*speed"):
        load_checkpoint(LEAP, folder, Method.parse("raw"), "cpu")
