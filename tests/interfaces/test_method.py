import dataclasses
import inspect
from importlib import import_module
from typing import Any, cast

import pytest

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces import INTERFACES, Method, make_interface
from lerobot_dexflex.interfaces.dexflex import ablated
from lerobot_dexflex.interfaces.gain import GainInterface
from lerobot_dexflex.interfaces.method import require_drafts
from lerobot_dexflex.interfaces.registry import SELECTION_OPTIONS, InterfaceEntry, register
from lerobot_dexflex.runs.provenance import code_digest, imported

ABLATIONS = tuple(INTERFACES["dexflex"].ablations)


def test_a_name_is_read_into_base_ablation_options_and_gain():
    method = Method.parse("dexflex-notouch:temperature=0.2+seeds=draft/mean+levels=0.5@0.7")
    assert (method.base, method.ablation, method.gain) == ("dexflex", "notouch", 0.7)
    assert dict(method.options) == {"temperature": 0.2, "seeds": ("draft", "mean"), "levels": (0.5,)}
    assert Method.parse("shrink:0.7").options == (("gain", 0.7),)
    assert Method.parse("dexgen:20+use_touch=False").options == (("guidance", 20.0), ("use_touch", False))
    assert Method.parse("raw") == Method("raw", "", (), 1.0)


@pytest.mark.parametrize(
    ("name", "canonical"),
    [
        ("raw@1", "raw"),
        ("shrink:gain=0.70", "shrink:0.7"),
        ("dexgen:use_touch=False+2e1@.50", "dexgen:20+use_touch=False@0.5"),
        ("dexgen:guidance=1e300", "dexgen:1e300"),
        ("dexflex:prefix=2+n_pure=16", "dexflex:n_pure=16+prefix=2"),
        ("dexflex-nopure:seeds=draft/0.5@0.25", "dexflex-nopure:seeds=draft/0.5@0.25"),
        ("clip:0.00015", "clip:0.00015"),
    ],
)
def test_equal_methods_have_one_name_however_they_were_written(name, canonical):
    assert Method.parse(name).name == canonical
    assert Method.parse(canonical) == Method.parse(name)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("psychic", r"Unknown interface 'psychic' in 'psychic'\. Valid: joint, raw, filter, hold"),
        ("", "Unknown interface ''"),
        ("dexflex-noluck", r"Unknown ablation 'noluck' .* Valid of 'dexflex': noscore, notouch, "),
        ("dexflex-", "Unknown ablation ''"),
        ("raw-notouch", r"Unknown ablation 'notouch' .* Valid of 'raw': none"),
        ("raw:0.5", r"Unknown option '0\.5' .* Valid of 'raw': none"),
        ("clip:speed=3", r"Unknown option 'speed=3' .* Valid of 'clip': limit=\.\.\."),
        ("dexflex:0.2", r"Unknown option '0.2' .* Valid of 'dexflex': n_pure=\.\.\., n_seeded=\.\.\."),
        ("filter:", r"Unknown option '' .* smoothing=\.\.\., clip=\.\.\."),
        ("shrink:0.5+gain=0.6", r"Repeated option 'gain=0\.6'"),
        ("shrink:gain=", r"`gain` in 'shrink:gain=' must be a number\. Got ''"),
        ("dexgen:nan", r"`guidance` in 'dexgen:nan' must be a number\. Got 'nan'"),
        ("dexflex:n_pure=1.5", r"`n_pure` .* must be a whole number\. Got '1\.5'"),
        ("dexflex:use_slow=no", r"`use_slow` .* must be True or False\. Got 'no'"),
        ("dexflex:levels=0.5/x", r"`levels` .* must be numbers with '/' between them\. Got '0\.5/x'"),
        ("raw@", r"gain must be in \(0, 1\], as in raw@0\.4\. Got 'raw@'"),
        ("raw@0", "gain must be in"),
        ("raw@1.5", "gain must be in"),
        ("raw@nan", "gain must be in"),
        ("raw@fast", "gain must be in"),
        ("joint@0.5", "'joint' executes joint targets"),
    ],
)
def test_names_that_mean_nothing_are_refused_with_what_is_valid(name, message):
    with pytest.raises(DexFlexError, match=message):
        Method.parse(name)


