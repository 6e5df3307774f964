"""Hands are found by name, a user's own by its module; what is none is refused with the remedy."""

import pickle

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import HANDS, LEAP, get_hand


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module `claws` whose attribute `CLAW` is LEAP under a name of its own."""
    (tmp_path / "claws.py").write_text(
        "from dataclasses import replace\n"
        "from lerobot_dexflex.hands import LEAP\n"
        "CLAW, FINGERS = replace(LEAP, name='claw'), 4\n"
    )
    (tmp_path / "torn.py").write_text("import no_such_package\n")
    monkeypatch.syspath_prepend(tmp_path)


def test_hands_of_the_library_are_found_by_name():
    assert get_hand("leap") is LEAP
    assert all(hand.name == name for name, hand in HANDS.items())


@pytest.mark.usefixtures("module")
def test_a_hand_of_a_module_bears_the_name_by_which_it_is_found_again():
    hand = get_hand("claws:CLAW")
    assert hand.name == "claws:CLAW"
    assert hand.fingers == LEAP.fingers
    assert get_hand(hand.name) is hand
    assert pickle.loads(pickle.dumps(hand)) == hand


@pytest.mark.usefixtures("module")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("claw", r"There is no hand 'claw'. Choose from \['leap', 'sharpa'\], or .*`package.module:ATTRIB"),
        ("claws.py:", "named `package.module:ATTRIBUTE`, as .* Got 'claws.py:'"),
        ("my/claws:CLAW", "Got 'my/claws:CLAW'"),
        (
            "paws:PAW",
            "'paws' of the hand 'paws:PAW' cannot be imported: No module named 'paws'. .*PYTHONPATH",
        ),
        ("torn:CLAW", "'torn' of the hand 'torn:CLAW' cannot be imported: No module named 'no_such_package'"),
        ("claws:PAW", r"The module 'claws' has no 'PAW'. Its hands: \['CLAW', 'LEAP'\]"),
        ("claws:FINGERS", "'claws:FINGERS' must be a `lerobot_dexflex.hands.Hand`. Got int"),
    ],
)
def test_what_names_no_hand_is_refused(name, message):
    with pytest.raises(DexFlexError, match=message):
        get_hand(name)
