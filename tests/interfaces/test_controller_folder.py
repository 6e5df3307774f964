import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.controller_folder import find_controller
from lerobot_dexflex.interfaces.registry import INTERFACES

DEXGEN_FILES = INTERFACES["dexgen"].files


@pytest.fixture
def folder(tmp_path):
    for name in DEXGEN_FILES:
        (tmp_path / name).write_text(name)
    return tmp_path


def test_a_folder_is_found_as_text_or_path(folder):
    assert find_controller(LEAP, folder) == find_controller(LEAP, str(folder)) == folder


def test_a_missing_controller_ends_in_one_message_with_the_command_that_trains_it(tmp_path):
    missing = r"No controller for 'leap' at .*nowhere: config.json, model.safetensors not found"
    with pytest.raises(DexFlexError, match=rf"{missing}.*train it: dexflex-train"):
        find_controller(LEAP, tmp_path / "nowhere")


def test_a_controller_without_the_weights_of_dexgen_says_so(folder):
    (folder / "dexgen.safetensors").unlink()
    assert find_controller(LEAP, folder) == folder
    with pytest.raises(DexFlexError, match=r"dexgen.safetensors not found"):
        find_controller(LEAP, folder, DEXGEN_FILES)


def test_a_hub_id_that_cannot_be_had_ends_in_one_message(monkeypatch):
    from huggingface_hub import errors

    def refuse(hub_id, **options):
        raise errors.LocalEntryNotFoundError("offline")

    monkeypatch.setattr("huggingface_hub.snapshot_download", refuse)
    with pytest.raises(DexFlexError, match=r"No controller at 'nobody/nothing': it is neither a folder here"):
        find_controller(LEAP, "nobody/nothing")
