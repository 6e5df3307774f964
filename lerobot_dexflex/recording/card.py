"""The dataset card: written from the files of the dataset alone."""

import json
from pathlib import Path
from typing import Any

from huggingface_hub import DatasetCardData

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.recording.config import RecordConfig
from lerobot_dexflex.recording.recipe import SIMULATED
from lerobot_dexflex.recording.schema import (
    ANGLE_STEP,
    FORCE_STEP,
    LENGTH_STEP,
    columns,
    privileged_columns,
    robot_of,
)
from lerobot_dexflex.recording.staging import RECORD_FILE, program_of
from lerobot_dexflex.runs.statistics import success_rate

_EXPERT = """\
**Expert.** {successes} of {attempts} attempts succeeded: {rate:.0f} % (Wilson 95 %: {low:.0f}-{high:.0f} %).
Failed attempts are left out\
"""
_LED = """\
**Operator.** {episodes} of {attempts} attempts were kept, as the operator wished; {successes} of them all
solved the task\
"""
_UNSTEADY = """\
The frame at step k holds the observation *before* the step and the expert's label `action`. What was executed
is the label plus smooth joint noise (a natural unsteadiness), so the demonstrations show how to come back.
"""
_AS_LABELLED = """\
The frame at step k holds the observation *before* the step and the label `action`, which was executed. The
column `operator.draft` is where the person's fingertips led, pressing included.
"""
_INTERFACE = """\
The operator's {what} passed through the interface `{interface}`{controller}; labels and execution are what
it made of them.
"""
_GLOVE = """\
On the way there its glove spoilt them: `{glove}`, of which the columns `operator.*` have nothing.
"""
_PERSON = """\
Every attempt has another person in the glove, drawn from its number and the recording's seed.
"""
_WHAT = {
    "joint": "joints",
    "motion": "drafts, which say where the fingertips should be and hold no squeeze,",
    "pressing": "drafts, which command into the object,",
    "led": "fingertips",
}
_TEMPLATE = """\
---
{front_matter}
---

# {repo_id}

{episodes} demonstrations ({frames} frames, {minutes:.1f} min at {fps} Hz) of the simulated task
`{task}`, "{description}", on a {robot}, made by {who} of
[lerobot_dexflex](https://github.com/lerobot-dexflex/lerobot_dexflex). LeRobotDataset {version}.{warning}

{tried}; seeds and outcomes of all attempts are in [{record}]({record}).

## Columns

| key | shape | unit | what |
|---|---|---|---|
{rows}

{executed}Every element is named in [meta/info.json](meta/info.json). No object pose, goal or mass is
recorded. LeRobot hands no policy the columns marked privileged.
Numbers are rounded to {angle:.1e} rad, {length:.1e} m and {force:.1e} N, at or below what sensors resolve.

## Load it

```python
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset("{repo_id}", root="{root}")
print(dataset.num_episodes, dataset[0]["action"].shape)
```

```bash
lerobot-dataset-viz --repo-id {repo_id} --root {root} --episode-index 0
```

Both work offline.

## Record it again

```bash
{program} --config_path={root}/recipe.yaml --root=outputs/again
```

| | |
|---|---|
| recorded by | `{command}` |
| commit | `{commit}` |
| digest of the code that decides the data | `{code}` |
| versions | {versions} |
| environment seeds | {first_seed} + attempt; attempts 0 to {last_attempt} |

## Known limitations

Simulation only{scripted}. Images are lossy h264.
"""


def write_card(root: Path) -> None:
    """Write `README.md` of the recorded dataset in `root`."""
    record = json.loads((root / RECORD_FILE).read_text())
    info = json.loads((root / "meta/info.json").read_text())
    (root / "README.md").write_text(_card(record, info))


