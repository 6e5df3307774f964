"""Why a learned interface did what it did in a control step, for logs, plots and people."""

from dataclasses import dataclass
from typing import Any, NamedTuple

from torch import Tensor

from lerobot_dexflex.controller.chunks import BRANCHES
from lerobot_dexflex.interfaces.draft_watch import DRAFT_HEALTH
from lerobot_dexflex.interfaces.touch_watch import TOUCH_HEALTH

STILL = 0.002
"""Regularises the relative size of an intervention where the draft stands still [m]."""
_LIKELY = 0.5


def relative_change(selected: Tensor, asked: Tensor) -> Tensor:
    """Return ||selected - asked|| / (||asked|| + 2 mm) over the fingertips; both (batch, fingers, 3) [m]."""
    size = asked.flatten(1).norm(dim=1) + STILL
    return (selected - asked).flatten(1).norm(dim=1) / size


class Choice(NamedTuple):
    """The decision among candidates that the hand is executing, and what the raw draft would have meant."""

    branch: Tensor
    """Index into `BRANCHES` of the chosen candidate. Shape (batch,)."""
    score: Tensor
    """Score of the chosen candidate. Shape (batch,)."""
    draft_score: Tensor
    """Score of the raw draft, candidate or not. Shape (batch,)."""
    contact_loss: Tensor
    """Dreamed probability that a finger loses contact within the horizon. Shape (batch, fingers)."""
    draft_contact_loss: Tensor
    """The same for the raw draft."""
    slip: Tensor
    """Dreamed probability that a finger slips along the object. Shape (batch, fingers)."""
    draft_slip: Tensor
    """The same for the raw draft."""
    grasp_loss: Tensor
    """Dreamed probability of losing the grasp within the horizon. Shape (batch,)."""
    draft_grasp_loss: Tensor
    """The same for the raw draft."""


@dataclass(frozen=True)
class Explanation:
    """One control step of a learned interface."""

    fingers: tuple[str, ...]
    """What people call the hand's fingers, in the order of all tensors."""
    intervention: Tensor
    """||selected - draft|| / (||draft|| + 2 mm) over the fingertips, both without squeeze. (batch,)."""
    touch_health: Tensor
    """Index into `TOUCH_HEALTH` per finger. Shape (batch, fingers)."""
    draft_health: Tensor
    """Index into `DRAFT_HEALTH`. Shape (batch,)."""
    squeeze: Tensor
    """What of every step of the draft commanded into the object and was replaced by the grip [m], palm frame;
    zero for a source of motion. Shape (batch, fingers, 3)."""
    free: Tensor
    """Fingers that followed the draft as it came, without grip; see `FreeFingers`. (batch, fingers) bool."""
    forces: Tensor | None = None
    """Forces of the grip [N], palm frame, (batch, fingers, 3); None for an interface that supplies none."""
    choice: Choice | None = None
    """None for an interface that chooses among no candidates."""

    def row(self, index: int) -> dict[str, Any]:
        """Return one hand's explanation as plain numbers and names, ready for JSON."""
        found: dict[str, Any] = {
            "intervention": self.intervention[index].item(),
            "touch_health": {f: TOUCH_HEALTH[k] for f, k in self._named(self.touch_health[index]).items()},
            "draft_health": DRAFT_HEALTH[int(self.draft_health[index])],
            "squeeze": self._named(self.squeeze[index].norm(dim=-1)),
            "free": self._named(self.free[index]),
        }
        if self.forces is not None:
            found["grip"] = self._named(self.forces[index].norm(dim=-1))
        if self.choice is not None:
            found["branch"] = BRANCHES[int(self.choice.branch[index])]
            for name in ("score", "draft_score", "grasp_loss", "draft_grasp_loss"):
                found[name] = getattr(self.choice, name)[index].item()
            for name in ("contact_loss", "draft_contact_loss", "slip", "draft_slip"):
                found[name] = self._named(getattr(self.choice, name)[index])
        return found

    def _named(self, values: Tensor) -> dict[str, Any]:
        """Return a value of every finger, (fingers,), by the fingers' names."""
        return dict(zip(self.fingers, values.tolist(), strict=True))

    def sentence(self, index: int) -> str:
        """Return one hand's explanation as a sentence for a person."""
        row = self.row(index)
        parts = [f"changed the draft by {100 * row['intervention']:.0f} %"]
        if "branch" in row:
            parts[0] = f"{row['branch']} chosen, {parts[0]}"
            at_risk = [f for f, p in row["draft_contact_loss"].items() if p > _LIKELY]
            saved = [f for f in at_risk if row["contact_loss"][f] <= _LIKELY]
            if saved:
                parts.append(f"the draft would lose contact of {', '.join(saved)}")
            if row["draft_grasp_loss"] > _LIKELY >= row["grasp_loss"]:
                parts.append("the draft would lose the grasp")
        if free := [f for f, is_free in row["free"].items() if is_free]:
            parts.append(f"{', '.join(free)} free")
        squeezing = [f for f, size in row["squeeze"].items() if size]
        if squeezing:
            parts.append(f"the squeeze of {', '.join(squeezing)} replaced")
        sick = [f"{f} {health}" for f, health in row["touch_health"].items() if health != "ok"]
        if sick:
            parts.append(f"touch of {', '.join(sick)}")
        if row["draft_health"] != "ok":
            parts.append(f"draft {row['draft_health']}")
        return "; ".join(parts)
