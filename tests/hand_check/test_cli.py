"""`dexflex-hand check` tells what each check found, draws the hand, and ends with 1 if a check fails."""

import re

import cv2
import numpy as np
import pytest
from allegro import ALLEGRO

from lerobot_dexflex.evaluation.report.film import read_mp4
from lerobot_dexflex.hand_check import cli
from lerobot_dexflex.hand_check.check import CHECKS
from lerobot_dexflex.hand_check.config import HandCheckConfig

BROKEN = """
from dataclasses import replace
from allegro import ALLEGRO
REVERSED = replace(ALLEGRO, finger_order=(0.0, -1.0, 0.0))
"""


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Only the checks of numbers; `test_checks.py` runs all of them."""
    kept = [check for check in CHECKS if check.__name__ in ("check_limits", "check_order")]
    monkeypatch.setattr("lerobot_dexflex.hand_check.check.CHECKS", kept)


def test_a_hand_that_passes_is_drawn_and_filmed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("lerobot_dexflex.hand_check.portrait._FRAMES_PER_JOINT", 4)
    assert cli.main(["check", "allegro:ALLEGRO", f"--output={tmp_path}", "--film"]) == 0
    told = capsys.readouterr().out
    assert "allegro:ALLEGRO: 4 fingers, 16 joints\npass  limits " in told
    assert "allegro:ALLEGRO passes all 2 checks." in told
    picture = np.array(cv2.imread(str(tmp_path / "hand.png")))
    assert picture.shape == (1280, 1280, 3)
    film = read_mp4(tmp_path / "sweep.mp4")
    assert film.shape == (ALLEGRO.n_joints * 4, 320, 640, 3)
    moves = abs(film[1:].astype(int) - film[:-1]).max((1, 2, 3)) > 40
    assert moves.mean() > 0.9


def test_taxels_are_yellow_and_red_nearest_the_tip(tmp_path):
    """On the three fingers that look at the camera; up is the way to the tips."""
    assert cli.main(["check", "leap", f"--output={tmp_path}"]) == 0
    picture = np.array(cv2.imread(str(tmp_path / "hand.png")), int)
    blue, green, red = picture[: len(picture) // 2, : len(picture) // 2].transpose(2, 0, 1)
    yellow = ((red > green) & (green > 2 * blue) & (red > 100)).astype(np.uint8)
    _, _, places, _ = cv2.connectedComponentsWithStats(cv2.dilate(yellow, np.ones((5, 5), np.uint8)))
    left, top, width, height, _ = places[np.argsort(-places[:, cv2.CC_STAT_AREA])][1:4].T
    assert (width > 20).all()
    assert (height > 20).all()
    reds = np.argwhere((red > 2 * green) & (red > 60))
    for k in range(3):
        above = reds[(reds[:, 1] >= left[k]) & (reds[:, 1] < left[k] + width[k])]
        assert len(above) > 10
        assert above[:, 0].mean() < top[k] + 0.2 * height[k]


def test_a_hand_that_fails_ends_with_1_and_the_remedy(tmp_path, monkeypatch, capsys):
    (tmp_path / "broken.py").write_text(BROKEN)
    monkeypatch.syspath_prepend(tmp_path)
    assert cli.main(["check", "broken:REVERSED", f"--output={tmp_path}"]) == 1
    told = capsys.readouterr().out
    assert "FAIL  order " in told
    assert "valid: 12 mm or more" in told
    assert "let `finger_order` point from the last" in told
    assert "broken:REVERSED fails 1 of 2 checks: order." in told
    assert (tmp_path / "hand.png").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["check"], r"Which hand\? .*\['leap', 'sharpa'\]"),
        (["check", "claw"], "There is no hand 'claw'"),
        (["chuck", "leap"], "unrecognized arguments: chuck leap"),
    ],
)
def test_words_that_name_no_hand_are_refused(words, message, capsys):
    assert cli.main(words) == 1
    assert re.search(message, capsys.readouterr().err)


def test_the_hand_may_be_given_like_any_other_setting(tmp_path, capsys):
    assert cli.main(["--hand=sharpa", f"--output={tmp_path}"]) == 0
    assert "sharpa: 5 fingers, 22 joints" in capsys.readouterr().out
    assert HandCheckConfig("leap").film is False
