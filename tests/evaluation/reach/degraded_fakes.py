"""Episodes and chains that are known by hand."""

import numpy as np

from lerobot_dexflex.commands.families import NO_ERRORS
from lerobot_dexflex.commands.loop import Episode
from lerobot_dexflex.envs.reach import ReachEpisode
from lerobot_dexflex.evaluation.reach.episodes import COLUMNS
from lerobot_dexflex.evaluation.reach.summary import _AVERAGED
from lerobot_dexflex.experts.reach.chains import Chain, Goal
from lerobot_dexflex.hand.objects import ObjectSpec


def chain(seed=0, steps=100):
    spec = ObjectSpec("box", (0.02, 0.02, 0.02), 0.1)
    episode = ReachEpisode(spec, (0, 0, -1), (1, 0, 0), (0.0,) * 16, (0.0,) * 16, (0, 0, 0), (1, 0, 0, 0))
    return Chain(seed, episode, (Goal((0.0, 0.0, float(seed)), (1, 0, 0, 0), False, 0),) * 8, steps)


def episode(steps=4, *, label=0.0, draft=None, selected=None, dropped=False, progress=0.5, event=(), seed=0):
    """All steps alike, progress grows evenly; motions are of the first fingertip along x [m]."""
    found = Episode(chain(seed), NO_ERRORS, dropped=dropped, goals_reached=4, progress=progress)
    for key, value in {"label": label, "draft": draft, "selected": selected}.items():
        series = np.zeros((steps, 4, 3))
        series[:, 0, 0] = label if value is None else value
        setattr(found, key, series)
    found.loads = np.full((steps, 4), 0.5)
    found.in_event = np.isin(np.arange(steps), event)
    found.goal_error = np.zeros((steps, 2))
    found.progress_at = progress * np.arange(1, steps + 1) / steps
    found.goal_steps = [8, 12]
    return found


def build_even(hand, seed, verified):
    """Only even seeds have chains."""
    assert not verified
    return chain(seed) if seed % 2 == 0 else None


def row(method, condition, seed, progress=0.5, *, dropped=False, version="v", **metrics):
    """A row of the benchmark's table; all metrics alike."""
    found = dict.fromkeys(COLUMNS)
    found |= dict.fromkeys(_AVERAGED, float(progress))
    key = {"method": method, "version": version, "task": "Reach-v0", "condition": condition, "seed": seed}
    return key | found | {"steps": 50, "dropped": dropped} | metrics
