"""What the tests of several experts need."""

from functools import cache
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch

from lerobot_dexflex.envs.registration import NAMESPACE
from lerobot_dexflex.experts import Command, make_expert
from lerobot_dexflex.hand.kinematics import pads

SEED = 11


class Demonstration(NamedTuple):
    env: Any
    """As it was at the end; tests must not step it."""
    commands: list[Command]
    infos: list[dict]
    forces: np.ndarray
    """Normal force on each fingertip [N]. Shape (steps, 4)."""

    @property
    def progress(self) -> np.ndarray:
        return np.array([info["progress"] for info in self.infos])


def make_env(task: str) -> Any:
    return gymnasium.make(f"{NAMESPACE}/{task}", cameras=()).unwrapped


@cache
def demonstrate(task: str, seed: int = SEED) -> Demonstration:
    """Let the expert of a task do the episode of a seed, once per process."""
    env = make_env(task)
    env.reset(seed=seed)
    commands, infos, forces = [], [], []
    for command in make_expert(task)(env, np.random.default_rng(seed)):
        commands.append(command)
        *_, done, _, info = env.step(command.executed)
        infos.append(info)
        forces.append(env.pad_forces)
        if done:
            break
    return Demonstration(env, commands, infos, np.array(forces))


def pads_of(hand_joints) -> tuple[np.ndarray, np.ndarray]:
    """Return centres [m] and outward normals of the pads in the palm frame, each (4, 3)."""
    centres, normals = pads(torch.tensor([hand_joints], dtype=torch.float64))
    return centres[0].numpy(), normals[0].numpy()
