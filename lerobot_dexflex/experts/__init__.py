"""Privileged experts that demonstrate the tasks: a script for the arm, a reactive operator in the hand."""

from importlib import import_module

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts.command import Command as Command
from lerobot_dexflex.experts.command import Expert as Expert

_EXPERTS = {
    "AssembleTable-v0": "lerobot_dexflex.experts.assemble_table:demonstrate",
    "BrushSweep-v0": "lerobot_dexflex.experts.brush_sweep:demonstrate",
    "FlipToast-v0": "lerobot_dexflex.experts.flip_toast:demonstrate",
    "HammerNail-v0": "lerobot_dexflex.experts.hammer_nail:demonstrate",
    "PlaceHammer-v0": "lerobot_dexflex.experts.place_hammer:demonstrate",
    "PourCup-v0": "lerobot_dexflex.experts.pour_cup:demonstrate",
    "ScrewNut-v0": "lerobot_dexflex.experts.screw_nut:demonstrate",
    "Screwdriver-v0": "lerobot_dexflex.experts.screwdriver:demonstrate",
    "SpatulaServe-v0": "lerobot_dexflex.experts.spatula_serve:demonstrate",
}


def make_expert(task: str) -> Expert:
    """Return the expert of a task.

    Raises:
        DexFlexError: If the task has no expert.
    """
    module, function = _entry(task)
    return getattr(import_module(module), function)


def expert_module(task: str) -> str:
    """Return the module of a task's expert; raises as `make_expert`."""
    return _entry(task)[0]


def _entry(task: str) -> list[str]:
    if task not in _EXPERTS:
        raise DexFlexError(f"No expert for task {task!r}. Tasks with an expert: {sorted(_EXPERTS)}.")
    return _EXPERTS[task].split(":")
