"""All action interfaces by name, with what they take and need; known without importing them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.options import NUMBER, NUMBERS, SWITCH, WHOLE, WORDS, Kind
from lerobot_dexflex.interfaces.protocol import CommandSpace

_HERE = "lerobot_dexflex.interfaces"
CONTROLLER_FILES = ("config.json", "model.safetensors")
"""Files of a controller's folder that decide what its networks do."""
SELECTION_OPTIONS: Mapping[str, Kind] = {
    "n_pure": WHOLE,
    "n_seeded": WHOLE,
    "include_draft": SWITCH,
    "project": SWITCH,
    "contact_bias": NUMBER,
    "levels": NUMBERS,
    "seeds": WORDS,
    "nfe": WHOLE,
    "prefix": WHOLE,
    "temperature": NUMBER,
    "use_score": SWITCH,
    "use_dream": SWITCH,
    "use_touch": SWITCH,
    "use_slow": SWITCH,
    "use_residual": SWITCH,
    "output_gain": NUMBER,
    "seed": WHOLE,
}
"""Fields of `SelectionSettings` that a method's name may set."""


@dataclass(frozen=True)
class InterfaceEntry:
    """Where an interface lives, what it takes and what it needs."""

    module: str
    """Full name of its module."""
    maker: str
    """Class in the module, or function that returns the interface, called with the options; also with
    `controller` if there are `files`, and with `ablation` if there are ablations."""
    command_space: CommandSpace
    """What its drafts are."""
    files: tuple[str, ...] = ()
    """Files of a trained controller's folder that it needs; none if it is not learned."""
    main_option: str = ""
    """What an option without a key means."""
    options: Mapping[str, Kind] = field(default_factory=dict)
    """What it takes, by key."""
    ablations: Mapping[str, str] = field(default_factory=dict)
    """Its variants that lack something, and what they lack."""


INTERFACES: dict[str, InterfaceEntry] = {}


def register(name: str, entry: InterfaceEntry) -> None:
    """Make an interface known by a name.

    Raises:
        DexFlexError: If the name is taken or cannot be part of a method's name.
    """
    if name in INTERFACES:
        raise DexFlexError(f"There is an interface {name!r} already: {INTERFACES[name].module}.")
    if not name.isidentifier():
        raise DexFlexError(f"An interface's name must be letters, digits and '_'. Got {name!r}.")
    INTERFACES[name] = entry


register("joint", InterfaceEntry(f"{_HERE}.joint", "JointInterface", "joint"))
register("raw", InterfaceEntry(f"{_HERE}.raw", "RawInterface", "draft"))
register(
    "filter",
    InterfaceEntry(
        f"{_HERE}.filter", "FilterInterface", "draft", options={"smoothing": NUMBER, "clip": NUMBER}
    ),
)
register("hold", InterfaceEntry(f"{_HERE}.hold", "HoldInterface", "draft"))
register(
    "shrink",
    InterfaceEntry(
        f"{_HERE}.shrink", "ShrinkInterface", "draft", main_option="gain", options={"gain": NUMBER}
    ),
)
register(
    "clip",
    InterfaceEntry(f"{_HERE}.clip", "ClipInterface", "draft", main_option="limit", options={"limit": NUMBER}),
)
register("reflex", InterfaceEntry(f"{_HERE}.reflex", "ReflexInterface", "draft"))
register(
    "dexgen",
    InterfaceEntry(
        f"{_HERE}.dexgen",
        "DexGenInterface",
        "draft",
        files=(*CONTROLLER_FILES, "dexgen.safetensors"),
        main_option="guidance",
        options={
            "guidance": NUMBER,
            "steps": WHOLE,
            "use_touch": SWITCH,
            "output_gain": NUMBER,
            "seed": WHOLE,
        },
    ),
)
register(
    "dexflex",
    InterfaceEntry(
        f"{_HERE}.dexflex",
        "make_dexflex",
        "draft",
        files=CONTROLLER_FILES,
        options=SELECTION_OPTIONS,
        ablations={
            "noscore": "the proposal nearest to the draft is executed instead of the best scored one",
            "notouch": "its touch is hidden",
            "noconsequence": "score and decoder do not see the predicted outcome",
            "nopure": "no proposal ignores the draft",
            "noseeded": "no proposal starts from the draft, and neither it nor its projection is one",
            "noslow": "the slow token is hidden",
        },
    ),
)
