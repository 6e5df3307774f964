"""Run one episode again under several methods, to film, record and draw it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from lerobot_dexflex.commands.loop import Episode, Privileged, Slot, run_chains
from lerobot_dexflex.envs.rendering import Camera
from lerobot_dexflex.evaluation.conditions import Condition
from lerobot_dexflex.evaluation.observed import ObservedInterface
from lerobot_dexflex.evaluation.report.film import Film, side_by_side
from lerobot_dexflex.evaluation.report.rerun_log import RerunLog
from lerobot_dexflex.experts.reach.chains import Chain
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.method import Method


class Ending(NamedTuple):
    """What a film tells of its episode."""

    interface: str
    """The method."""
    episode: int
    """The seed."""
    steps: int
    ending: str
    """`success`, `dropped` or `time out`."""


class Shown(NamedTuple):
    """An episode that was run again."""

    film: Path
    """All methods side by side."""
    episodes: dict[str, Episode]
    """By method."""


def choose_episode(rows: pd.DataFrame, condition: str, dropped_by: str, saved_by: str) -> int | None:
    """Return the seed of the first episode that one method drops and another does not; None without any.

    It is a selection, and a report has to say so.
    """
    here = rows[rows["condition"] == condition]
    fallen = here.loc[(here["method"] == dropped_by) & here["dropped"].astype(bool), "seed"]
    held = here.loc[(here["method"] == saved_by) & ~here["dropped"].astype(bool), "seed"]
    return min(set(fallen) & set(held), default=None)


def show_episode(
    hand: Hand, chain: Chain, condition: str, methods: Sequence[str], folder: Path, controller: str = ""
) -> Shown:
    """Run an episode under every method, alone, and lay the films side by side; also writes rerun recordings.

    Args:
        hand: The hand that holds the object.
        chain: The episode's chain.
        condition: What goes wrong, and who commands.
        methods: Which methods.
        folder: Folder of the benchmark; writes into `videos` and `rerun`.
        controller: Folder or hub id of the trained controller; the shipped one if empty.
    """
    parsed, clips = Condition.parse(condition), list[Path]()
    episodes: dict[str, Episode] = {}
    for name in methods:
        stem = f"{condition}_{chain.seed}_{name.replace(':', '_')}"
        clips.append(folder / "videos" / f"{stem}.mp4")
        interface = _Observed(Method.parse(name).make(hand, controller))
        log = RerunLog(folder / "rerun" / f"{stem}.rrd", name, chain.seed)
        watcher = _Watcher(interface, Film(clips[-1]), log)
        (episodes[name],) = run_chains([chain], parsed.errors, interface, source=parsed.source, watch=watcher)
        watcher.close(_ending(name, episodes[name]))
    path = folder / "videos" / f"{condition}_{chain.seed}_side_by_side.mp4"
    side_by_side(clips, path)
    return Shown(path, episodes)


def _ending(method: str, episode: Episode) -> Ending:
    ending = "dropped" if episode.dropped else "success" if episode.progress == 1.0 else "time out"
    return Ending(method, episode.chain.seed, episode.steps, ending)


class _Observed(ObservedInterface):
    """Lets an upper bound look on, too."""

    def see(self, slots: Sequence[Slot | None]) -> None:
        """Look at the running episodes, if the inner interface does; see `Privileged`."""
        if isinstance(self.inner, Privileged):
            self.inner.see(slots)


class _Watcher:
    """Sees the steps of one slot, alone in its batch."""

    def __init__(self, interface: _Observed, film: Film, log: RerunLog) -> None:
        self._interface, self._film, self._log = interface, film, log
        self._wrist: Camera | None = None

    def __call__(self, index: int, slot: Slot) -> None:
        """See the state after a step."""
        del index
        env, change = slot.held.env, self._interface.change
        if self._wrist is None:
            self._wrist = Camera(env.model, "wrist")
        # The ghost of the goal moves with the next control step; nothing collides with it.
        env.data.mocap_pos[0], env.data.mocap_quat[0] = slot.held.operator.goal
        pixels = {"front": env.render(), "wrist": self._wrist.render(env.data)}
        info = {"progress": slot.episode.progress / len(slot.episode.chain.goals), "is_success": False}
        row = None if change is None else change.row(0)
        for part in (self._film, self._log):
            part.watch(env, slot.observation | {"pixels": pixels}, info, row)
        if slot.episode.explanations:
            self._log.scalars(flat(slot.episode.explanations[-1]))

    def close(self, ending: Ending) -> None:
        """Write film and recording."""
        self._film.close(ending)
        self._log.close(ending)


def flat(explanation: dict[str, Any], path: str = "") -> dict[str, float]:
    """Return the numbers of an explanation by path; names are left out."""
    found: dict[str, float] = {}
    for key, value in explanation.items():
        if isinstance(value, dict):
            found |= flat(value, f"{path}{key}/")
        elif isinstance(value, int | float):
            found[f"{path}{key}"] = float(value)
    return found
