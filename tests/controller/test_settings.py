import pytest

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.errors import DexFlexError


def test_default_is_36_candidates_and_not_the_draft():
    assert SelectionSettings().n_candidates == 36
    assert not SelectionSettings().include_draft


@pytest.mark.parametrize(
    "values",
    [
        {"n_pure": 0, "n_seeded": 0, "n_finger": 0},
        {"others_level": 1.1},
        {"n_pure": -1},
        {"levels": ()},
        {"levels": (1.0,)},
        {"finger_levels": ()},
        {"finger_levels": (-0.1,)},
        {"nfe": 0},
        {"prefix": 9},
        {"hysteresis": -1.0},
        {"grip": float("nan")},
    ],
    ids=str,
)
def test_impossible_settings_are_refused(values):
    with pytest.raises(DexFlexError):
        SelectionSettings(**values)
