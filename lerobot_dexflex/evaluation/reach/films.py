"""Film and record one episode under several methods, run again for that purpose."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lerobot_dexflex.commands.loop import Slot, run_chains
from lerobot_dexflex.envs.rendering import Camera
from lerobot_dexflex.evaluation.policies import ObservedInterface
from lerobot_dexflex.evaluation.reach.bounds import teacher_of
from lerobot_dexflex.evaluation.reach.cells import Cell
from lerobot_dexflex.evaluation.reach.record import Record, make_record
from lerobot_dexflex.evaluation.report.film import Film, side_by_side
from lerobot_dexflex.evaluation.report.rerun_log import RerunLog
from lerobot_dexflex.experts.reach.chains import Chain
from lerobot_dexflex.interfaces.method import Method


def choose_episode(records: Sequence[Record], cell: str, saved_by: str) -> int | None:
    """Return the first episode that raw drops and another method does not; None if there is none.

    It is a selection, and a report has to say so.
    """
    here = [r for r in records if r.cell == cell]
    fallen = {r.episode for r in here if r.method == "raw" and r.dropped}
    held = {r.episode for r in here if r.method == saved_by and not r.dropped}
    return min(fallen & held, default=None)


def film(
    chain: Chain, index: int, cell: str, methods: Sequence[str], folder: Path, controller: Path | None
) -> Path:
    """Run an episode under every method, alone, and lay the films side by side; also writes rerun recordings.

    Args:
        chain: The episode's chain.
        index: Its number.
        cell: How its commands are degraded.
        methods: Which methods.
        folder: Folder of the benchmark; writes into `videos` and `rerun`.
        controller: Folder of the trained controller.

    Returns:
        The film of all.
    """
    clips = []
    for name in methods:
        method, stem = Method.parse(name), f"{cell}_{index:04d}_{name.replace(':', '_')}"
        clips.append(folder / "videos" / f"{stem}.mp4")
        interface = _Observed(method.make(controller))
        watcher = _Watcher(
            interface, Film(clips[-1]), RerunLog(folder / "rerun" / f"{stem}.rrd", name, index)
        )
        corruption = Cell.parse(cell).corruption
        episode = run_chains([chain], corruption, interface, teacher=teacher_of(method), watch=watcher)[0]
        identity: dict[str, Any] = {"method": name, "cell": cell, "index": index, "chain": "", "version": ""}
        watcher.close(make_record(episode, **identity, group=(index, index + 1), traced=False))
    path = folder / "videos" / f"{cell}_{index:04d}_side_by_side.mp4"
    side_by_side(clips, path)
    return path


class _Observed(ObservedInterface):
    """An observed interface that explains itself if the inner one does."""

    @property
    def explanation(self) -> Any:
        """The inner interface's explanation of its last step, or None."""
        return getattr(self._inner, "explanation", None)


class _Watcher:
    """Sees the steps of one slot, alone in its batch."""

    def __init__(self, interface: _Observed, film: Film, log: RerunLog) -> None:
        self._interface, self._film, self._log = interface, film, log
        self._wrist: Camera | None = None

    def __call__(self, index: int, slot: Slot) -> None:
        """See the state after a step."""
        del index
        env, motion = slot.held.env, self._interface.motion
        if self._wrist is None:
            self._wrist = Camera(env.model, "wrist")
        # The ghost of the goal moves with the next control step; nothing collides with it.
        env.data.mocap_pos[0], env.data.mocap_quat[0] = slot.held.operator.controller.goal
        pixels = {"front": env.render(), "wrist": self._wrist.render(env.data)}
        info = {"progress": slot.episode.progress / len(slot.episode.chain.goals), "is_success": False}
        row = None if motion is None else motion.row(0)
        for part in (self._film, self._log):
            part.watch(env, slot.observation | {"pixels": pixels}, info, row)
        if slot.episode.explanations:
            self._log.scalars(flat(slot.episode.explanations[-1]))

    def close(self, record: Record) -> None:
        """Write film and recording."""
        self._film.close(record)
        self._log.close(record)


def flat(explanation: dict[str, Any], path: str = "") -> dict[str, float]:
    """Return the numbers of an explanation by path; names are left out."""
    found: dict[str, float] = {}
    for key, value in explanation.items():
        if isinstance(value, dict):
            found |= flat(value, f"{path}{key}/")
        elif isinstance(value, int | float):
            found[f"{path}{key}"] = float(value)
    return found
