import pytest

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.methods import ABLATIONS, Method, selection_settings
from lerobot_dexflex.interfaces.gain import GainInterface


def test_a_name_is_read_into_base_ablation_options_and_gain():
    method = Method.parse("dexflex-notouch:temperature=0.2+seeds=draft/mean@0.7")
    assert (method.base, method.ablation, method.gain) == ("dexflex", "notouch", 0.7)
    assert dict(method.options) == {"temperature": 0.2, "seeds": ("draft", "mean")}
    assert Method.parse("shrink:0.7").options == (("gain", 0.7),)
    assert Method.parse("oracle:clean").options == (("reference", "clean"),)
    assert Method.parse("oracle:clean+moving=2").options == (("reference", "clean"), ("moving", 2))


@pytest.mark.parametrize(
    "name", ["best", "joint", "raw:0.5", "shrink:gain=", "raw-notouch", "dexflex-noluck", "raw@half"]
)
def test_names_that_mean_nothing_are_refused(name):
    with pytest.raises(DexFlexError, match=r"Valid|not take|must"):
        Method.parse(name).make(None)


def test_options_that_an_interface_does_not_take_are_refused():
    with pytest.raises(DexFlexError, match="does not take"):
        Method.parse("clip:speed=3").make(None)
    with pytest.raises(DexFlexError, match=r"must be in \(0, 1\]"):
        Method.parse("shrink:1.5").make(None)


def test_a_gain_wraps_any_interface_and_a_plain_name_does_not():
    assert isinstance(Method.parse("filter@0.5").make(None), GainInterface)
    assert Method.parse("filter").make(None).name == "filter"


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_every_ablation_changes_the_settings_and_keeps_the_number_of_candidates(ablation):
    whole, ablated = SelectionSettings(n_pure=8), selection_settings(ablation, {"n_pure": 8})
    assert ablated != whole
    assert ablated.n_candidates == whole.n_candidates


def test_without_seeded_proposals_the_raw_draft_is_no_candidate_either():
    settings = selection_settings("noseeded", {})
    assert (settings.n_seeded, settings.include_draft) == (0, False)


def test_a_method_names_the_modules_and_the_weights_that_decide_it(controller_folder):
    assert Method.parse("raw").modules == ("lerobot_dexflex.interfaces.raw",)
    assert Method.parse("filter@0.5").modules == (
        "lerobot_dexflex.interfaces.filter",
        "lerobot_dexflex.interfaces.gain",
    )
    assert Method.parse("raw").weights("/nowhere") == ()
    names = [path.name for path in Method.parse("dexgen").weights(controller_folder)]
    assert names == ["config.json", "model.safetensors", "dexgen.safetensors"]


def test_a_learned_method_without_its_controller_is_refused():
    with pytest.raises(DexFlexError, match="No controller"):
        Method.parse("dexflex").weights("/nowhere")
