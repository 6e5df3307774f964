import json
import os
import re
import shutil
import signal
from pathlib import Path

import draccus
import pytest

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.training.bank import BankConfig, ProposalBank
from lerobot_dexflex.training.cli import main
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.fit import _Run
from lerobot_dexflex.training.train import STAGES, TrainConfig, Trainer

pytestmark = pytest.mark.usefixtures("no_curves")  # But the trained folder is made before.
CONFIGS = Path(__file__).parents[2] / "configs/controller"
SMALL = [
    "--bank.rows=48",
    "--bank.held_out_rows=24",
    "--bank.n_pure=2",
    "--bank.n_seeded=2",
    "--bank.n_finger=2",
    "--encoder_prior.held_out_rows=16",
    "--world_model.held_out_rows=16",
    "--dexgen.held_out_rows=8",
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
    assert "best of 32 nfe2 mm" in (trained / "controller/README.md").read_text()


def test_a_training_that_is_interrupted_in_every_stage_ends_as_if_it_never_was(
    trained, corpus, tmp_path, monkeypatch
):
    update, updates = _Run._update, []

    def interrupted(run):
        updates.append((run.stage.name, run.step))
        if run.step == 1 and updates.count(updates[-1]) == 1:
            os.kill(os.getpid(), signal.SIGINT)
        return update(run)

    monkeypatch.setattr(_Run, "_update", interrupted)
    command = [f"--corpus={corpus}", f"--output={tmp_path}", *SMALL]
    assert [main(command) for _ in range(len(STAGES) + 1)] == [130] * len(STAGES) + [0]
    assert updates == [(stage, step) for stage in STAGES for step in range(4)]  # Nothing is done twice.
    for name in ("model.safetensors", "dexgen.safetensors", "training.json"):
        assert (tmp_path / "controller" / name).read_bytes() == (trained / "controller" / name).read_bytes()


def test_finished_stages_are_not_trained_again(trained, corpus):
    before = {stage: (trained / stage / "weights.pt").stat().st_mtime_ns for stage in STAGES}
    weights = (trained / "controller/model.safetensors").read_bytes()
    assert main([f"--corpus={corpus}", f"--output={trained}", *SMALL]) == 0
    assert {stage: (trained / stage / "weights.pt").stat().st_mtime_ns for stage in STAGES} == before
    assert (trained / "controller/model.safetensors").read_bytes() == weights


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ("--seed=7", "encoder_prior.*seed: 0 there, 7 now"),
        ("--world_model.fit.lr=0.01", "world_model.*world_model.fit.lr: 0.001 there, 0.01 now"),
        ("--bank.n_pure=3", "score.*bank.n_pure: 2 there, 3 now"),
        ("--network.use_touch=false", "encoder_prior.*network.use_touch: True there, False now"),
    ],
)
def test_a_finished_stage_is_not_passed_off_as_one_of_other_settings(trained, corpus, capsys, change, named):
    record = (trained / "controller/training.json").read_text()
    assert main([f"--corpus={corpus}", f"--output={trained}", *SMALL, change]) == 1
    assert re.search(named, capsys.readouterr().err, re.DOTALL)
    assert (trained / "controller/training.json").read_text() == record


def test_stages_depend_on_those_before_and_the_last_two_on_the_first_alone(trained, corpus):
    trainer = Trainer(TrainConfig(corpus=corpus, output=trained))
    earlier = {stage: list(trainer.before(stage)["after"]) for stage in STAGES}
    assert earlier == {
        "encoder_prior": [],
        "world_model": ["encoder_prior"],
        "score": ["encoder_prior", "world_model"],
        "splitter": ["encoder_prior"],
        "dexgen": ["encoder_prior"],
    }


def test_another_corpus_is_not_passed_off_as_the_one_that_was_trained_on(trained, corpus, tmp_path, capsys):
    other = shutil.copytree(corpus, tmp_path / "other")
    (other / "train/00000.safetensors").unlink()
    assert main([f"--corpus={other}", f"--output={trained}", *SMALL]) == 1
    assert "  corpus: " in capsys.readouterr().err


@pytest.mark.parametrize("size", [0, 0.5], ids=["empty", "half"])
@pytest.mark.parametrize("name", ["weights.pt", "settings.json"])
def test_damaged_files_of_a_stage_are_named(trained, corpus, tmp_path, capsys, name, size):
    shutil.copytree(trained / "encoder_prior", tmp_path / "encoder_prior")
    command = [f"--corpus={corpus}", f"--output={tmp_path}", "--stages=[encoder_prior]", *SMALL]
    path = tmp_path / "encoder_prior" / name
    content = path.read_bytes()
    path.write_bytes(content[: int(size * len(content))])
    assert main(command) == 1
    error = capsys.readouterr().err
    assert "damaged" in error
    assert str(tmp_path / "encoder_prior") in error


