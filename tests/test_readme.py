"""What the documents say is so: commands run or parse, Python runs, links lead somewhere, tables are results.

Commands in `bash` blocks run, in their order, each document in its own checkout. Those in `sh` blocks, which
need hours, the network or what is not there, are only read by their own parsers.
"""

import argparse
import importlib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import draccus
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.training.train import STAGES

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
BIN = Path(sys.executable).parent
DOCUMENTS = [
    README,
    *sorted((ROOT / "docs").glob("*.md")),
    *(ROOT / name for name in ("eval/README.md", "eval/LOG.md", "datasets/README.md", "policies/README.md")),
]

SHORTER = {
    "lerobot-train": "--steps=2 --batch_size=2 --log_freq=1 --save_freq=2 --env_eval_freq=2 "
    "--eval.n_episodes=1 --eval.batch_size=1 --policy.cache_dataset=false",
    "lerobot-eval": "--eval.n_episodes=1 --eval.batch_size=1 --env.episode_length=5",
    "lerobot-dataset-viz": "--save=1 --output-dir=outputs/viz --num-workers=0",
    "dexflex-record": "--episodes=1 --workers=0",
    "dexflex-teleop": "--realtime=false --simulated.glove=clean --view=none",
    "compare_interfaces.py": "--methods=raw --episodes=1 --workers=0",
    "dexflex-corpus": "--jobs.train=1 --jobs.tune=1 --jobs.test=0 --objects_per_job=1 --steps_per_object=120 "
    "--workers=0",
    "dexflex-train": "--bank.rows=16 --bank.held_out_rows=8 --bank.n_pure=2 --bank.n_seeded=2 "
    + " ".join(f"--{stage}.held_out_rows=8" for stage in ("encoder_prior", "world_model", "dexgen"))
    + "".join(f" --{stage}.fit.steps=2 --{stage}.fit.batch_size=8" for stage in STAGES),
    "make": "--dry-run",
}
"""What the test adds to a command, so that it stays the reader's command but takes seconds."""
RESUMED = "--steps=3"
SET_UP = ("git", "cd", "source")
"""Commands that only prepare a reader's shell; the test stands in a prepared one."""
PARSED = {
    "dexflex-corpus": "lerobot_dexflex.corpus.cli",
    "dexflex-hand": "lerobot_dexflex.hand_check.cli",
    "dexflex-record": "lerobot_dexflex.recording.cli",
    "dexflex-teleop": "lerobot_dexflex.teleop.cli",
    "dexflex-train": "lerobot_dexflex.training.cli",
    "lerobot-dataset-viz": "lerobot.scripts.lerobot_dataset_viz",
    "lerobot-eval": "lerobot.scripts.lerobot_eval",
    "lerobot-train": "lerobot.scripts.lerobot_train",
}
"""Modules of the console scripts; those of `eval/` are found by their paths."""


def name_of(document):
    return str(document.relative_to(ROOT))


def blocks(document, language):
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(), re.DOTALL | re.MULTILINE)


def commands(document, language):
    lines = "\n".join(blocks(document, language)).replace("\\\n", " ").splitlines()
    words = [shlex.split(line, comments=True) for line in lines]
    return [command for command in words if command and command[0] not in SET_UP]


def script(command):
    """Return what a command runs: not `python`, nor `env` and the variables that it sets."""
    return next(word for word in command if word not in ("env", "python") and "=" not in word)


