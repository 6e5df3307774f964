import subprocess
import sys
from dataclasses import dataclass
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
import subprocess
import sys
from dataclasses import dataclass
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


@pytest.mark.parametrize("command", ["recording", "corpus", "training"])
def test_console_scripts_import_the_console_first(command):
    """What they import before it dies by the signal, with a traceback."""
    package = Path(console.__file__).parent
    imports = [
        line for line in (package / command / "cli.py").read_text().splitlines() if "lerobot_dexflex" in line
    ]
    assert imports[0] == "from lerobot_dexflex import console"
    assert not {"torch", "mujoco", "draccus"} & heavy_imports_of("lerobot_dexflex.console")


def heavy_imports_of(module):
    code = f"import sys, {module}; print(*sys.modules)"
    return set(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.split()
    )
