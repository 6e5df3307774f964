import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from safetensors.torch import load_file

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
ENV_EVAL = [
    "--env.type=dexflex",
    "--env.episode_length=10",
    "--eval.n_episodes=2",
    "--eval.batch_size=2",
    "--eval.use_async_envs=false",
]


def run(script, *arguments):
    """Run a console script of LeRobot without network and progress bars."""
    quiet = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1", "SLURM_JOB_ID": "1"}
    command = [str(BIN / script), *map(str, arguments)]
    return subprocess.run(command, env=quiet, capture_output=True, text=True, timeout=300, check=False)


def output_of(result):
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout + result.stderr


@pytest.fixture(scope="module")
def runs(synthetic_dataset, tmp_path_factory):
    """Train 4 steps with an evaluation, resume to 6, evaluate under another interface."""
    folder = tmp_path_factory.mktemp("runs")
    output = folder / "run"
    train = run(
        "lerobot-train",
        f"--config_path={ROOT / 'configs/policy/place_hammer.yaml'}",
        f"--dataset.root={synthetic_dataset}",
        "--dataset.repo_id=lerobot-dexflex/synthetic",
        f"--output_dir={output}",
        "--policy.dim=32",
        "--policy.n_heads=2",
        "--batch_size=4",
        "--steps=4",
        "--save_freq=4",
        "--log_freq=2",
        "--env_eval_freq=4",
        *ENV_EVAL[1:],
    )
    checkpoint = output / "checkpoints/last/pretrained_model"
    output_of(train)
    first = load_file(checkpoint / "model.safetensors")
    resume = run(
        "lerobot-train", f"--config_path={checkpoint / 'train_config.json'}", "--resume=true", "--steps=6"
    )
    pressed = run(
        "lerobot-eval",
        f"--policy.path={checkpoint}",
        "--policy.interface=press:2",
        f"--output_dir={folder / 'eval'}",
        *ENV_EVAL,
    )
    motion = ["--policy.learns=[measured]", "--policy.interface=joint", f"--dataset.root={synthetic_dataset}"]
    refused = run(
        "lerobot-train",
        f"--config_path={ROOT / 'configs/policy/place_hammer.yaml'}",
        "--dataset.repo_id=lerobot-dexflex/synthetic",
        f"--output_dir={folder / 'refused'}",
        *motion,
    )
    return SimpleNamespace(
        train=train,
        first=first,
        resume=resume,
        checkpoint=checkpoint,
        pressed=pressed,
        refused=refused,
        folder=folder,
    )


def test_training_reports_its_loss_and_evaluates_in_the_environment(runs):
    log = output_of(runs.train)
    assert "step:4 " in log
    assert "flow_loss:" in log
    assert "Suite overall aggregated" in log


def test_training_serves_the_dataset_from_memory(runs):
    assert "Decoding observation.images.front" in output_of(runs.train)
    assert "is not cached" not in output_of(runs.train)


def test_the_checkpoint_remembers_what_it_learned(runs):
    config = json.loads((runs.checkpoint / "config.json").read_text())
    assert (config["type"], config["interface"]) == ("dexflex_flow", "dexflex")
    assert config["learns"] == ["joint", "commanded", "measured"]
    assert config["action_space"] == ""


def test_a_resumed_training_goes_on_from_weights_average_and_step(runs):
    assert "step:6 " in output_of(runs.resume)
    last = load_file(runs.checkpoint / "model.safetensors")
    assert runs.first["updates"].item() == 4
    assert last["updates"].item() == 6
    assert not torch.equal(last["average.action_out.weight"], runs.first["average.action_out.weight"])


def test_evaluation_writes_lerobots_report_under_a_switched_interface(runs):
    output_of(runs.pressed)
    report = json.loads((runs.folder / "eval/eval_info.json").read_text())
    assert report["overall"]["n_episodes"] == 2
    assert 0 <= report["overall"]["pc_success"] <= 100


def test_an_interface_whose_part_is_not_learned_ends_in_one_clear_message(runs):
    assert runs.refused.returncode != 0
    last = runs.refused.stderr.strip().splitlines()[-1]
    assert "'joint' executes joint targets, but this policy learned measured fingertips only" in last
    assert "--policy.interface=raw|press" in last


@pytest.mark.parametrize("name", ["assemble_table", "place_hammer", "pour_cup"])
def test_each_config_parses_and_trains_one_step(synthetic_dataset, tmp_path, name, monkeypatch):
    import draccus
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.scripts.lerobot_train import train
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    monkeypatch.setattr(sys, "argv", ["lerobot-train"])
    monkeypatch.setenv("SLURM_JOB_ID", "1")
    path = ROOT / f"configs/policy/{name}.yaml"
    settings = {
        "dataset.root": synthetic_dataset,
        "output_dir": tmp_path / "run",
        "policy.dim": 32,
        "policy.n_heads": 2,
        "batch_size": 2,
        "steps": 1,
    }
    arguments = [f"--{key}={value}" for key, value in settings.items()]
    config = draccus.parse(TrainPipelineConfig, path, args=arguments)
    train(config)
    saved = json.loads((tmp_path / "run/checkpoints/last/pretrained_model/config.json").read_text())
    assert (saved["interface"], saved["learns"]) == ("dexflex", ["joint", "commanded", "measured"])


def test_the_configs_differ_in_nothing_but_the_task():
    import yaml

    found = []
    for task in ("assemble_table", "place_hammer", "pour_cup"):
        text = (ROOT / f"configs/policy/{task}.yaml").read_text()
        environment = "".join(word.capitalize() for word in task.split("_"))
        found.append(yaml.safe_load(text.replace(task, "TASK").replace(environment, "TASK")))
    assert found[0] == found[1] == found[2]
    assert found[0]["dataset"]["root"] == "datasets/TASK"
    assert found[0]["env"]["task"] == "TASK-v0"
