"""Register the tasks with Gymnasium by string entry points, so that importing costs nothing."""

from collections.abc import Iterable
from typing import NamedTuple

import gymnasium

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import xarm7
from lerobot_dexflex.hands import Hand

NAMESPACE = "lerobot_dexflex"


class TaskInfo(NamedTuple):
    """What is known of a task without building it."""

    entry_point: str
    """`module:class` of the environment."""
    max_episode_steps: int
    """Time limit in control steps (20 Hz)."""
    description: str
    """Language instruction given to policies."""
    arm: bool = True
    """Whether an arm carries the hand; without it the palm is fixed in the world."""
    stages: tuple[str, ...] = ()
    """What progress 1/n, 2/n, ... 1 stand for, where progress comes in stages."""

    @property
    def module(self) -> str:
        """Module of the environment."""
        return self.entry_point.partition(":")[0]

    def joints(self, hand: Hand) -> tuple[str, ...]:
        """Return the names of the joints whose targets are the action: the arm's, then the hand's."""
        arm = [link.joint for link in xarm7.LINKS] if self.arm else []
        return (*arm, *hand.joint_names)


TASKS = {
    "AssembleTable-v0": TaskInfo(
        "lerobot_dexflex.envs.assemble_table:AssembleTableEnv",
        500,
        "Screw the leg into the table top until it lights up.",
        stages=("held", "lifted", "over the socket", "in the thread", "lit", "let go"),
    ),
    "BrushSweep-v0": TaskInfo(
        "lerobot_dexflex.envs.brush_sweep:BrushSweepEnv",
        400,
        "Pick up the brush and sweep the balls into the dustpan.",
    ),
    "FlipToast-v0": TaskInfo(
        "lerobot_dexflex.envs.flip_toast:FlipToastEnv",
        500,
        "Pick up the spatula and turn the slice of toast over on the griddle.",
    ),
    "HammerNail-v0": TaskInfo(
        "lerobot_dexflex.envs.hammer_nail:HammerNailEnv",
        400,
        "Pick up the hammer and drive the nail in.",
    ),
    "PlaceHammer-v0": TaskInfo(
        "lerobot_dexflex.envs.place_hammer:PlaceHammerEnv",
        300,
        "Pick up the hammer and hang it in the holder.",
        stages=("held", "lifted", "upright", "at the holder", "hung", "let go"),
    ),
    "PourCup-v0": TaskInfo(
        "lerobot_dexflex.envs.pour_cup:PourCupEnv",
        400,
        "Pour the balls into the bowl and put the pitcher down.",
        stages=("held", "lifted", "over the bowl", "poured", "set down", "let go"),
    ),
    "Reach-v0": TaskInfo(
        "lerobot_dexflex.envs.reach:ReachEnv",
        200,
        "Move the object in the hand to the goal pose.",
        arm=False,
    ),
    "ScrewNut-v0": TaskInfo(
        "lerobot_dexflex.envs.screw_nut:ScrewNutEnv",
        500,
        "Set the nut straight on the bolt and turn it tight with the fingers.",
        stages=("held", "on the thread", "a third turned", "two thirds turned", "tight", "still held"),
    ),
    "Screwdriver-v0": TaskInfo(
        "lerobot_dexflex.envs.screwdriver:ScrewdriverEnv",
        500,
        "Turn the screw tight with the screwdriver.",
        stages=("held", "lifted", "in the screw", "half turned", "tight", "still held"),
    ),
    "SpatulaServe-v0": TaskInfo(
        "lerobot_dexflex.envs.spatula_serve:SpatulaServeEnv",
        400,
        "Pick up the spatula, lift the patty off the griddle and serve it on the plate.",
        stages=("held", "lifted", "under the patty", "patty lifted", "over the plate", "served"),
    ),
}

TOOLS = (
    *("BrushSweep-v0", "ScrewNut-v0", "HammerNail-v0"),
    *("Screwdriver-v0", "SpatulaServe-v0", "FlipToast-v0"),
)
"""Tasks for people who lead the hand through an interface, in the order of the paper."""


def register_tasks() -> None:
    """Register every task as `lerobot_dexflex/<Task>`; calling it twice is harmless."""
    for name, task in TASKS.items():
        gym_id = f"{NAMESPACE}/{name}"
        if gym_id not in gymnasium.registry:
            gymnasium.register(gym_id, entry_point=task.entry_point, max_episode_steps=task.max_episode_steps)


def check_tasks(names: Iterable[str]) -> None:
    """Refuse names that are no tasks.

    Raises:
        DexFlexError: If one is unknown.
    """
    if strangers := [name for name in names if name not in TASKS]:
        raise DexFlexError(f"Unknown task {strangers[0]!r}. Valid tasks: {', '.join(TASKS)}.")
