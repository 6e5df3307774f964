"""README's commands run, its Python runs, and its tables are the committed results."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from lerobot_dexflex.training.train import STAGES

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
BIN = Path(sys.executable).parent

SHORTER = {
    "lerobot-train": "--steps=2 --batch_size=2 --log_freq=1 --save_freq=2 --env_eval_freq=2 "
    "--eval.n_episodes=1 --eval.batch_size=1 --policy.cache_dataset=false",
    "lerobot-eval": "--eval.n_episodes=1 --eval.batch_size=1 --env.episode_length=5",
    "lerobot-dataset-viz": "--save=1 --output-dir=outputs/viz --num-workers=0",
    "dexflex-record": "--episodes=1 --workers=0",
    "compare_interfaces.py": "--interfaces raw --episodes 1 --videos 1 --workers 0",
    "replay_dataset.py": "--workers 0",
    "dexflex-corpus": "--jobs.train=1 --jobs.tune=1 --jobs.test=0 --objects_per_job=1 --steps_per_object=120 "
    "--replays.per_shard=16 --workers=0",
    "dexflex-train": "--bank.rows=16 --bank.held_out_rows=8 --bank.n_pure=2 --bank.n_seeded=2 "
    + " ".join(f"--{stage}.held_out_rows=8" for stage in ("encoder_prior", "world_model", "dexgen"))
    + "".join(f" --{stage}.fit.steps=2 --{stage}.fit.batch_size=8" for stage in STAGES),
    "degraded_commands.py": "--methods raw --cells clean_unverified --episodes 1 --workers 0 --no-films",
    "make": "--dry-run",
}
"""What the test adds to a command, so that it stays the reader's command but takes seconds."""
RESUMED = "--steps=3"
SET_UP = ("git", "cd", "source")
"""Commands that only prepare a reader's shell; the test stands in a prepared one."""


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README.read_text(), re.DOTALL | re.MULTILINE)


def commands():
    lines = "\n".join(blocks("bash")).replace("\\\n", " ").splitlines()
    words = [shlex.split(line, comments=True) for line in lines]
    return [command for command in words if command and command[0] not in SET_UP]


def shortened(command):
    # Not `python`, nor `env` and the variables that it sets.
    script = next(Path(word).name for word in command if word not in ("env", "python") and "=" not in word)
    extra = RESUMED if "--resume=true" in command else SHORTER.get(script, "")
    if script == "lerobot-train" and "--resume=true" not in command:
        extra += " --env.episode_length=5"
    return [*command, *shlex.split(extra)]


@pytest.fixture
def checkout(tmp_path):
    """A folder that looks like the checkout but has its own `outputs`."""
    for name in (".ci", ".python-version", "Makefile", "pyproject.toml", "uv.lock"):
        (tmp_path / name).symlink_to(ROOT / name)
    for name in ("configs", "datasets", "eval", "policies"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def test_readme_commands_run_in_their_order(checkout):
    path = f"{BIN}{os.pathsep}{os.environ['PATH']}"
    quiet = os.environ | {"PATH": path, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1", "SLURM_JOB_ID": "1"}
    for command in commands():
        run = subprocess.run(
            shortened(command), cwd=checkout, env=quiet, capture_output=True, text=True, timeout=300
        )
        assert run.returncode == 0, f"{shlex.join(command)}\n{run.stdout[-2000:]}\n{run.stderr[-4000:]}"


def test_readme_python_runs():
    code = "\n".join(blocks("python"))
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    assert "True" in run.stdout.splitlines(), "the expert of the example did not solve its episode"


def test_readme_shows_the_two_commands_that_do_everything():
    shown = [shlex.join(command) for command in commands()]
    assert {"make demo", "make test"} <= set(shown)
    assert "exec make test" in (ROOT / ".ci/run").read_text()


def test_readme_links_and_pictures_exist():
    targets = re.findall(r"\]\((?!https?://|#)([^)#]+)", README.read_text())
    assert [target for target in targets if not (ROOT / target).exists()] == []


@pytest.fixture
def readme_table(load_script):
    return load_script("readme_table")


def test_tables_of_readme_and_cards_are_made_from_the_committed_results(readme_table):
    documents = readme_table.documents()
    assert documents[0] == README
    assert all(
        readme_table.names(document.read_text())
        for document in documents
        if "controller" not in str(document)
    )
    for document in documents:
        text = document.read_text()
        made = readme_table.filled(text, ROOT / "eval/results", readme_table.up(document))
        assert made == text, f"{document}: run `python eval/readme_table.py`"


def test_a_result_table_holds_rates_intervals_and_tests(readme_table, tmp_path):
    rate = {"n_success": 8, "n_episodes": 10, "pc_success": 80.0, "pc_success_ci95": [49.02, 94.33]}
    failed = {"n_success": 0, "n_episodes": 10, "pc_success": 0.0, "pc_success_ci95": [0.0, 27.75]}
    result = {
        "n_episodes": 10,
        "seeds": [5, 14],
        "per_interface": {
            "raw": rate | {"completion_time": {"mean": 9.96}},
            "joint": failed | {"completion_time": None},
        },
        "pairwise": [{"first": "raw", "second": "joint", "p_value_holm": 0.0078125}],
    }
    (tmp_path / "x.json").write_text(json.dumps(result))
    text = readme_table.filled("above\n<!-- results:x -->\nold\n<!-- /results -->\nbelow", tmp_path)
    assert "| `raw` | 80 % (8/10) | 49 to 94 % | 10.0 s |" in text
    assert "| `joint` | 0 % (0/10) | 0 to 28 % | - |" in text
    assert "raw against joint p = 0.0078" in text
    assert "old" not in text
    assert (text.startswith("above\n<!-- results:x -->\n"), text.endswith("<!-- /results -->\nbelow")) == (
        True,
        True,
    )