def test_a_bank_of_other_settings_is_drawn_again(corpus, trained, tmp_path):
    controller = DexFlexController.from_pretrained(trained / "controller")
    data, path = CorpusData(corpus, "tune"), tmp_path / "bank.safetensors"

    def bank(n_pure, origin="weights"):
        config = BankConfig(n_pure=n_pure, n_seeded=2, n_finger=2)
        return ProposalBank.load_or_draw(path, controller, data, config, 8, seed=0, origin=origin)

    assert bank(2).tensors["chunks"].shape[1] == 7
    before = path.stat().st_mtime_ns
    assert bank(2).tensors["chunks"].shape[1] == 7
    assert path.stat().st_mtime_ns == before
    assert bank(3).tensors["chunks"].shape[1] == 8
    path.write_bytes(path.read_bytes()[:100])
    assert bank(3, "others").tensors["chunks"].shape[1] == 8


def test_later_stages_go_on_from_a_controller(trained, corpus, tmp_path):
    start = f"--init_from={trained / 'controller'}"
    arguments = [f"--corpus={corpus}", f"--output={tmp_path}", start, "--stages=[score]", *SMALL]
    assert main(arguments) == 0
    before, after = (DexFlexController.from_pretrained(p / "controller") for p in (trained, tmp_path))
    changed = {
        name.split(".")[0]
        for name, value in after.state_dict().items()
        if not value.equal(before.state_dict()[name])
    }
    assert changed == {"ranker"}
    assert after.record["world_model"] == before.record["world_model"]


def test_the_corpus_decides_the_hand_and_all_stages_serve_it(corpora, tmp_path):
    assert main([f"--corpus={corpora['sharpa']}", f"--output={tmp_path}", *SMALL]) == 0
    controller = DexFlexController.from_pretrained(tmp_path / "controller")
    assert controller.config.hand == "sharpa"
    assert controller.scale.scale.shape == (8, 5)
    assert DiffusionPrior.load(tmp_path / "controller", controller.config).dynamics[-1].out_features == 22


def test_one_controller_learns_from_the_corpora_of_two_hands(corpora, tmp_path, capsys):
    words = [f"--corpus={corpora['leap']}", f"--beside=[{corpora['sharpa']}]", f"--output={tmp_path}", *SMALL]
    assert main(words) == 1
    assert "DexGen, the baseline, is trained for one hand" in capsys.readouterr().err
    shared = "--stages=[encoder_prior,world_model,score,splitter]"
    assert main([*words, shared]) == 0
    controller = DexFlexController.from_pretrained(tmp_path / "controller")
    assert controller.config.hand == "leap+sharpa"
    assert "fingers index, middle, ring, thumb; index, middle, ring, pinky, thumb; 16 and 22 joints" in (
        (tmp_path / "controller/README.md").read_text()
    )
    # It goes on with the corpus of one of its hands.
    more = [f"--corpus={corpora['sharpa']}", f"--output={tmp_path / 'more'}", "--stages=[encoder_prior]"]
    assert main([*more, f"--init_from={tmp_path / 'controller'}", *SMALL]) == 0


def test_a_layout_for_hands_to_come_is_named(corpora, tmp_path):
    words = [f"--corpus={corpora['leap']}", f"--output={tmp_path}", "--network.hand=leap+sharpa"]
    assert main([*words, "--stages=[encoder_prior]", *SMALL]) == 0
    assert DexFlexController.from_pretrained(tmp_path / "controller").config.hand == "leap+sharpa"


def test_a_controller_is_not_trained_on_with_the_corpus_of_another_hand(trained, corpora, tmp_path, capsys):
    start = f"--init_from={trained / 'controller'}"
    words = [f"--corpus={corpora['sharpa']}", f"--output={tmp_path}", start, "--stages=[score]", *SMALL]
    assert main(words) == 1
    assert re.search(r"was trained for 'leap', but the corpus in .* is of 'sharpa'", capsys.readouterr().err)


def test_a_layout_without_the_hand_of_the_corpus_is_refused(corpora, tmp_path, capsys):
    words = [f"--corpus={corpora['leap']}", f"--output={tmp_path}", "--network.hand=sharpa", *SMALL]
    assert main(words) == 1
    assert re.search(
        r"`network.hand` is 'sharpa', but the corpus in .* is of 'leap'", capsys.readouterr().err
    )


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
    """That of several hands trains what drafts of motion need."""
    config = draccus.parse(TrainConfig, path, args=[])
    assert config.stages == list(STAGES[:3] if "+" in config.network.hand else STAGES)


def test_errors_are_one_line(tmp_path, capsys):
    assert main([f"--corpus={tmp_path}", "--stages=[encoder_prior]"]) == 1
    assert "no shards" in capsys.readouterr().err
    assert main(["--stages=[dreams]"]) == 1
    assert "encoder_prior, world_model" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("stage", "before"),
    [("world_model", "encoder_prior"), ("score", "world_model"), ("dexgen", "encoder_prior")],
)
def test_later_stages_need_something_to_start_from(stage, before):
    with pytest.raises(DexFlexError, match=f"Without `{before}` in `stages`.*init_from"):
        TrainConfig(stages=[stage])
