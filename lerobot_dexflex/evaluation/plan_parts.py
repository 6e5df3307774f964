"""The parts of a policy's plan, and which of them an interface executes.

A plan holds joint targets of the arm and, for the hand, what the policy learned of three parts: joint
targets, commanded fingertips and measured ones. Every interface executes its part of the same plan.
"""

from collections.abc import Sequence

from lerobot_dexflex.conventions import COMMANDED, MEASURED
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces import INTERFACES, Method

JOINT = "joint"
PARTS = (JOINT, COMMANDED, MEASURED)
"""Of the hand, in the order in which a plan holds them."""
OLD_LAYOUT = (
    "This checkpoint is from before one policy learned all parts of a plan, and cannot be loaded any more. "
    "Train again: lerobot-train --config_path=configs/policy/place_hammer.yaml, or that of its task."
)
_MEANING = {JOINT: "joint targets", COMMANDED: "commanded fingertips", MEASURED: "measured fingertips"}


def executed_part(learns: Sequence[str], method: Method, draft: str = "") -> str:
    """Return the part of a plan that an interface executes.

    Args:
        learns: Parts that the policy learned.
        method: The interface.
        draft: Which fingertips interfaces that read drafts execute; empty means the measured ones, or the
            commanded ones if only these were learned. `joint` has no use for it.

    Raises:
        DexFlexError: If the policy did not learn that part.
    """
    if method.command_space == "joint":
        part = JOINT
    else:
        part = draft or next((tips for tips in (MEASURED, COMMANDED) if tips in learns), MEASURED)
    if part in learns:
        return part
    tips = [other for other in learns if other != JOINT]
    if part == JOINT:
        fitting = [name for name, entry in INTERFACES.items() if entry.command_space == "draft"]
        choice = f"Choose --policy.interface={'|'.join(fitting)}"
    else:
        choice = f"Choose --policy.draft={tips[0]}" if tips else "Choose --policy.interface=joint"
    everything = ",".join(other for other in PARTS if other in (*learns, part))
    raise DexFlexError(
        f"The interface {method.name!r} executes {_MEANING[part]}, but this policy learned "
        f"{' and '.join(_MEANING[other] for other in learns)} only. {choice}, or train a policy with "
        f"--policy.learns=[{everything}]."
    )
