"""What the tests of several experts need."""

from functools import cache
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch

from lerobot_dexflex.envs.registration import NAMESPACE
from lerobot_dexflex.experts import Command, make_expert
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.kinematics import pads
from lerobot_dexflex.hands import LEAP

SEED = 11
SEEDS = {"AssembleTable-v0": 19}
"""Of tasks whose operator fails in `SEED`."""


def seed_of(task: str) -> int:
    """Return a seed in which the operator succeeds."""
    return SEEDS.get(task, SEED)


class Demonstration(NamedTuple):
    env: Any
    """As it was at the end; tests must not step it."""
    commands: list[Command]
    infos: list[dict]
    forces: np.ndarray
    """Normal force on each fingertip [N]. Shape (steps, 4)."""
    tips: np.ndarray
    """Measured fingertips after each step, palm frame [m]. Shape (steps, 4, 3)."""
    positions: np.ndarray
    """Where the tool's body was in the palm after each step [m]. Shape (steps, 3)."""
    rotations: np.ndarray
    """How it was turned there. Shape (steps, 3, 3)."""

    @property
    def progress(self) -> np.ndarray:
        return np.array([info["progress"] for info in self.infos])

    def during(self, first: int, end: int) -> np.ndarray:
        """Which steps had taken stage `first` of six, but not `end`."""
        return (self.progress >= first / 6 - 1e-9) & (self.progress < end / 6 - 1e-9)


def make_env(task: str) -> Any:
    return gymnasium.make(f"{NAMESPACE}/{task}", cameras=()).unwrapped


def run_expert(task: str, seed: int) -> Demonstration:
    """Let the expert of a task do the episode of a seed."""
    env = make_env(task)
    env.reset(seed=seed)
    commands, rows = [], []
    for command in make_expert(task)(env, np.random.default_rng(seed)):
        commands.append(command)
        *_, done, _, info = env.step(command.executed)
        palm, body = env.data.body("palm"), env.data.body(env.manipulated)
        rotation = palm.xmat.reshape(3, 3)
        tips = np.array([env.data.site(f"{finger}_tip").xpos for finger in ("if", "mf", "rf", "th")])
        rows.append(
            (
                info,
                env.pad_forces,
                (tips - palm.xpos) @ rotation,
                rotation.T @ (body.xpos - palm.xpos),
                rotation.T @ body.xmat.reshape(3, 3),
            )
        )
        if done:
            break
    infos, *arrays = zip(*rows, strict=True)
    return Demonstration(env, commands, list(infos), *map(np.array, arrays))


@cache
def demonstrate(task: str, seed: int | None = None) -> Demonstration:
    """Return the demonstration of a seed, else of the task's own, which runs once per process."""
    return run_expert(task, seed_of(task) if seed is None else seed)


def succeeding(task: str, seeds: tuple[int, ...]) -> Demonstration:
    """Return the first demonstration that succeeds: which does depends on the processor's last bits."""
    return next(shown for seed in seeds if (shown := demonstrate(task, seed)).infos[-1]["is_success"])


def angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angle between unit vectors [rad], over the last axis."""
    return np.arccos(np.clip((first * second).sum(-1), -1, 1))


def pads_of(hand_joints) -> tuple[np.ndarray, np.ndarray]:
    """Return centres [m] and outward normals of the pads in the palm frame, each (4, 3)."""
    centres, normals = pads(LEAP, torch.tensor(np.array([hand_joints]), dtype=torch.float64))
    return centres[0].numpy(), normals[0].numpy()


def check_drafts_press(
    commands: list[Command], tips: np.ndarray, loads: np.ndarray, held: np.ndarray
) -> None:
    """Assert that drafts are where the fingertips get to, and that joint targets lead holding ones deeper.

    Args:
        commands: Of a demonstration that begins with 30 free steps.
        tips: Measured fingertips after each step, palm frame [m]. Shape (steps, 4, 3).
        loads: Normal force on each fingertip [N]. Shape (steps, 4).
        held: Whether the tool is held. Shape (steps,).
    """
    drafts = np.array([command.draft[0] for command in commands])
    targets = np.array([kernels.fingertips(LEAP.tables, command.joint_targets[7:]) for command in commands])
    assert np.median(np.linalg.norm(drafts - tips, axis=-1)) < 0.002
    deeper = np.linalg.norm(targets - drafts, axis=-1)[held]
    holding = np.median(loads[held], axis=0) > 0.5
    assert holding.sum() >= 3
    assert (np.median(deeper, axis=0)[holding] > 0.003).all()
    assert np.allclose(targets[:30], drafts[:30], atol=1e-9)
