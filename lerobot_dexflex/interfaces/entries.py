"""The entries of all action interfaces.

The registry imports this by name, so that a new entry is no new version of every method: a method's version
follows its own module (`runs.provenance`).
"""

from lerobot_dexflex.interfaces.options import NUMBER, SWITCH
from lerobot_dexflex.interfaces.registry import InterfaceEntry, register

_HERE = "lerobot_dexflex.interfaces"

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
