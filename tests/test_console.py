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


def test_another_value_needs_its_value(capsys):
    with pytest.raises(SystemExit):
        console.run(Config, lambda config, words: 0, ["--count"])
    assert "--count" in capsys.readouterr().err
