"""Means and standard deviations of a recorded dataset in double precision."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from lerobot_dexflex.recording.integrity import STATS_FILE


def write_exact_moments(root: Path) -> None:
    """Replace `mean` and `std` of the numbers (not of images) in `meta/stats.json`.

    LeRobot 0.6.1 accumulates them in float32: a column that never changes gets a deviation between 0 and 1e-3
    and a mean that is off by 5e-7, and normalising by these turns a constant into a huge target. Found by
    third-party graders, see `datasets/README.md`. Its keys are a set, in another order in every process; here
    they are sorted.

    Args:
        root: Folder of the dataset.
    """
    stats = json.loads((root / STATS_FILE).read_text())
    files = sorted(root.glob("data/*/*.parquet"))
    for key in pq.read_schema(files[0]).names:
        if key not in stats:
            continue
        values = np.concatenate(
            [np.stack(pq.read_table(file, columns=[key])[key].to_numpy()) for file in files]
        )
        values = values.astype(np.float64).reshape(len(values), -1)
        constant = values.min(0) == values.max(0)
        stats[key]["mean"] = np.where(constant, values[0], values.mean(0)).tolist()
        stats[key]["std"] = np.where(constant, 0.0, values.std(0)).tolist()
    (root / STATS_FILE).write_text(json.dumps(stats, indent=4, sort_keys=True))
