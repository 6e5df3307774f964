"""How well the controller chooses: its own candidates, tried out in the simulator where it decides.

Unlike under the oracle nothing that was tried is executed, so the states are those that `dexflex` reaches.
What the score picks can then be held against what would have been best.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands.loop import MAX_STEPS, Slot, run_chains
from lerobot_dexflex.controller import DexFlexController, Selection, SelectionSettings, State
from lerobot_dexflex.controller.chunks import CONTACT, DRAFT, distance_to
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.degraded.cells import Cell
from lerobot_dexflex.evaluation.degraded.methods import shared_controller
from lerobot_dexflex.evaluation.degraded.oracle import try_out
from lerobot_dexflex.evaluation.degraded.runner import Benchmark
from lerobot_dexflex.evaluation.provenance import environment_identity, session_provenance
from lerobot_dexflex.evaluation.statistics import mean_interval
from lerobot_dexflex.evaluation.store import Store
from lerobot_dexflex.evaluation.whole_jobs import WholeJob, run_missing
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.interfaces.controller_folder import DEXFLEX_FILES, controller_digest, find_controller
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface
from lerobot_dexflex.interfaces.explanation import Choice
from lerobot_dexflex.training.metrics import roc_auc

EVERY = 8
"""Control steps between two decisions that are judged."""
GROUP = 8
"""Episodes of a job, side by side."""
CHOOSERS = ("oracle", "dexflex", "projection", "score", "nearest", "draft", "average")
"""Who could have chosen: the simulator; the interface; always the contact projection; the score without the
projection's bonus; the chunk nearest to the draft, but the draft; always the draft; nobody."""
METRICS = ("cost", "distance_mm", "lost_fingers", "lost_grasp")

Array = NDArray[np.float64]


@dataclass
class Judgements(WholeJob):
    """The decisions of a group of episodes."""

    cell: str
    number: int
    chain: list[int] = field(default_factory=list)
    """Seed of the chain of each decision."""
    outcome: dict[str, list[list[float]]] = field(default_factory=lambda: {name: [] for name in CHOOSERS})
    """What each chooser's chunk leads to, per decision: `METRICS`, of which the cost is `try_out`'s."""
    contact: list[tuple[float, bool]] = field(default_factory=list)
    """Of every loaded finger under every candidate: the dreamed probability to lose it, and whether it is."""
    grasp: list[tuple[float, bool]] = field(default_factory=list)
    """The same of the grasp."""

    @property
    def job(self) -> Hashable:
        """What was run together."""
        return self.cell, self.number


class JudgedInterface(DexFlexInterface):
    """Does what `dexflex` does and tries out the candidates of some of its decisions. `Privileged`.

    Args:
        controller: Proposes, dreams and scores.
        judgements: Where the outcomes go.
        settings: How candidates are proposed and chosen; the draft and its projection must be among them.
    """

    def __init__(
        self,
        controller: DexFlexController,
        judgements: Judgements,
        settings: SelectionSettings | None = None,
    ) -> None:
        super().__init__(controller, settings)
        if not (self.settings.include_draft and self.settings.project):
            raise DexFlexError("To judge choices, the draft and its projection must be candidates.")
        self._judgements = judgements
        self._slots: Sequence[Slot | None] = ()

    def see(self, slots: Sequence[Slot | None]) -> None:
        """Look at the running episodes; see `Privileged`."""
        self._slots = slots

    def _explain(self, state: State, draft: Tensor, drafts_history: Tensor, selection: Selection) -> Choice:
        chosen = choices(selection, draft, self.settings.contact_bias)
        for k, slot in enumerate(self._slots):
            if slot is not None and (slot.steps - 1) % EVERY == 0:
                self._judge(slot, selection, k, {name: int(index[k]) for name, index in chosen.items()})
        return super()._explain(state, draft, drafts_history, selection)

    def _judge(self, slot: Slot, selection: Selection, row: int, chosen: dict[str, int]) -> None:
        chunks = selection.candidates.chunks[row].double().numpy()
        wanted = np.broadcast_to(slot.label, chunks.shape[1:])
        cost, lost, grasp = try_out(slot, chunks, wanted)
        apart = np.cumsum(chunks - wanted, 1)
        distance = 1e3 * np.sqrt(np.square(apart).sum(-1).mean((1, 2)))
        table = np.stack([cost, distance, lost.sum(1), grasp], 1)  # (candidates, metrics)
        rows = {name: table[index] for name, index in chosen.items()}
        rows |= {"oracle": table[cost.argmin()], "average": table.mean(0)}
        found = self._judgements
        found.chain.append(slot.episode.chain.seed)
        for name in CHOOSERS:
            found.outcome[name].append(np.round(rows[name], 4).tolist())
        loaded = np.broadcast_to(slot.state.loads > CONTACT_FORCE, lost.shape)
        dreamed = selection.dream.contact_loss[row].double().numpy()
        found.contact += _pairs(dreamed[loaded], lost[loaded])
        found.grasp += _pairs(selection.dream.grasp_loss[row].double().numpy(), grasp)


