"""The hand that docs/your_hand.md spells out is one, and the page names every field there is."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

from lerobot_dexflex.hand_check.check import CHECKS, findings
from lerobot_dexflex.hands import Finger, Hand, get_hand
from lerobot_dexflex.hands.body import Link, Motor

PAGE = (Path(__file__).parents[2] / "docs/your_hand.md").read_text()


@pytest.fixture
def claw(tmp_path, monkeypatch):
    (example,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    (tmp_path / "hand_of_the_page.py").write_text(example)
    monkeypatch.syspath_prepend(tmp_path)
    return get_hand("hand_of_the_page:CLAW")


def test_the_example_passes_every_check(claw):
    assert [finding for finding in findings(claw) if not finding.passed] == []


def test_the_table_names_every_field():
    table = PAGE[PAGE.index("| field |") :].partition("\n\n")[0]
    named = {name for row in table.splitlines() for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    existing = {*Link._fields, *Motor._fields} | {f.name for kind in (Finger, Hand) for f in fields(kind)}
    assert existing - {"links", "motors"} <= named
    assert named <= existing | {"Link", "Motor", "Finger", "Hand"}


def test_the_page_says_how_many_checks_there_are():
    numbers = {13: "thirteen", 14: "fourteen", 15: "fifteen", 16: "sixteen"}
    assert f"{numbers[len(CHECKS)]} checks" in PAGE
