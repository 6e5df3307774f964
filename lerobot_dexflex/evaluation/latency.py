"""How long one hand waits for a decision of a learned interface."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from lerobot_dexflex.controller import ControllerConfig, DexFlexController, SelectionSettings
from lerobot_dexflex.controller.diffusion_prior import WEIGHTS, DiffusionPrior
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, joint_limits
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces import Interface
from lerobot_dexflex.interfaces.controller_folder import find_controller
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface
from lerobot_dexflex.interfaces.dexgen import DexGenInterface
from lerobot_dexflex.interfaces.raw import RawInterface

CANDIDATES, EVALUATIONS = (4, 16, 64, 256), (1, 2, 4, 8)
_WARM_UP = 10


class Latency(NamedTuple):
    """Percentiles of the time of one control step [s]."""

    p50: float
    p95: float
    p99: float


class Networks(NamedTuple):
    """What learned interfaces run on."""

    controller: DexFlexController
    prior: DiffusionPrior
    trained: bool
    """False if the weights are random; the time of a decision does not depend on them."""


def load_networks(hand: Hand, where: str | Path | None = None) -> Networks:
    """Return the networks of a hand's controller, by default the shipped one, or random ones without it."""
    try:
        folder = find_controller(hand, where)
    except DexFlexError:
        if where:
            raise
        controller = DexFlexController(ControllerConfig(hand=hand.name)).eval().requires_grad_(False)
        return Networks(controller, DiffusionPrior(controller.config).eval(), False)
    controller = DexFlexController.from_pretrained(folder)
    has_prior = (folder / WEIGHTS).is_file()
    prior = DiffusionPrior.load(folder, controller.config) if has_prior else DiffusionPrior(controller.config)
    return Networks(controller, prior, True)


def interfaces_at_defaults(hand: Hand, networks: Networks) -> dict[str, Interface]:
    """Return the interfaces whose latency is compared, as they run by default; DexFlex with more, too."""
    default, many = SelectionSettings(), SelectionSettings(n_pure=32, n_seeded=16, n_finger=16)
    return {
        "raw": RawInterface(hand),
        "dexgen": DexGenInterface(hand, networks.controller, networks.prior),
        f"dexflex, {default.n_candidates} candidates": DexFlexInterface(hand, networks.controller, default),
        f"dexflex, {many.n_candidates} candidates": DexFlexInterface(hand, networks.controller, many),
    }


def measure(
    hand: Hand,
    interfaces: Mapping[str, Interface],
    steps: int,
    clock: Callable[[], float] = time.perf_counter,
    hands: int = 1,
) -> dict[str, Latency]:
    """Time single control steps; the interfaces take turns, so that all see the same machine.

    Args:
        hand: The hand that they serve.
        interfaces: By name; they read drafts of fingertip motion.
        steps: Steps that are timed, after a few that are not.
        clock: Returns the time [s].
        hands: Hands in one call, whose time is not divided by their number.
    """
    observation, draft = _inputs(hand, hands)
    size = hand.n_fingers * math.prod(hand.taxels)
    taxels = torch.rand(64, 1, size, generator=torch.Generator().manual_seed(0))
    times: dict[str, list[float]] = {name: [] for name in interfaces}
    for k in range(steps + _WARM_UP):
        seen = {**observation, "observation.tactile": 0.1 * taxels[k % 64].expand(hands, -1)}
        for name, interface in interfaces.items():
            begin = clock()
            interface.step(seen, draft)
            times[name].append(clock() - begin)
    return {name: Latency(*np.percentile(t[_WARM_UP:], (50, 95, 99)).tolist()) for name, t in times.items()}


def grid(
    hand: Hand,
    networks: Networks,
    steps: int,
    candidates: Sequence[int] = CANDIDATES,
    evaluations: Sequence[int] = EVALUATIONS,
) -> dict[tuple[int, int], Latency]:
    """Return the latency of DexFlex by number of candidates and of function evaluations from noise.

    Half of the candidates are pure, the others draft-seeded.
    """
    made = {}
    for count in candidates:
        for nfe in evaluations:
            settings = SelectionSettings(count // 2, count - count // 2, n_finger=0, nfe=nfe)
            made[f"{count} {nfe}"] = DexFlexInterface(hand, networks.controller, settings)
    measured = measure(hand, made, steps)
    return {(count, nfe): measured[f"{count} {nfe}"] for count in candidates for nfe in evaluations}


def _inputs(hand: Hand, hands: int) -> tuple[dict[str, Tensor], Tensor]:
    lower, upper = joint_limits(hand)
    joints = ((lower + upper) / 2).float().expand(hands, -1)
    observation = {
        "observation.state": joints,
        "observation.fingertips": fingertips(hand, joints).flatten(1),
        "observation.gravity": torch.tensor([0.0, 0.0, -1.0]).expand(hands, -1),
    }
    generator = torch.Generator().manual_seed(0)
    return observation, 0.001 * torch.randn(hands, DRAFT_HORIZON, hand.n_fingers, 3, generator=generator)
