"""The entries of all action interfaces.

The registry imports this by name, so that a new entry is no new version of every method: a method's version
follows its own module (`runs.provenance`).
"""

from collections.abc import Mapping

from lerobot_dexflex.interfaces.controller_folder import CONTROLLER_FILES
from lerobot_dexflex.interfaces.options import NUMBER, NUMBERS, SWITCH, WHOLE, Kind
from lerobot_dexflex.interfaces.registry import InterfaceEntry, register

_HERE = "lerobot_dexflex.interfaces"
SELECTION_OPTIONS: Mapping[str, Kind] = {
    "n_pure": WHOLE,
    "n_seeded": WHOLE,
    "n_finger": WHOLE,
    "include_draft": SWITCH,
    "levels": NUMBERS,
    "finger_levels": NUMBERS,
    "others_level": NUMBER,
    "nfe": WHOLE,
    "prefix": WHOLE,
    "hysteresis": NUMBER,
    "use_score": SWITCH,
    "use_dream": SWITCH,
    "use_touch": SWITCH,
    "use_slow": SWITCH,
    "use_splitter": SWITCH,
    "grip": NUMBER,
    "seed": WHOLE,
}
"""Fields of `SelectionSettings` that a method's name may set."""

register("joint", InterfaceEntry(f"{_HERE}.joint", "JointInterface", "joint"))
register("raw", InterfaceEntry(f"{_HERE}.raw", "RawInterface", "draft"))
register(
    "press",
    InterfaceEntry(
        f"{_HERE}.press",
        "make_press",
        "draft",
        main_option="force",
        options={
            "force": NUMBER,
            "release": NUMBER,
            "blocked": SWITCH,
            "smoothing": NUMBER,
            "servo": NUMBER,
            "back": NUMBER,
            "limit": NUMBER,
        },
    ),
)
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
            "use_splitter": SWITCH,
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
            "noselection": "the draft is executed, with the decoder's grip",
            "noscore": "the proposal nearest to the draft is executed instead of the best scored one",
            "notouch": "its touch is hidden",
            "noconsequence": "the score does not see the predicted outcome",
            "nopure": "no proposal ignores the draft",
            "noseeded": "all proposals ignore the draft",
            "nofinger": "no proposal changes one finger alone",
            "noslow": "the slow token is hidden",
            "nogrip": "every touching finger presses alike instead of the decoder's forces",
        },
    ),
)
register(
    "projection",
    InterfaceEntry(
        f"{_HERE}.projection",
        "make_projection",
        "draft",
        options={
            "gain": NUMBER,
            "free_gain": NUMBER,
            "internal_gain": NUMBER,
            "planned_gain": NUMBER,
            "closing_gain": NUMBER,
            "opening_load": NUMBER,
            "speed": NUMBER,
            "squeeze_gain": NUMBER,
            "preload": NUMBER,
            "return_speed": NUMBER,
        },
    ),
)
register(
    "filter",
    InterfaceEntry(
        f"{_HERE}.filter",
        "FilterInterface",
        "draft",
        main_option="share",
        options={"share": NUMBER, "limit": NUMBER},
    ),
)
