"""Damaged weights are refused before anything is built on them."""

import json
import random
import shutil
import warnings
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.errors import DexFlexError

SHIPPED = Path(__file__).parents[2] / "policies/checkpoints"
WEIGHTS = ("model.safetensors", "dexgen.safetensors")


@pytest.fixture
def folder(controller_folder, tmp_path):
    return shutil.copytree(controller_folder, tmp_path / "controller")


def load(folder, name):
    controller = DexFlexController.from_pretrained(folder)
    return controller if name == WEIGHTS[0] else DiffusionPrior.load(folder, controller.config)


def flip_bytes(path, seed, count=16):
    content, rng = bytearray(path.read_bytes()), random.Random(seed)
    for at in rng.sample(range(len(content)), count):
        content[at] ^= rng.randrange(1, 256)
    path.write_bytes(content)


@pytest.mark.parametrize("name", WEIGHTS)
def test_sixteen_flipped_bytes_are_always_noticed(folder, name):
    whole = (folder / name).read_bytes()
    for seed in range(20):
        flip_bytes(folder / name, seed)
        with pytest.raises(
            DexFlexError, match=rf"{name} is damaged or was exchanged: its checksum is \w{{64}}"
        ):
            load(folder, name)
        (folder / name).write_bytes(whole)
    load(folder, name)


@pytest.mark.parametrize("name", WEIGHTS)
def test_weights_that_are_no_numbers_are_refused_by_name(folder, name):
    tensors = load_file(folder / name)
    first = sorted(tensors)[0]
    tensors[first].view(-1)[0] = torch.nan
    save_file(tensors, folder / name)
    config = json.loads((folder / "config.json").read_text())
    del config["checksums"][name]
    (folder / "config.json").write_text(json.dumps(config))
    with (
        pytest.warns(UserWarning, match=f"holds no checksum of {name}"),
        pytest.raises(DexFlexError, match=rf"{name} holds NaN or infinity in {first}"),
    ):
        load(folder, name)


def test_a_folder_without_checksums_is_loaded_with_a_warning_that_tells_the_remedy(folder):
    config = json.loads((folder / "config.json").read_text())
    checksum = config.pop("checksums")["model.safetensors"]
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.warns(UserWarning, match=rf'add "checksums": {{"model.safetensors": "{checksum}"}}'):
        controller = DexFlexController.from_pretrained(folder)
    controller.save_pretrained(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        DexFlexController.from_pretrained(folder)


@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize("hand", ["leap", "sharpa"])
def test_the_shipped_controllers_are_whole(hand, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(SHIPPED / f"controller_{hand}", name)
