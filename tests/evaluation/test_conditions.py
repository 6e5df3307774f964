import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.conditions import Condition


@pytest.mark.parametrize(
    "name", ["clean", "removal_2mm", "unverified", "noise_4mm", "removal_2mm+heavy", "delay_2+unverified"]
)
def test_a_condition_keeps_its_name(name):
    assert Condition.parse(name).name == name


def test_a_condition_is_what_its_words_say_in_any_order():
    found = Condition.parse("heavy+clean+removal_2.0mm")
    assert (found.name, found.disturbance, found.verified) == ("removal_2mm+heavy", "heavy", True)
    assert [(error.family, error.strength) for error in found.errors] == [("removal", 0.002)]
    assert not Condition.parse("unverified").verified


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rain_2mm", r"Unknown word 'rain_2mm' .* Valid, joined by `\+`: clean, none, heavy, .*removal_<"),
        ("heavy+slippery", "names heavy and slippery; at most one disturbance"),
        ("removal_2", "'removal_2' is no command error"),
        ("", "Unknown word ''"),
    ],
)
def test_words_that_mean_nothing_are_refused(name, message):
    with pytest.raises(DexFlexError, match=message):
        Condition.parse(name)
