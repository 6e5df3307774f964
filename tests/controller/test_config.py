import json

import pytest

from lerobot_dexflex.controller import ControllerConfig
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP, SHARPA


def test_config_survives_json(tmp_path):
    config = ControllerConfig(use_touch=False, prior_width=64)
    config.save(tmp_path / "config.json")
    assert ControllerConfig.load(tmp_path / "config.json") == config


@pytest.mark.parametrize(
    "change",
    [
        {"rate": 50.0},
        {"format": 1},
        {"draft_definition": "commanded_displacement"},
        {"frames": (0, 1)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_config_of_another_rate_or_format_is_refused(change):
    with pytest.raises(DexFlexError, match=next(iter(change))):
        ControllerConfig(**change)


def test_a_controller_of_the_old_drafts_is_refused_with_the_remedy(tmp_path):
    """Also where the rest of it is of another format, as that of older versions is."""
    path = tmp_path / "config.json"
    path.write_text(json.dumps({"format": 1, "draft_definition": "commanded_displacement"}))
    remedy = r"drafts are 'commanded_displacement'.*measured.*Train it anew with `dexflex-corpus`.*shipped"
    with pytest.raises(DexFlexError, match=rf"config\.json.*{remedy}"):
        ControllerConfig.load(path)


def test_config_of_a_hand_that_nobody_knows_is_refused_with_those_there_are():
    with pytest.raises(DexFlexError, match=r"'allegro'.*'leap', 'sharpa'"):
        ControllerConfig(hand="allegro")


@pytest.mark.parametrize(("trained", "other"), [(LEAP, SHARPA), (SHARPA, LEAP)], ids=["leap", "sharpa"])
def test_a_controller_moves_the_hand_alone_that_it_was_trained_for(trained, other):
    config = ControllerConfig(hand=trained.name)
    config.check(trained)
    message = rf"in some/folder was trained for '{trained.name}', but the robot is '{other.name}'"
    with pytest.raises(DexFlexError, match=rf"{message}.*--policy\.controller=.*--hand={other.name}"):
        config.check(other, "The controller in some/folder")


def test_a_controller_of_an_older_format_is_refused_by_the_format():
    """Not by the entries that only it has."""
    with pytest.raises(DexFlexError, match=r"`format` 3 cannot run here: this code serves 4"):
        ControllerConfig.from_dict({"format": 3, "embodiment": "leap_right"})


def test_foreign_configuration_is_refused():
    with pytest.raises(DexFlexError, match=r"missing .*hand.*unknown .*n_layers"):
        ControllerConfig.from_dict({"n_layers": 3})


@pytest.mark.parametrize("text", ["{", json.dumps([1])])
def test_damaged_configuration_is_refused(tmp_path, text):
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(DexFlexError, match=r"config\.json"):
        ControllerConfig.load(tmp_path / "config.json")


@pytest.mark.parametrize(
    ("change", "valid"),
    [
        ({"touch_scale": 0}, "a positive number"),
        ({"touch_scale": "much"}, "a positive number"),
        ({"tip_scale": float("nan")}, "a positive number"),
        ({"body_width": 1.5}, "a positive whole number"),
        ({"prior_layers": 0}, "a positive whole number"),
        ({"use_touch": 1}, "a bool"),
        ({"slow_levels": []}, "a list"),
    ],
)
def test_a_value_of_another_kind_or_range_is_refused_by_its_name(change, valid):
    [name] = change
    with pytest.raises(DexFlexError, match=f"`{name}` of a controller must be {valid}. Got"):
        ControllerConfig(**change)


@pytest.mark.parametrize(("hand", "fingers", "chunk"), [("leap", 4, 96), ("sharpa", 5, 120)])
def test_widths_add_up(hand, fingers, chunk):
    config = ControllerConfig(hand=hand)
    assert config.latent_width == config.body_width + config.contact_width + fingers * config.finger_width
    assert config.feature_width == config.latent_width + config.slow_width
    assert config.chunk_width == chunk
