"""The entries of all action interfaces.

The registry imports this by name, so that a new entry is no new version of every method: a method's version
follows its own module (`runs.provenance`).
"""

from collections.abc import Mapping

from lerobot_dexflex.interfaces.controller_folder import CONTROLLER_FILES
from lerobot_dexflex.interfaces.options import NUMBER, NUMBERS, SWITCH, WHOLE, WORDS, Kind
from lerobot_dexflex.interfaces.registry import InterfaceEntry, register

_HERE = "lerobot_dexflex.interfaces"
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