def shortened(command):
    name = Path(script(command)).name
    extra = RESUMED if "--resume=true" in command else SHORTER.get(name, "")
    if name == "lerobot-train" and "--resume=true" not in command:
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


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if blocks(d, "bash")], ids=name_of)
def test_commands_run_in_their_order(document, checkout):
    path = f"{BIN}{os.pathsep}{os.environ['PATH']}"
    quiet = os.environ | {"PATH": path, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1", "SLURM_JOB_ID": "1"}
    for command in commands(document, "bash"):
        run = subprocess.run(
            shortened(command), cwd=checkout, env=quiet, capture_output=True, text=True, timeout=300
        )
        assert run.returncode == 0, f"{shlex.join(command)}\n{run.stdout[-2000:]}\n{run.stderr[-4000:]}"


class Parsed(BaseException):
    """Raised where a command's words have been understood, so that nothing runs."""


@pytest.fixture
def parse_only(monkeypatch, tmp_path):
    """Commands know the hand of docs/your_hand.md.

    They stop, with `Parsed`, when their outermost parser is done; draccus parses within itself."""
    depth = 0

    def stopping(parse):
        def parse_then_stop(*args, **kwargs):
            nonlocal depth
            depth += 1
            try:
                parsed = parse(*args, **kwargs)
            finally:
                depth -= 1
            if depth == 0:
                raise Parsed
            return parsed

        return parse_then_stop

    monkeypatch.setattr(draccus, "parse", stopping(draccus.parse))
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stopping(argparse.ArgumentParser.parse_args))
    monkeypatch.chdir(ROOT)
    (tmp_path / "my_hand.py").write_text("".join(blocks(ROOT / "docs/your_hand.md", "python")))
    monkeypatch.syspath_prepend(tmp_path)


def parseable():
    """Return the commands of `sh` blocks that one of our parsers, or LeRobot's, reads."""
    return [
        pytest.param(command, id=f"{name_of(document)}: {shlex.join(command)[:60]}")
        for document in DOCUMENTS
        for command in commands(document, "sh")
        if script(command) in PARSED or script(command).startswith("eval/")
    ]


@pytest.mark.parametrize("command", parseable())
def test_commands_that_do_not_run_here_parse(command, parse_only, load_script, monkeypatch):
    name = script(command)
    monkeypatch.setattr(sys, "argv", command[command.index(name) :])
    module = importlib.import_module(PARSED[name]) if name in PARSED else load_script(Path(name).stem)
    with pytest.raises(Parsed):
        module.main()


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if blocks(d, "python")], ids=name_of)
def test_python_runs(document):
    code = "\n".join(blocks(document, "python"))
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    if "make_expert" in code:
        assert "True" in run.stdout.splitlines(), "the expert of the example did not solve its episode"


def test_readme_shows_the_two_commands_that_do_everything():
    shown = [shlex.join(command) for command in commands(README, "bash")]
    assert {"make demo", "make test"} <= set(shown)
    assert "exec make test" in (ROOT / ".ci/run").read_text()


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_lead_somewhere(document):
    text = document.read_text()
    for target in re.findall(r"\]\((?!https?://)([^)]+)\)", text):
        path, _, anchor = target.partition("#")
        file = document.parent / path if path else document
        assert file.exists(), target
        if anchor:
            assert anchor in anchors(file.read_text()), target