def _card(record: dict[str, Any], info: dict[str, Any]) -> str:
    recipe, expert = record["recipe"], record["expert"]
    data = DatasetCardData(
        license="apache-2.0",
        task_categories=["robotics"],
        tags=["LeRobot", "dexterous", "tactile", "simulation"],
        configs=[{"config_name": "default", "data_files": "data/*/*.parquet"}],
    )
    return _TEMPLATE.format(
        front_matter=data.to_yaml().strip(),
        repo_id=recipe["repo_id"],
        root=recipe["root"],
        task=recipe["task"],
        first_seed=recipe["seed"],
        last_attempt=expert["attempts"] - 1,
        description=TASKS[recipe["task"]].description,
        robot=_robot(info["robot_type"]),
        episodes=record["episodes"],
        frames=info["total_frames"],
        fps=info["fps"],
        minutes=info["total_frames"] / info["fps"] / 60,
        version=info["codebase_version"],
        warning="" if record["complete"] else "\n\n**Unfinished:** run the command below again to continue.",
        **_told(record),
        record=RECORD_FILE.as_posix(),
        rows="\n".join(_rows(info)),
        angle=ANGLE_STEP,
        length=LENGTH_STEP,
        force=FORCE_STEP,
        command=record["command"],
        commit=record["commit"],
        code=record["code"],
        versions=", ".join(f"{name} {number}" for name, number in record["versions"].items()),
    )


def _told(record: dict[str, Any]) -> dict[str, str]:
    """Return the passages that depend on who led the hand."""
    recipe, expert, program = record["recipe"], record["expert"], program_of(record)
    if program != RecordConfig.program and recipe["source"] != SIMULATED:
        return {
            "program": program,
            "who": f"a person, live (`{recipe['source']}`), with {program}",
            "tried": _LED.format(**expert, episodes=record["episodes"]).strip(),
            "executed": _AS_LABELLED + _passed_through(record, "led"),
            "scripted": "",
        }
    successes, attempts = expert["successes"], expert["attempts"]
    low, high = success_rate([True] * successes + [False] * (attempts - successes)).pc_success_ci95
    return {
        "program": program,
        "who": "the privileged operator",
        "tried": _EXPERT.format(**expert, rate=100 * successes / attempts, low=low, high=high).strip(),
        "executed": _UNSTEADY + _between(record),
        "scripted": "; the order of the arm's moves is scripted, the hand reacts",
    }


def _between(record: dict[str, Any]) -> str:
    """Say what stood between the simulated operator and the hand."""
    recipe = record["recipe"]
    said = recipe.get(SIMULATED, recipe)  # Of a live one, the same words are one level below.
    errors = CommandErrors.parse(said["glove"])
    joint = Method.parse(recipe["interface"]).command_space == "joint"
    if joint and not errors:
        return ""
    text = _passed_through(record, "joint" if joint else said["source"])
    if errors:
        text += _GLOVE.format(glove=errors.name)
    return text + _PERSON if errors.level else text


def _passed_through(record: dict[str, Any], what: str) -> str:
    controller = f" (controller {record['controller']})" if record.get("controller") else ""
    interface = record["recipe"]["interface"]
    return _INTERFACE.format(what=_WHAT[what], interface=interface, controller=controller)


def _robot(robot_type: str) -> str:
    hand, joints = robot_of(robot_type)
    robot = f"tactile {hand.name.upper()} hand"
    return robot if joints == hand.joint_names else f"{robot} on an xArm7"


def _rows(info: dict[str, Any]) -> list[str]:
    features = info["features"]
    hand, joints = robot_of(info["robot_type"])
    images = [key for key in features if key.startswith("observation.images.")]
    rows = []
    for key in images:
        shape = "x".join(str(size) for size in features[key]["shape"])
        encoding = features[key]["info"]
        video = f"{encoding['video.codec']}, key frame every {encoding['video.g']} frames"
        rows.append(f"| `{key}` | {shape} video | RGB | camera `{key.rsplit('.', 1)[1]}`; {video} |")
    for key, column in (columns(hand, joints) | privileged_columns(hand)).items():
        rows.append(f"| `{key}` | {len(column.names)} | {column.unit} | {column.meaning} |")
    return rows
