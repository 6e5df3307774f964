import json
from pathlib import Path

import draccus
import pytest

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.training.cli import main
from lerobot_dexflex.training.train import STAGES, TrainConfig

CONFIGS = Path(__file__).parents[2] / "configs/controller"
SMALL = [
    "--bank.rows=48",
    "--bank.held_out_rows=24",
    "--bank.n_pure=2",
    "--bank.n_seeded=2",
    "--encoder_prior.held_out_rows=16",
    "--world_model.held_out_rows=16",
    *[f"--{stage}.fit.steps=4" for stage in STAGES],
    *[f"--{stage}.fit.batch_size=16" for stage in STAGES],
]


@pytest.fixture(scope="module")
def trained(corpus, tmp_path_factory):
    output = tmp_path_factory.mktemp("training")
    assert main([f"--corpus={corpus}", f"--output={output}", *SMALL]) == 0
    return output


def test_all_stages_make_a_controller_with_card_and_curves(trained):
    controller = DexFlexController.from_pretrained(trained / "controller")
    assert set(STAGES) < set(controller.record)
    assert all((trained / stage / "metrics.png").is_file() for stage in STAGES)
    assert "best of 8 nfe4 mm" in (trained / "controller/README.md").read_text()


def test_finished_stages_are_not_trained_again(trained, corpus):
    before = {stage: (trained / stage / "weights.pt").stat().st_mtime_ns for stage in STAGES}
    weights = (trained / "controller/model.safetensors").read_bytes()
    assert main([f"--corpus={corpus}", f"--output={trained}", *SMALL]) == 0
    assert {stage: (trained / stage / "weights.pt").stat().st_mtime_ns for stage in STAGES} == before
    assert (trained / "controller/model.safetensors").read_bytes() == weights


def test_later_stages_go_on_from_a_controller(trained, corpus, tmp_path):
    start = f"--init_from={trained / 'controller'}"
    arguments = [f"--corpus={corpus}", f"--output={tmp_path}", start, "--stages=[score, decoder]", *SMALL]
    assert main(arguments) == 0
    before, after = (DexFlexController.from_pretrained(p / "controller") for p in (trained, tmp_path))
    changed = {
        name.split(".")[0]
        for name, value in after.state_dict().items()
        if not value.equal(before.state_dict()[name])
    }
    assert changed == {"ranker", "decoder"}
    assert after.record["world_model"] == before.record["world_model"]


def test_controllers_without_touch_are_trained_by_a_flag(corpus, tmp_path):
    output = tmp_path / "blind"
    flags = ["--network.use_touch=false", "--network.use_slow=false", "--stages=[encoder_prior]"]
    assert main([f"--corpus={corpus}", f"--output={output}", *flags, *SMALL]) == 0
    assert not json.loads((output / "controller/config.json").read_text())["use_touch"]


def test_config_files_are_read_by_either_name(corpus, tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text("seed: 3\nencoder_prior:\n  fit:\n    steps: 2\n    batch_size: 8\n  held_out_rows: 8\n")
    for number, option in enumerate((["--config", str(path)], [f"--config_path={path}"])):
        output = tmp_path / str(number)
        assert main([*option, f"--corpus={corpus}", f"--output={output}", "--stages=[encoder_prior]"]) == 0
        assert json.loads((output / "controller/training.json").read_text())["seed"] == 3


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_configs_are_valid(path):
    assert draccus.parse(TrainConfig, path, args=[]).stages == list(STAGES)


def test_errors_are_one_line(tmp_path, capsys):
    assert main([f"--corpus={tmp_path}", "--stages=[encoder_prior]"]) == 1
    assert "no shards" in capsys.readouterr().err
    assert main(["--stages=[dreams]"]) == 1
    assert "encoder_prior, world_model" in capsys.readouterr().err


def test_later_stages_need_something_to_start_from():
    with pytest.raises(DexFlexError, match="init_from"):
        TrainConfig(stages=["score"])