def anchors(text):
    """Return what GitHub makes of the headings."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("README.md", 1000),
        ("docs/controller.md", 1000),
        ("docs/benchmark.md", 1100),
        ("docs/tasks.md", 1000),
        ("docs/tool_tasks.md", 1300),
        ("docs/datasets.md", 1000),
        ("docs/training.md", 1000),
        ("docs/your_hand.md", 900),
        ("docs/streams.md", 500),
        ("docs/teleoperation.md", 700),
        ("eval/README.md", 500),
    ],
)
def test_documents_are_short(name, limit):
    prose = re.sub(
        r"<!-- results:.*?/results -->|^```.*?^```", " ", (ROOT / name).read_text(), flags=re.S | re.M
    )
    words = re.sub(r"[|]|---", " ", prose).split()
    assert len(words) <= limit


@pytest.fixture
def readme_table(load_script):
    return load_script("readme_table")


def test_tables_of_results_and_cards_are_made_from_the_committed_results(readme_table):
    documents = readme_table.documents()
    assert ROOT / "docs/results.md" in documents
    assert all(
        readme_table.names(document.read_text())
        for document in documents
        if "controller" not in str(document)
    )
    for document in documents:
        text = document.read_text()
        made = readme_table.filled(text, ROOT / "eval/results", readme_table.up(document))
        assert made == text, f"{document}: run `python eval/readme_table.py`"


def table_rows(text, header):
    """Return the cells of the rows of the first table whose header begins so, by their first cell."""
    lines = text[text.index(header) :].partition("\n\n")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return rows[0], {row[0]: row for row in rows[2:]}


def test_readme_shows_the_averages_of_the_results():
    results = (ROOT / "docs/results.md").read_text()
    _, rows = table_rows(results[results.index("<!-- results:operator -->") :], "| interface |")
    prose = " ".join(README.read_text().split())
    for name in ("joint", "press:4", "dexgen", "dexflex"):
        average, _, _ = rows[f"`operator/{name}`"][-1].partition(", n =")
        assert f"`{name}` reaches {average}" in prose or f"`{name}` {average}" in prose


def test_details_and_selectivity_of_a_view(readme_table, tmp_path):
    """8 of 10 and 0 of 10: p = 2 / 2^8; changes of 3 mm around contacts and of 1.5 mm in calm."""
    (tmp_path / "tasks.csv").write_text(
        "method,version,task,condition,seed,success,steps,seconds,progress,progress_final,drops,holding,nht,"
        "intervention,intervention_event,intervention_calm,change_event,change_calm\n"
        + "".join(
            f"press,a,PourCup-v0,novice,{k},{k < 8},200,9.96,1.0,1.0,0,0.5,0.75,0.3,0.4,0.2,3.0,1.5\n"
            for k in range(10)
        )
        + "".join(
            f"{name},b,PourCup-v0,novice,{k},False,320,16.0,0.5,0.5,0,0.5,0.5,,,,,\n"
            for k in range(10)
            for name in ("joint", "raw")
        )
    )
    (tmp_path / "runs.csv").write_text("version,method,command,commit,code,weights,settings,date\n")
    names = "joint,raw,press"
    details = readme_table.View(
        names, "novice", "PourCup-v0", what="details", against="press", results=tmp_path
    )
    text = readme_table.markdown(details)
    assert "| `press` | 8/10 (80 %) | 49-94 % |" in text
    assert "0.75 [0.75, 0.75]" in text
    assert "| raw vs press | 10 | 0 | 8 | 0.00781 |" in text
    assert "joint vs raw" not in text
    selectivity = readme_table.View(names, "novice", "PourCup-v0", what="selectivity", results=tmp_path)
    text = readme_table.markdown(selectivity)
    assert "| `press` | 3.00 [3.00, 3.00] | 1.50 [1.50, 1.50] | 2.0 [2.0, 2.0] | 0.40" in text
    assert "`raw`" not in text


@pytest.mark.parametrize("settings", [{"what": "all"}, {"what": "details", "trainings": True}])
def test_a_view_that_cannot_be_made_is_refused(readme_table, settings):
    with pytest.raises(DexFlexError, match="`what` must be"):
        readme_table.View(**settings)


def test_a_result_table_holds_rates_intervals_and_tests(readme_table, tmp_path):
    """8 of 10 and 0 of 10: p = 2 / 2^8; Wilson intervals by hand."""
    (tmp_path / "tasks.csv").write_text(
        "method,version,task,condition,seed,success,steps,seconds,progress,progress_final,drops,holding,"
        "intervention\n"
        + "".join(f"raw,a,PourCup-v0,clean,{k},{k < 8},200,9.96,1.0,1.0,0,0.5,0.0\n" for k in range(10))
        + "".join(f"joint,b,PourCup-v0,clean,{k},False,320,16.0,0.5,0.5,0,0.5,\n" for k in range(10))
    )
    (tmp_path / "runs.csv").write_text("version,method,command,commit,code,weights,settings,date\n")
    readme_table.VIEWS["x"] = readme_table.View("raw,joint", tasks="PourCup-v0")
    text = readme_table.filled("above\n<!-- results:x -->\nold\n<!-- /results -->\nbelow", tmp_path)
    assert "| `raw` | 80 % (8/10) | 49 to 94 % | 10.0 s |" in text
    assert "| `joint` | 0 % (0/10) | 0 to 28 % | - |" in text
    assert "raw against joint p = 0.0078." in text
    assert "old" not in text
    assert text.startswith("above\n<!-- results:x -->\n")
    assert text.endswith("<!-- /results -->\nbelow")
