"""docs/your_hand.md is whole, and its commands lead from a new hand's numbers to a benchmark, in small."""

import re
import shlex
from dataclasses import fields
from pathlib import Path

import pandas as pd
import pytest

from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.corpus.cli import main as corpus
from lerobot_dexflex.corpus.shard import read_header
from lerobot_dexflex.hand_check.check import CHECKS
from lerobot_dexflex.hand_check.cli import main as check
from lerobot_dexflex.hands import Finger, Hand
from lerobot_dexflex.hands.body import Link, Motor
from lerobot_dexflex.training.cli import main as train

PAGE = (Path(__file__).parents[1] / "docs/your_hand.md").read_text()
NAME = "my_hand:CLAW"
STAGES = ("encoder_prior", "world_model", "score", "splitter")
SMALL = {
    "dexflex-hand": "",
    "dexflex-corpus": "--jobs.train=1 --jobs.tune=1 --jobs.test=0 --objects_per_job=1 --steps_per_object=100 "
    "--workers=0",
    "dexflex-train": f"--stages=[{','.join(STAGES)}] --bank.rows=16 --bank.held_out_rows=8 --bank.n_pure=2 "
    "--bank.n_seeded=2 --encoder_prior.held_out_rows=8 --world_model.held_out_rows=8"
    + "".join(f" --{stage}.fit.steps=2 --{stage}.fit.batch_size=8" for stage in STAGES),
    "degraded_commands.py": "--methods=raw,dexflex --conditions=clean --episodes=1 --workers=0 --batch=1 "
    "--group=1 --films=false --chains=outputs/chains",
}


def test_the_table_names_every_field():
    table = PAGE[PAGE.index("| field |") :].partition("\n\n")[0]
    named = {name for row in table.splitlines() for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    existing = {*Link._fields, *Motor._fields} | {f.name for kind in (Finger, Hand) for f in fields(kind)}
    assert existing - {"links", "motors"} <= named
    assert named <= existing | {"Link", "Motor", "Finger", "Hand"}


def test_the_page_says_how_many_checks_there_are():
    assert {13: "thirteen", 14: "fourteen", 15: "fifteen"}[len(CHECKS)] + " checks" in PAGE


@pytest.fixture
def hand_of_the_page(tmp_path, monkeypatch):
    (tmp_path / "my_hand.py").write_text("".join(re.findall(r"^```python\n(.*?)^```", PAGE, re.S | re.M)))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("hand_of_the_page")
def test_the_page_leads_from_numbers_to_a_benchmark(load_script, capsys):
    benchmark = load_script("degraded_commands").main
    run = {
        "dexflex-hand": check,
        "dexflex-corpus": corpus,
        "dexflex-train": train,
        "degraded_commands.py": benchmark,
    }
    lines = "\n".join(re.findall(r"^```sh\n(.*?)^```", PAGE, re.S | re.M)).replace("\\\n", " ").splitlines()
    words = [shlex.split(line.removeprefix("python eval/"), comments=True) for line in lines]
    shown = [command for command in words if command and command[0] in run]
    assert [name for name, *_ in shown] == list(run)
    for name, *arguments in shown:
        assert run[name]([*arguments, *shlex.split(SMALL[name])]) == 0, capsys.readouterr().err

    (shard,) = Path("outputs/corpus/claw/train").iterdir()
    assert read_header(shard)["hand"] == NAME
    controller = DexFlexController.from_pretrained("outputs/claw/controller")
    layout = controller.config.layout
    assert (controller.config.hand, layout.n_joints, layout.taxels) == (NAME, 9, (8, 6))
    rows = pd.read_csv("outputs/claw_benchmark/reach.csv")
    assert set(rows["method"]) == {"raw", "dexflex"}
    assert rows["progress"].between(0, 1).all()

    others = ["--methods=dexflex", "--hand=sharpa", "--controller=outputs/claw/controller", "--episodes=1"]
    assert benchmark([*others, "--workers=0", "--output=outputs/others"]) == 1
    assert f"was trained for '{NAME}', but" in capsys.readouterr().err
