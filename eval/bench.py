"""Measure what a control step costs while the hammer is in the hand, a learned decision, a training step.

python eval/bench.py
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import mujoco
import numpy as np
import torch
from gymnasium.vector import AsyncVectorEnv

import lerobot_dexflex  # noqa: F401  (registers the tasks and chooses the renderer)
from lerobot_dexflex import console
from lerobot_dexflex.envs.hand_env import CAMERAS
from lerobot_dexflex.envs.rendering import Camera
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.hand.model import SUBSTEPS, robot_joints
from lerobot_dexflex.hand.touch import TouchSensor
from lerobot_dexflex.hands import LEAP

TASK, SEED = "PlaceHammer-v0", 100_000
HELD_AFTER = 66
"""Control steps of the expert after which the hammer is lifted."""
SWAY = 0.05
"""Amplitude of the wrist motion while measuring [rad]."""
WINDOW, WINDOWS = 20, 10
HANDS = 64
"""Hands that are decided for in one call."""
GRID = Path("eval/results/reach.csv")
"""Rows of `eval/degraded_commands.py --grid`; their progress is shown beside the latency."""


class HeldHammer(gymnasium.Wrapper):
    """PlaceHammer from the moment the hammer is lifted; `step` ignores its action and sways the wrist."""

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Let the expert pick the hammer up."""
        del options
        env: Any = self.env.unwrapped
        env.reset(seed=SEED)
        for step, command in enumerate(make_expert(TASK)(env, np.random.default_rng(SEED))):
            env.advance(command.joint_targets)
            if step == HELD_AFTER:
                break
        self._target, self._time = env.command, 0.0
        return env.step(self._target)[0], {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Sway joints 5 to 7."""
        del action
        self._time += 0.05
        target = self._target.copy()
        target[4:7] += SWAY * np.sin(2 * np.pi * 0.3 * self._time)
        observation, reward, _, _, info = self.env.unwrapped.step(target)
        return observation, float(reward), False, False, info


def held_hammer(cameras: tuple[str, ...] = CAMERAS) -> gymnasium.Env:
    """Return the environment in the phase that is measured."""
    return HeldHammer(gymnasium.make(f"lerobot_dexflex/{TASK}", cameras=cameras, disable_env_checker=True))


def best(work: Callable[[], Any], repeats: int, windows: int = WINDOWS) -> float:
    """Return the seconds that one call of `work` takes in the fastest of several windows of calls."""
    work()
    times = []
    for _ in range(windows):
        begin = time.perf_counter()
        for _ in range(repeats):
            work()
        times.append((time.perf_counter() - begin) / repeats)
    return min(times)


def environment_rates(workers: int) -> dict[str, float]:
    """Return control steps per second in contact: one process, without cameras, and in worker processes."""
    rates = {}
    for name, cameras in (("cameras and touch", CAMERAS), ("touch only", ())):
        env = held_hammer(cameras)
        env.reset()
        rates[f"{name}, one core"] = 1 / best(partial(env.step, None), WINDOW)
        assert env.step(None)[4]["holding"], "the hammer was lost: this is no measurement of a grasp"
        env.close()
    vector = AsyncVectorEnv([held_hammer] * workers, context="forkserver")
    vector.reset()
    actions = np.zeros((workers, len(robot_joints(LEAP))), np.float32)
    rates[f"cameras and touch, {workers} workers"] = workers / best(lambda: vector.step(actions), WINDOW)
    vector.close()
    return rates


def part_costs() -> dict[str, float]:
    """Return what single parts of a control step cost, in seconds."""
    env: Any = held_hammer()
    env.reset()
    model, data = env.unwrapped.model, env.unwrapped.data
    camera, sensor, rng = Camera(model, "front", 96, 96), TouchSensor(model, LEAP), np.random.default_rng(0)
    hand = torch.as_tensor(env.unwrapped.command[7:]).view(1, 16)
    tips = fingertips(LEAP, hand) + 0.002
    batch = (tips.expand(HANDS, -1, -1), hand.expand(HANDS, -1))
    return {
        "bare mj_step": best(lambda: mujoco.mj_step(model, data), SUBSTEPS * WINDOW),
        "one camera, 96 x 96": best(lambda: camera.render(data), WINDOW),
        "240 taxels": best(lambda: sensor.read(data, rng), WINDOW),
        "fingertip IK, 1 hand": best(lambda: solve_fingertips(LEAP, tips, hand), WINDOW),
        f"fingertip IK, {HANDS} hands": best(lambda: solve_fingertips(LEAP, *batch), WINDOW),
    }


def policy_costs(checkpoint: Path) -> dict[str, float]:
    """Return seconds per control step of the shipped policy, planning included; empty without it."""
    if not checkpoint.is_dir():
        return {}
    from lerobot_dexflex.evaluation.policies import LeRobotPolicies

    env = held_hammer()
    observation, _ = env.reset()
    stacked = {key: value[None] for key, value in observation.items() if key != "pixels"}
    stacked["pixels"] = {name: image[None] for name, image in observation["pixels"].items()}
    controller = LeRobotPolicies(LEAP, checkpoint)("raw")
    controller.reset([SEED])
    task = str(env.get_wrapper_attr("task_description"))
    return {"policy `raw`, per control step": best(lambda: controller.act(stacked, task), 24, 5)}


def training_costs(config: Path, steps: int = 40) -> dict[str, float]:
    """Return what `lerobot-train` says of a step: seconds of computing and of waiting for data.

    Args:
        config: Configuration of the run; its batch and loader, a few steps.
        steps: Their number; the second half counts.
    """
    command = [Path(sys.executable).parent / "lerobot-train", f"--config_path={config}", f"--steps={steps}"]
    command += [f"--log_freq={steps // 2}", "--save_checkpoint=false", "--env_eval_freq=0"]
    with tempfile.TemporaryDirectory() as folder:
        run = subprocess.run(
            [*command, f"--output_dir={folder}/run"], capture_output=True, text=True, check=True
        )
    update, data = re.findall(r"updt_s:([\d.]+) data_s:([\d.]+)", run.stderr + run.stdout)[-1]
    return {"training step, computing": float(update), "training step, waiting for data": float(data)}


def decisions(controller: str, steps: int) -> dict[str, Any]:
    """Print and return how long learned interfaces take for one hand, and DexFlex by its settings."""
    from lerobot_dexflex.evaluation import latency

    networks = latency.load_networks(LEAP, controller)
    found = latency.measure(LEAP, latency.interfaces_at_defaults(LEAP, networks), steps)
    together = latency.measure(LEAP, latency.interfaces_at_defaults(LEAP, networks), steps // 8, hands=HANDS)
    cells = latency.grid(LEAP, networks, steps // 4)
    weights = "trained" if networks.trained else "random"
    print(f"decisions, one core, {weights} weights [ms]")
    print(f"  {'':38}{'p50':>8}{'p95':>8}{'p99':>8}")
    for title, measured, hands in (("one hand", found, 1), (f"{HANDS} hands, of each", together, HANDS)):
        print(f"  {title}")
        for name, times in measured.items():
            print(f"    {name:36}" + "".join(f"{1e3 * value / hands:8.2f}" for value in times))
    progress = grid_progress(GRID)
    heading = f"  {'candidates':>12}{'evaluations':>13}{'p50':>8}{'p95':>8}"
    print(heading + (f"{'progress':>10}" if progress else ""))
    for (candidates, evaluations), times in cells.items():
        reached = progress.get((candidates, evaluations))
        known = "" if reached is None else f"{reached:10.2f}"
        print(f"  {candidates:12}{evaluations:13}{1e3 * times.p50:8.2f}{1e3 * times.p95:8.2f}{known}")
    print()
    return {
        "weights": weights,
        "interfaces": {name: times._asdict() for name, times in found.items()},
        f"{HANDS} hands": {name: times._asdict() for name, times in together.items()},
        "grid": {f"{c}x{e}": times._asdict() for (c, e), times in cells.items()},
    }


def grid_progress(table: Path) -> dict[tuple[int, int], float]:
    """Return the mean progress by numbers of candidates and evaluations, all errors together.

    Args:
        table: Rows of the benchmark; without the file the answer is empty.
    """
    import pandas as pd

    from lerobot_dexflex.controller import SelectionSettings
    from lerobot_dexflex.interfaces.method import Method

    if not table.is_file():
        return {}
    found = {}
    for name, progress in pd.read_csv(table).groupby("method")["progress"].mean().items():
        if not str(name).startswith("dexflex:"):
            continue
        method = Method.parse(str(name))
        if {"n_finger", "n_pure", "n_seeded", "nfe"} == set(dict(method.options)):
            settings = SelectionSettings(**dict(method.options))
            found[settings.n_candidates, settings.nfe] = float(progress)
    return found


@dataclass
class Config:
    """Measure control steps, decisions of learned interfaces and training steps."""

    workers: int = 2
    """Worker processes."""
    controller: str = ""
    """Folder or hub id of a controller; empty: the shipped one."""
    steps: int = 400
    """Timed decisions per interface."""
    decisions_only: bool = False
    """Time learned interfaces and no more."""
    json: Path | None = None
    """Also write the numbers to this file."""


def main(arguments: list[str] | None = None) -> int:
    """Print the table; the fastest windows are shown, because other work on the machine only slows down.

    Decisions are shown with their percentiles instead: what matters in a control loop is its slow steps.
    """
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    del words
    torch.set_num_threads(1)
    found: dict[str, Any] = {"decisions": decisions(config.controller, config.steps)}
    if not config.decisions_only:
        found |= simulation(config.workers)
    if config.json:
        config.json.write_text(json.dumps(found, indent=2))
    return 0


def simulation(workers: int) -> dict[str, Any]:
    """Print and return control steps per second and what their parts, a policy and a training step cost."""
    parts = part_costs()
    rates = environment_rates(workers)
    rates["bare mj_step of the same model, one core"] = 1 / (SUBSTEPS * parts["bare mj_step"])
    parts |= policy_costs(Path("policies/checkpoints/place_hammer"))
    parts |= training_costs(Path("configs/policy/place_hammer.yaml"))
    print(f"{TASK}, hammer in the hand, wrist swaying; renderer {os.environ['MUJOCO_GL']}\n")
    print(f"{'control steps per second':45}{'20 Hz real time':>18}")
    for name, rate in rates.items():
        print(f"  {name:38}{rate:7.0f}{rate / 20:14.1f} x")
    print("\ncost of parts")
    for name, seconds in parts.items():
        print(f"  {name:38}{1e3 * seconds:10.3f} ms")
    return {"control_steps_per_second": rates, "seconds": parts}


if __name__ == "__main__":
    sys.exit(main())