def choices(selection: Selection, draft: Tensor, bias: float) -> dict[str, Tensor]:
    """Return which candidate each chooser takes, shape (batch,), all but `oracle` and `average`.

    Args:
        selection: A decision.
        draft: Shape (batch, horizon, 4, 3) [m].
        bias: What was added to the projection's score.
    """
    chunks, branch = selection.candidates.chunks, selection.candidates.branch
    at = {kind: int((branch == kind).nonzero()[0]) for kind in (DRAFT, CONTACT)}
    apart = distance_to(chunks, draft).masked_fill(branch == DRAFT, torch.inf)
    return {
        "dexflex": selection.best,
        "projection": torch.full_like(selection.best, at[CONTACT]),
        "score": (selection.score - bias * (branch == CONTACT)).argmax(1),
        "nearest": apart.argmin(1),
        "draft": torch.full_like(selection.best, at[DRAFT]),
    }


@dataclass(frozen=True)
class Judging:
    """What to run."""

    benchmark: Benchmark
    """Cells, episodes, chains, controller and output; its methods are not used."""

    def jobs(self) -> list[tuple[str, int]]:
        """Return cells and numbers of groups."""
        groups = range(-(-self.benchmark.episodes // GROUP))
        return [(cell, number) for cell in self.benchmark.cells for number in groups]

    def identity(self) -> dict[str, Any]:
        """Return what every judgement depends on; cells and episodes are free to grow."""
        folder = find_controller(self.benchmark.controller, DEXFLEX_FILES)
        found = {"seed": self.benchmark.first_seed, "group": GROUP, "every": EVERY, "max_steps": MAX_STEPS}
        return found | {"controller": controller_digest(folder, "dexflex")} | environment_identity()

    def run_job(self, number: int) -> Judgements:
        """Run a group."""
        cell_name, group = self.jobs()[number]
        cell, benchmark = Cell.parse(cell_name), self.benchmark
        first = GROUP * group
        chains = benchmark.book(cell.verified).load(first + GROUP)[first:]
        found = Judgements(cell_name, group)
        interface = JudgedInterface(shared_controller(benchmark.controller), found)
        run_chains(chains, cell.corruption, interface, batch=GROUP)
        return found


def judge(judging: Judging, workers: int = 2, quiet: bool = False) -> dict[str, Any]:
    """Run what is missing and return the result: settings, every cell's summary, provenance.

    Args:
        judging: What to run; whole groups of `GROUP` episodes.
        workers: Worker processes; 0 works in this one.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If the output folder holds other settings or code, or the controller is missing.
        KeyboardInterrupt: After the running groups were finished and stored.
    """
    store = Store(judging.benchmark.output, judging.identity(), Judgements.parse)
    jobs = judging.jobs()
    for book in judging.benchmark.books():
        book.ensure(GROUP * (1 + max(group for _, group in jobs)), workers, quiet)
    found = run_missing(store, jobs, judging.run_job, GROUP, workers, quiet)
    return {
        "identity": judging.identity(),
        "judged": {cell: summarise(found, cell) for cell in judging.benchmark.cells},
        "provenance": session_provenance(store.sessions()),
    }


def summarise(judgements: Sequence[Judgements], cell: str) -> dict[str, Any]:
    """Return, for one cell, every chooser's outcomes, regret and agreement with the oracle.

    Means are over the episodes' means; the regret is the cost beyond the oracle's.
    """
    own = [found for found in judgements if found.cell == cell]
    chain = np.array([seed for found in own for seed in found.chain])
    tables = {name: np.array([row for found in own for row in found.outcome[name]]) for name in CHOOSERS}
    best = tables["oracle"][:, 0]
    choosers = {}
    for name, table in tables.items():
        extra = {"regret": table[:, 0] - best, "as_good": (table[:, 0] <= best).astype(float)}
        columns = dict(zip(METRICS, table.T, strict=True)) | extra
        choosers[name] = {
            key: mean_interval([float(values[chain == seed].mean()) for seed in np.unique(chain)])
            for key, values in columns.items()
        }
    return {
        "episodes": len(np.unique(chain)),
        "decisions": len(chain),
        "choosers": {
            name: {key: mean._asdict() for key, mean in found.items() if mean}
            for name, found in choosers.items()
        },
        "contact_loss_auc": _auc([pair for found in own for pair in found.contact]),
        "grasp_loss_auc": _auc([pair for found in own for pair in found.grasp]),
    }


def markdown(result: dict[str, Any]) -> str:
    """Return the result of `judge` as a table."""
    head = "| cell | chooser | regret | as good | mm from clean | lost fingers | lost grasps |"
    lines = [head, "| --- " * 7 + "|"]
    for cell, found in result["judged"].items():
        for name, numbers in found["choosers"].items():
            values = {key: numbers[key]["mean"] for key in numbers}
            lines.append(
                f"| {cell} | {name} | {values['regret']:.1f} | {100 * values['as_good']:.0f} % | "
                f"{values['distance_mm']:.2f} | {values['lost_fingers']:.3f} | {values['lost_grasp']:.3f} |"
            )
    for cell, found in result["judged"].items():
        dreamed = (found["contact_loss_auc"], found["grasp_loss_auc"])
        contact, grasp = ("-" if auc is None else f"{auc:.2f}" for auc in dreamed)
        lines.append(
            f"\n{cell}: {found['decisions']} decisions in {found['episodes']} episodes; dreamed loss of a "
            f"loaded finger, AUC {contact}; of the grasp, AUC {grasp}."
        )
    return "\n".join(lines)


def average_markdown(result: dict[str, Any]) -> str:
    """Return every chooser's outcomes, averaged over the cells, as a table."""
    cells = list(result["judged"].values())
    rows = []
    for name in CHOOSERS:
        numbers = [cell["choosers"][name] for cell in cells]
        mean = {key: sum(n[key]["mean"] for n in numbers) / len(cells) for key in numbers[0]}
        rows.append(
            f"| {name} | {mean['regret']:.0f} | {100 * mean['as_good']:.0f} % | {mean['distance_mm']:.1f} | "
            f"{mean['lost_fingers']:.2f} | {100 * mean['lost_grasp']:.0f} % |"
        )
    head = "| who chooses | regret | as good as the oracle | mm from clean | fingers lost | grasps lost |"
    return "\n".join([head, "|---|---|---|---|---|---|", *rows])


def _pairs(dreamed: Array, happened: Array) -> list[tuple[float, bool]]:
    return [(round(float(p), 3), bool(h)) for p, h in zip(dreamed, happened, strict=True)]


def _auc(pairs: list[tuple[float, bool]]) -> float | None:
    """Return the area under the ROC curve; None without both outcomes."""
    dreamed, happened = torch.tensor([p for p, _ in pairs]), torch.tensor([h for _, h in pairs])
    area = roc_auc(dreamed, happened) if len(pairs) else float("nan")
    return area if np.isfinite(area) else None
