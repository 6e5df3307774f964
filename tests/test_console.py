import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from lerobot_dexflex import console


@dataclass
class Config:
    count: int = 1
    loud: bool = False
    quick: bool = True


def parsed(*words):
    """Return what a console script would work with."""
    seen = []
    assert console.run(Config, lambda config, words: seen.append((config, words)) or 0, list(words)) == 0
    return seen[0]


@pytest.mark.parametrize(
    "words",
    [
        ("--loud",),
        ("--loud", "--count=3"),
        ("--loud=true",),
        ("--loud", "true"),
    ],
)
def test_a_truth_value_may_be_set_by_its_bare_name(words):
    assert parsed(*words)[0].loud


@pytest.mark.parametrize(
    "words", [(), ("--loud=false",), ("--loud", "false"), ("--quick", "--loud", "false")]
)
def test_a_truth_value_stays_off_unless_it_is_set(words):
    assert not parsed(*words)[0].loud


def test_the_work_is_told_the_words_as_they_were_understood(tmp_path: Path):
    (tmp_path / "x.yaml").write_text("count: 4\n")
    config, words = parsed(f"--config={tmp_path / 'x.yaml'}", "--loud")
    assert config == Config(count=4, loud=True)
    assert words == [f"--config_path={tmp_path / 'x.yaml'}", "--loud=true"]


@pytest.mark.parametrize(
    "words", [["--count"], ["--count=many"], ["--colour=red"], ["--loud=perhaps"], ["--config=missing.yaml"]]
)
def test_whatever_the_user_got_wrong_ends_in_status_1_before_any_work(words, capsys):
    assert console.run(Config, lambda config, words: pytest.fail("worked"), words) == 1
    assert "error: " in capsys.readouterr().err


def test_half_a_configuration_file_is_an_error_of_the_user(tmp_path, capsys):
    (tmp_path / "x.yaml").write_text("count: [4")
    assert (
        console.run(Config, lambda config, words: pytest.fail("worked"), [f"--config={tmp_path / 'x.yaml'}"])
        == 1
    )
    assert "error: " in capsys.readouterr().err


def test_help_is_no_error(capsys):
    with pytest.raises(SystemExit) as ended:
        console.run(Config, lambda config, words: 0, ["--help"])
    assert not ended.value.code
    assert "--count" in capsys.readouterr().out


@pytest.mark.parametrize("where", ["import", "work"])
def test_an_interrupt_ends_a_script_alike_while_it_imports_and_while_it_works(where, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(f"""\
import sys
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import entry_points
from lerobot_dexflex import console
if {where!r} == "import":
    raise KeyboardInterrupt

@dataclass
class Config:
    count: int = 1

def work(config, words):
    raise KeyboardInterrupt

sys.exit(console.run(Config, work, []))
""")
    ended = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert ended.returncode == 130
    assert ended.stderr.startswith("Stopped")
    assert "Traceback" not in ended.stderr


def test_other_faults_keep_their_traceback(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("from lerobot_dexflex import console\n1 / 0\n")
    ended = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "ZeroDivisionError" in ended.stderr


@pytest.mark.parametrize("name", ["corpus", "record", "release", "train"])
def test_a_console_script_is_interrupted_alike_while_it_imports_its_package(name, tmp_path):
    """Its entry point, with a Ctrl-C in the middle of the first heavy import."""
    (tmp_path / "torch.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    (entry,) = entry_points(group="console_scripts", name=f"dexflex-{name}")
    assert entry.value == f"lerobot_dexflex.console:{name}"
    code = f"from lerobot_dexflex.console import {name}\nimport sys\nsys.exit({name}())"
    ended = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        # A test suite in the background of a shell ignores Ctrl-C, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert (ended.returncode, ended.stderr) == (130, "Stopped before anything began.\n")
