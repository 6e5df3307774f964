"""A version counts every module of this project that a real job loads."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HARMLESS = (
    "lerobot_dexflex.runs",
    "lerobot_dexflex.evaluation.report",
    "lerobot_dexflex.interfaces.entries",  # The list of all interfaces; each decides by its own module.
    "lerobot_dexflex.evaluation.comparison",
)
"""They keep, show and name rows; none changes an episode."""
SCRIPT = """
import sys
from pathlib import Path

import gymnasium

import lerobot_dexflex  # Registers the tasks.
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.runs import provenance

digest, given = provenance.code_digest, []
provenance.code_digest = lambda modules: digest(given.extend(names := tuple(modules)) or names)
for spec in gymnasium.registry.values():
    if spec.id.startswith("lerobot_dexflex/"):
        spec.max_episode_steps = 3


def compare(players, method, cameras, seed=0):
    from lerobot_dexflex.evaluation.comparison import Comparison, compare

    comparison = Comparison(
        {"PlaceHammer-v0": players}, (method,), Path(sys.argv[1]), seeds=(seed,), cameras=cameras
    )
    return compare(comparison, workers=0, quiet=True)


def policy():
    from lerobot_dexflex.evaluation.policies import LeRobotPolicies

    return compare(LeRobotPolicies(LEAP, Path(sys.argv[3])), "dexflex", cameras=True)


def operator():
    from lerobot_dexflex.evaluation.teleoperators import Teleoperators

    return compare(Teleoperators(LEAP, "PlaceHammer-v0"), "press", cameras=False)


def replay():
    from lerobot_dexflex.evaluation.replay import Replays

    return compare(Replays(Path("datasets/place_hammer")), "press", cameras=False)


def expert():
    from lerobot_dexflex.recording.expert_rate import expert_rate

    return expert_rate(LEAP, "PlaceHammer-v0", 1, 0, 0, Path(sys.argv[1]) / "tasks.csv", quiet=True)


rows = globals()[sys.argv[2]]()
assert rows["steps"].tolist() == [3], rows
projects = ("lerobot_dexflex", "lerobot_policy_dexflex")
loaded = {name for name in sys.modules if name.partition(".")[0] in projects}
print(*sorted(loaded - set(provenance.imported(given))))
"""


@pytest.mark.parametrize("kind", ["policy", "operator", "replay", "expert"])
def test_a_version_counts_every_module_that_a_job_loads(kind, tmp_path, policy_checkpoint):
    words = [sys.executable, "-c", SCRIPT, str(tmp_path), kind, str(policy_checkpoint)]
    run = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    assert [name for name in run.stdout.split() if not name.startswith(HARMLESS)] == []
