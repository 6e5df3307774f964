"""An upper bound for selection: our own candidates, tried out in the simulator before one is executed."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.loop import Slot
from lerobot_dexflex.controller import DexFlexController, SelectionSettings
from lerobot_dexflex.controller.projection import project_draft
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface
from lerobot_dexflex.interfaces.explanation import Choice
from lerobot_dexflex.interfaces.learned import Sensed
from lerobot_dexflex.interfaces.plan import Plan

Reference = Literal["draft", "clean"]
Array = NDArray[np.float64]

FEW = SelectionSettings(n_pure=8, n_seeded=7, prefix=2)
"""Sixteen candidates, tried out at every second step: an episode takes seconds instead of minutes."""
LOST_GRASP, LOST_FINGER = 1000.0, 40.0
"""Cost of holding with fewer than two fingers at any step, and of each loaded finger that ends unloaded,
beside the mean squared distance of commanded fingertips [mm^2]."""


class OracleInterface(DexFlexInterface):
    """Choose the candidate whose true outcome is best and that is nearest to a reference. `Privileged`.

    It shows what better consequence prediction and scoring could still give with the same candidates. The
    chunk is executed without the decoder's correction.

    Args:
        controller: Proposes the candidates.
        reference: Near to what: the draft; or the operator's clean command, held over the horizon.
        moving: Steps of a chunk that are tried before holding still: 8 asks what the whole chunk would do,
            2 what is executed of it.
        settings: How candidates are proposed; `FEW` if None.

    Raises:
        DexFlexError: If the reference is unknown, or `moving` is not in [1, 8].
    """

    name: str = "oracle"

    def __init__(
        self,
        controller: DexFlexController,
        reference: Reference = "draft",
        moving: int = DRAFT_HORIZON,
        settings: SelectionSettings | None = None,
    ) -> None:
        if reference not in ("draft", "clean"):
            raise DexFlexError(f"`reference` must be 'draft' or 'clean'. Got {reference!r}.")
        if moving not in range(1, DRAFT_HORIZON + 1):
            raise DexFlexError(
                f"`moving` must be a number of steps from 1 to {DRAFT_HORIZON}. Got {moving!r}."
            )
        super().__init__(controller, settings or FEW)
        self._reference, self._moving = reference, moving
        self._slots: Sequence[Slot | None] = ()

    def see(self, slots: Sequence[Slot | None]) -> None:
        """Look at the running episodes; see `Privileged`."""
        self._slots = slots

    def _choose(self, sensed: Sensed) -> Plan:
        draft, settings, history = sensed.draft.draft.float(), self.settings, sensed.history
        past = sensed.drafts_history
        repaired = project_draft(draft, history, past, settings.projection) if settings.project else None
        candidates = self.controller.propose(self._encode(history), draft, past, settings, repaired=repaired)
        chunks = candidates.chunks
        best = torch.zeros(len(chunks), dtype=torch.int64)
        cost, lost, grasp = (
            torch.zeros(2, len(chunks)),
            torch.zeros(2, len(chunks), 4),
            torch.zeros(2, len(chunks)),
        )
        due = self._plan.age >= self.settings.prefix if self._plan is not None else None
        for k, slot in enumerate(self._slots):
            if slot is None or (due is not None and not due[k]):
                continue
            wanted = draft[k].double().numpy()
            if self._reference == "clean":
                wanted = np.broadcast_to(slot.label, wanted.shape)
            tried = try_out(slot, chunks[k].double().numpy(), wanted, self._moving)
            best[k] = int(np.argmin(tried[0]))
            for series, values in zip((cost, lost, grasp), tried, strict=True):
                # The draft is the first candidate; without it, the first one stands in its place.
                series[:, k] = torch.from_numpy(values[[int(best[k]), 0]])
        choice = Choice(candidates.branch[best], -cost[0], -cost[1], lost[0], lost[1], grasp[0], grasp[1])
        rows = torch.arange(len(best))
        return Plan(chunks[rows, best], torch.zeros(len(best), 16), choice, torch.zeros_like(best))


def try_out(
    slot: Slot, chunks: Array, wanted: Array, moving: int = DRAFT_HORIZON
) -> tuple[Array, Array, Array]:
    """Execute chunks as `raw` would, each from the state now, and return there.

    Args:
        slot: A running episode.
        chunks: Displacements of the commanded fingertips [m]. Shape (N, H, 4, 3).
        wanted: The displacements to be near to [m]. Shape (H, 4, 3).
        moving: Steps of both before holding still.

    Returns:
        Cost (N,), whether each finger lost its load (N, 4), whether the grasp was lost (N,); as floats.
    """
    held = slot.held
    env, snapshot = held.env, held.env.snapshot()
    loaded = slot.state.loads > CONTACT_FORCE
    moves = np.arange(len(wanted)) < moving
    goal = np.cumsum(wanted * moves[:, None, None], 0)
    cost, lost, grasp = np.zeros(len(chunks)), np.zeros((len(chunks), 4)), np.zeros(len(chunks))
    for n, chunk in enumerate(chunks):
        env.restore(snapshot)
        joints, path = held.joints, np.cumsum(chunk * moves[:, None, None], 0)
        least, loads = 4, slot.state.loads
        for offset in path:
            joints = kernels.solve_fingertips(held.command + offset, joints)
            env.advance(joints)
            loads = held.senses.read().loads
            least = min(least, int((loads > CONTACT_FORCE).sum()))
        lost[n] = loaded & (loads <= CONTACT_FORCE)
        grasp[n] = least < min(2, int(loaded.sum()))
        distance = 1e6 * float(np.square(path - goal).sum(-1).mean())
        cost[n] = distance + LOST_GRASP * grasp[n] + LOST_FINGER * lost[n].sum()
    env.restore(snapshot)
    return cost, lost, grasp
