"""Render docs/interventions_<task>.png: what interfaces change in each tool's first episode (paper, Fig. 4).

python docs/render_interventions.py

Rows, films and traces go to `outputs/interventions`; the same command continues after Ctrl-C.
"""

import sys
from pathlib import Path

from lerobot_dexflex.evaluation.comparison import compare
from lerobot_dexflex.evaluation.report.interventions import interventions, read_trace

ROOT = Path(__file__).resolve().parents[1]
METHODS = "filter,projection,dexgen:use_splitter=True,dexflex:use_splitter=True"
"""Those that change drafts; `raw` does not."""


def main() -> None:
    """Run the experiment's first episode of every tool and draw how much each interface changed it."""
    sys.path.insert(0, str(ROOT / "eval"))
    from shared_control import Config, build

    comparison = build(Config(methods=METHODS, episodes=1, output=ROOT / "outputs/interventions"))
    compare(comparison)
    (condition,), seed = comparison.conditions, comparison.seeds[0]
    for task in comparison.players:
        traces = {
            method.removesuffix(":use_splitter=True"): read_trace(
                comparison.trace(task, condition, seed, comparison.named(method))
            )
            for method in comparison.methods
        }
        picture = interventions(traces, "change of the draft [mm]", "around contact events")
        name = task.removesuffix("-v0").lower()
        Path(__file__).with_name(f"interventions_{name}.png").write_bytes(picture)


if __name__ == "__main__":
    main()
