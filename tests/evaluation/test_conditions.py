import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.conditions import Condition


def test_a_condition_is_what_its_words_say_and_is_named_alike():
    names = ["clean", "removal_2mm", "unverified", "removal_2mm+heavy", "delay_2+unverified"]
    assert [Condition.parse(name).name for name in names] == names
    found = Condition.parse("heavy+removal_2.0mm")
    assert (found.name, found.disturbance, found.verified) == ("removal_2mm+heavy", "heavy", True)
    assert not Condition.parse("unverified").verified


def test_words_that_mean_nothing_are_refused():
    with pytest.raises(DexFlexError, match="rain"):
        Condition.parse("rain_2mm")
    with pytest.raises(DexFlexError, match="more than one disturbance"):
        Condition.parse("heavy+slippery")
