import pytest

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.errors import DexFlexError


def test_default_is_16_candidates():
    assert SelectionSettings().n_candidates == 16


@pytest.mark.parametrize(
    "values",
    [
        {"n_pure": 0, "n_seeded": 0, "include_draft": False, "project": False},
        {"n_pure": -1},
        {"levels": ()},
        {"levels": (1.0,)},
        {"seeds": ("future",)},
        {"nfe": 0},
        {"prefix": 9},
        {"temperature": -1.0},
    ],
    ids=str,
)
def test_impossible_settings_are_refused(values):
    with pytest.raises(DexFlexError):
        SelectionSettings(**values)
