import inspect
from dataclasses import fields
from importlib import import_module

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import INTERFACES, Method, make_interface
from lerobot_dexflex.interfaces.contact_projection import ProjectionSettings
from lerobot_dexflex.interfaces.method import require_drafts
from lerobot_dexflex.interfaces.options import NUMBER, NUMBERS, SWITCH, WHOLE, WORDS
from lerobot_dexflex.interfaces.registry import InterfaceEntry, register
from lerobot_dexflex.runs.provenance import code_digest, imported


@pytest.fixture(autouse=True)
def fake(monkeypatch):
    """Registers `fake`, which has all that a learned interface may have."""
    entry = InterfaceEntry(
        "lerobot_dexflex.interfaces.raw",
        "RawInterface",
        "draft",
        files=("config.json", "fake.safetensors"),
        options={"levels": NUMBERS, "n_pure": WHOLE, "seeds": WORDS, "share": NUMBER, "use_touch": SWITCH},
        ablations={"notouch": "its touch is hidden", "noscore": "nothing is scored"},
    )
    monkeypatch.setitem(INTERFACES, "fake", entry)


def test_a_name_is_read_into_base_ablation_options_and_gain():
    method = Method.parse("fake-notouch:n_pure=2+seeds=draft/mean+levels=0.5@0.7")
    assert (method.base, method.ablation, method.gain) == ("fake", "notouch", 0.7)
    assert dict(method.options) == {"n_pure": 2, "seeds": ("draft", "mean"), "levels": (0.5,)}
    assert Method.parse("press:0.7").options == (("force", 0.7),)
    assert Method.parse("press:2+blocked=True").options == (("force", 2.0), ("blocked", True))
    assert Method.parse("raw") == Method("raw", "", (), 1.0)


@pytest.mark.parametrize(
    ("name", "canonical"),
    [
        ("raw@1", "raw"),
        ("press:force=0.70", "press:0.7"),
        ("press:blocked=False+2e1@.50", "press:20+blocked=False@0.5"),
        ("press:force=1e300", "press:1e300"),
        ("fake:use_touch=True+n_pure=16", "fake:n_pure=16+use_touch=True"),
        ("fake-noscore:seeds=draft/0.5@0.25", "fake-noscore:seeds=draft/0.5@0.25"),
        ("projection:speed=0.00015", "projection:speed=0.00015"),
    ],
)
def test_equal_methods_have_one_name_however_they_were_written(name, canonical):
    assert Method.parse(name).name == canonical
    assert Method.parse(canonical) == Method.parse(name)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("psychic", r"Unknown interface 'psychic' in 'psychic'\. Valid: joint, raw, press"),
        ("clip", "Unknown interface 'clip'"),
        ("", "Unknown interface ''"),
        ("fake-noluck", r"Unknown ablation 'noluck' .* Valid of 'fake': notouch, noscore"),
        ("fake-", "Unknown ablation ''"),
        ("raw-notouch", r"Unknown ablation 'notouch' .* Valid of 'raw': none"),
        ("raw:0.5", r"Unknown option '0\.5' .* Valid of 'raw': none"),
        ("press:speed=3", r"Unknown option 'speed=3' .* Valid of 'press': force=\.\.\., release=\.\.\."),
        ("fake:0.2", r"Unknown option '0.2' .* Valid of 'fake': levels=\.\.\., n_pure=\.\.\."),
        ("fake:", r"Unknown option '' .* levels=\.\.\."),
        ("press:", r"`force` in 'press:' must be a number\. Got ''"),
        ("press:0.5+force=0.6", r"Repeated option 'force=0\.6'"),
        ("press:nan", r"`force` in 'press:nan' must be a number\. Got 'nan'"),
        ("fake:n_pure=1.5", r"`n_pure` .* must be a whole number\. Got '1\.5'"),
        ("press:blocked=no", r"`blocked` .* must be True or False\. Got 'no'"),
        ("fake:levels=0.5/x", r"`levels` .* must be numbers with '/' between them\. Got '0\.5/x'"),
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


@pytest.mark.parametrize("name", ["joint", "raw", "press"])
def test_an_entry_names_exactly_what_its_interface_takes(name):
    entry = INTERFACES[name]
    taken = set(inspect.signature(getattr(import_module(entry.module), entry.maker)).parameters)
    assert taken == {"hand", *entry.options}
    assert not entry.main_option or entry.main_option in entry.options


def test_the_options_of_the_projection_are_its_settings():
    assert list(INTERFACES["projection"].options) == [each.name for each in fields(ProjectionSettings)]


def test_options_reach_the_interface_and_leave_the_others_as_they_are():
    press = make_interface(
        LEAP, "press:2.5+blocked=True+release=0.004+smoothing=0.4+servo=0.001+back=0+limit=0.01"
    )
    found = vars(press.settings), press._grip.servo  # pyright: ignore[reportAttributeAccessIssue]
    assert found[0] == {"force": 2.5, "release": 0.004, "blocked": True, "smoothing": 0.4}
    assert (found[1].gain, found[1].back, found[1].limit) == (0.001, 0.0, 0.01)


def test_a_gain_is_set_and_a_plain_name_leaves_one():
    made = make_interface(LEAP, "press:2@0.5")
    assert (made.name, made.gain) == ("press:2@0.5", 0.5)  # pyright: ignore[reportAttributeAccessIssue]
    assert make_interface(LEAP, "press:2@1").gain == 1.0  # pyright: ignore[reportAttributeAccessIssue]


def test_a_version_follows_a_methods_own_modules_only():
    modules = {name: Method.parse(name).modules for name in ("raw", "press:1", "press:2", "projection")}
    digests = {name: code_digest(found) for name, found in modules.items()}
    assert digests["press:1"] == digests["press:2"]
    assert len(set(digests.values())) == 3
    for other in ("press", "grip", "projection", "touch_watch", "entries", "learned"):
        assert f"lerobot_dexflex.interfaces.{other}" not in imported(modules["raw"])
    assert not any("controller." in each for each in imported(modules["projection"]))


def test_the_weights_of_a_method_are_the_files_that_decide(tmp_path):
    assert Method.parse("press").weights(LEAP, tmp_path) == ()
    with pytest.raises(
        DexFlexError, match=r"No controller for 'leap' at .*config\.json, fake\.safetensors not found"
    ):
        Method.parse("fake").weights(LEAP, tmp_path)
    for name in ("config.json", "fake.safetensors"):
        (tmp_path / name).touch()
    names = [path.name for path in Method.parse("fake-notouch@0.4").weights(LEAP, tmp_path)]
    assert names == ["config.json", "fake.safetensors"]
    with pytest.raises(DexFlexError, match="No controller for"):
        Method.parse("fake").weights(LEAP, tmp_path / "nowhere")


def test_a_name_is_registered_once():
    with pytest.raises(DexFlexError, match="There is an interface 'raw' already"):
        register("raw", InterfaceEntry("somewhere", "Something", "draft"))
    with pytest.raises(DexFlexError, match="Got 'no-go'"):
        register("no-go", InterfaceEntry("somewhere", "Something", "draft"))


def test_an_operator_needs_an_interface_that_reads_drafts():
    assert require_drafts("press:0.5").base == "press"
    with pytest.raises(DexFlexError, match=r"must be one that reads drafts: raw, press, .* Got 'joint'"):
        require_drafts("joint")