def test_values_out_of_their_range_are_refused_when_the_interface_is_made(controller_folder):
    with pytest.raises(DexFlexError, match=r"`gain` must be in \(0, 1\]"):
        make_interface("shrink:1.5")
    with pytest.raises(DexFlexError, match="`prefix` in"):
        make_interface("dexflex:prefix=9", controller_folder)


@pytest.mark.parametrize("name", ["joint", "raw", "filter", "hold", "shrink", "clip", "reflex", "dexgen"])
def test_an_entry_names_exactly_what_its_interface_takes(name):
    entry = INTERFACES[name]
    taken = set(inspect.signature(getattr(import_module(entry.module), entry.maker)).parameters)
    assert taken - ({"controller", "prior"} if entry.files else set()) == set(entry.options)
    assert not entry.main_option or entry.main_option in entry.options


def test_every_setting_of_a_selection_but_the_projections_gains_is_an_option():
    fields = [each.name for each in dataclasses.fields(SelectionSettings) if each.name != "projection"]
    assert list(SELECTION_OPTIONS) == fields


def test_options_and_ablation_reach_the_controllers_settings(controller_folder):
    interface: Any = make_interface("dexflex-notouch:n_pure=3+seeds=draft/0.5+levels=0.25", controller_folder)
    expected = SelectionSettings(n_pure=3, seeds=("draft", "0.5"), levels=(0.25,), use_touch=False)
    assert interface.settings == expected


def test_a_gain_wraps_any_interface_and_a_plain_name_does_not():
    made = make_interface("filter:clip=0.003@0.5")
    assert isinstance(made, GainInterface)
    assert (made.name, made.inner.name) == ("filter:clip=0.003@0.5", "filter")
    assert not isinstance(make_interface("filter@1"), GainInterface)


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_every_ablation_changes_the_settings_and_keeps_the_number_of_candidates(ablation):
    whole = SelectionSettings(n_pure=8)
    changed = ablated(whole, ablation)
    assert changed != whole
    assert changed.n_candidates == whole.n_candidates


def test_without_seeded_proposals_the_raw_draft_is_no_candidate_either():
    settings = ablated(SelectionSettings(), "noseeded")
    assert (settings.n_seeded, settings.include_draft, settings.project) == (0, False, False)


def test_a_version_follows_a_methods_own_modules_only():
    modules = {name: Method.parse(name).modules for name in ("raw", "shrink:0.5", "shrink:0.7", "raw@0.5")}
    digests = {name: code_digest(found) for name, found in modules.items()}
    assert digests["raw"] != digests["shrink:0.5"] == digests["shrink:0.7"]
    assert digests["raw"] != digests["raw@0.5"]
    assert "lerobot_dexflex.interfaces.gain" in modules["raw@0.5"]
    for other in ("filter", "dexflex", "gain", "touch_watch"):
        assert f"lerobot_dexflex.interfaces.{other}" not in imported(modules["raw"])


def test_the_weights_of_a_method_are_the_files_that_decide(controller_folder, tmp_path):
    assert Method.parse("filter").weights(tmp_path) == ()
    names = [path.name for path in Method.parse("dexgen@0.4").weights(controller_folder)]
    assert names == ["config.json", "model.safetensors", "dexgen.safetensors"]
    assert len(Method.parse("dexflex-noslow").weights(controller_folder)) == 2
    with pytest.raises(DexFlexError, match="No controller at"):
        Method.parse("dexflex").weights(tmp_path / "nowhere")


def test_a_controller_is_loaded_once_and_interfaces_keep_their_state_beside_it(controller_folder):
    names = ("dexflex", "dexgen", "dexgen")
    first, second, third = (cast(Any, make_interface(name, controller_folder)) for name in names)
    assert first.controller is second.controller is third.controller
    assert second.prior is third.prior
    assert first._past is not second._past


def test_a_name_is_registered_once():
    with pytest.raises(DexFlexError, match="There is an interface 'raw' already"):
        register("raw", InterfaceEntry("somewhere", "Something", "draft"))
    with pytest.raises(DexFlexError, match="Got 'no-go'"):
        register("no-go", InterfaceEntry("somewhere", "Something", "draft"))


def test_an_operator_needs_an_interface_that_reads_drafts():
    assert require_drafts("shrink:0.5").base == "shrink"
    with pytest.raises(DexFlexError, match=r"must be one that reads drafts: raw, filter, .* Got 'joint'"):
        require_drafts("joint")
