"""Execute episodes whose commands are corrupted: as they are, or through an interface."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.loop import stack_observations
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.corpus.distortion import Distortion
from lerobot_dexflex.corpus.episode import Leader, RunningEpisode
from lerobot_dexflex.interfaces.protocol import Interface

Array = NDArray[np.float64]


class Driven(NamedTuple):
    """An episode and who commands it."""

    run: RunningEpisode
    leader: Leader
    distortion: Distortion


def run_raw(driven: Driven) -> None:
    """Run an episode whose displacements are executed as they are, corrupted or clean by turns."""
    run, leader, distortion = driven
    while (label := leader.label(run)) is not None:
        draft, corrupted = distortion.step(label, run.now)
        run.step(draft, label, draft if corrupted else label)


def run_interface(waiting: Iterator[Driven], interface: Interface, batch: int) -> Iterator[Driven]:
    """Run episodes through an interface, up to `batch` at once, and yield them as they end.

    It is asked for the label itself in clean stretches; it executes what it chooses in all of them.

    Args:
        waiting: The episodes.
        interface: What executes the drafts; it is reset.
        batch: Number of hands side by side.
    """
    interface.reset()
    rows: list[Driven | None] = [None] * batch
    fresh = np.zeros(batch, bool)
    while True:
        labels: dict[int, Array] = {}
        for k in range(batch):
            while k not in labels and (driven := rows[k] or next(waiting, None)):
                rows[k], label = driven, driven.leader.label(driven.run)
                if label is None:
                    rows[k], fresh[k] = None, True
                    yield driven
                else:
                    labels[k] = label
        running = {k: row for k, row in enumerate(rows) if row is not None}
        if not running:
            return
        drafts = {}
        for k, (run, _, distortion) in running.items():
            draft, corrupted = distortion.step(labels[k], run.now)
            drafts[k] = draft if corrupted else labels[k]
        joints, tips = _ask({k: row.run for k, row in running.items()}, drafts, interface, fresh)
        fresh[:] = False
        for k, (run, _, _) in running.items():
            run.step(drafts[k], labels[k], tips[k] - run.command, joints[k])


def _ask(
    running: dict[int, RunningEpisode],
    drafts: dict[int, Array],
    interface: Interface,
    fresh: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """Return the interface's joints [rad] (batch, 16) and commanded tips [m] (batch, 4, 3)."""
    rows = range(len(fresh))
    # Rows that have ended show another hand, so that the batch keeps its size.
    spare = next(iter(running))
    shown = [running.get(k, running[spare]) for k in rows]
    observation = stack_observations([run.observation for run in shown])
    if fresh.any():
        interface.reset(torch.from_numpy(fresh))
    interface.start(observation, torch.from_numpy(np.stack([run.env.command for run in shown])))
    held = torch.from_numpy(np.stack([drafts.get(k, drafts[spare]) for k in rows]))
    joints = interface.step(observation, held[:, None].expand(-1, DRAFT_HORIZON, -1, -1))
    assert interface.command is not None
    return joints.double().numpy(), interface.command.double().numpy()
