import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.conditions import Condition


@pytest.mark.parametrize(
    "name",
    [
        "clean",
        "removal_2mm",
        "noise_4mm",
        "removal_2mm+heavy",
        "verified",
        "typical",
        "delay_2+typical+heavy",
        "delay_2+pressing",
        "noise_2mm+delay_2+pressing+verified",
    ],
)
def test_a_condition_keeps_its_name(name):
    words = Condition.parse(name).name.split("+")
    assert sorted(words) == sorted(name.split("+"))
    assert Condition.parse("+".join(reversed(words))).name == "+".join(words)


def test_a_condition_is_what_its_words_say_in_any_order():
    found = Condition.parse("heavy+clean+removal_2.0mm")
    assert (found.name, found.disturbance) == ("removal_2mm+heavy", "heavy")
    assert [(error.family, error.strength) for error in found.errors] == [("removal", 0.002)]


def test_drafts_of_motion_and_goals_that_nobody_verified_go_without_saying():
    words = {
        "clean": ("motion", False),
        "verified": ("motion", True),
        "pressing": ("pressing", False),
        "pressing+verified": ("pressing", True),
    }
    found = {name: Condition.parse(name) for name in words}
    assert {name: (each.source, each.verified) for name, each in found.items()} == words
    assert Condition.parse("verified+bias_1mm+pressing").setting == ("pressing", "verified")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rain_2mm", r"Unknown word 'rain_2mm' .* Valid, joined by `\+`: clean, none, heavy, .*removal_<"),
        ("unverified", "Unknown word 'unverified' .* pressing, verified"),
        ("heavy+slippery", "names heavy and slippery; at most one disturbance"),
        ("removal_2", "'removal_2' is no command error"),
        ("", "Unknown word ''"),
    ],
)
def test_words_that_mean_nothing_are_refused(name, message):
    with pytest.raises(DexFlexError, match=message):
        Condition.parse(name)
