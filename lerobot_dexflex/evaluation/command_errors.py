"""What may go wrong between a policy's plan and its interface: noise, and fingers that leave the object.

Both come from the paper's degraded commands (section 4.2), brought to plans of a policy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands.corruption import Corruption
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, pads, solve_fingertips
from lerobot_dexflex.hand.model import HAND_JOINTS
from lerobot_dexflex.interfaces import Interface
from lerobot_dexflex.interfaces.protocol import CommandSpace

_HAND = len(HAND_JOINTS)
_REMOVALS = 1
"""Tells a seed's removals from its noise."""


@dataclass(frozen=True)
class CommandErrors:
    """Errors of the commanded fingertips, drawn from an episode's seed, the same for every interface."""

    noise: float = 0.0
    """Half width of uniform noise on every planned fingertip coordinate and step [m]."""
    removal: float = 0.0
    """Speed at which the most loaded finger is sent off the object now and then [m per step]."""

    def identity(self) -> dict[str, str]:
        """Return what is not zero, by its option's name.

        Raises:
            DexFlexError: If a value is negative or no number.
        """
        values = {f"command_{name}": value for name, value in vars(self).items()}
        for name, value in values.items():
            if not (np.isfinite(value) and value >= 0):
                raise DexFlexError(f"`{name}` must be 0 or more [m]. Got {value}.")
        return {name: str(value) for name, value in values.items() if value}


NO_ERRORS = CommandErrors()


class PlanNoise:
    """Uniform noise on the fingertips of plans.

    It belongs to the control step and not to the plan: a step that is planned twice has the same error in
    both. Planned joints are moved so that their fingertips are off by as much, by the inverse kinematics of
    `raw`.

    Args:
        width: Half width [m].
        command_space: What plans hold after the joints of the arm.
    """

    def __init__(self, width: float, command_space: CommandSpace) -> None:
        self._width, self._space = width, command_space
        self.reset(())

    def reset(self, seeds: Sequence[int]) -> None:
        """Begin an episode per seed."""
        self._rngs = [np.random.default_rng(seed) for seed in seeds]
        self._drawn: list[NDArray[np.float64]] = []

    def disturbed(self, chunk: Tensor, step: int) -> Tensor:
        """Return a plan (batch, steps, columns) that begins at control step `step` with its errors."""
        while len(self._drawn) < step + chunk.shape[1]:
            self._drawn.append(np.stack([rng.uniform(-1, 1, (4, 3)) for rng in self._rngs]))
        drawn = np.stack(self._drawn[step : step + chunk.shape[1]], axis=1)
        errors = self._width * torch.from_numpy(drawn)  # (batch, steps, 4, 3)
        columns = _HAND if self._space == "joint" else errors[0, 0].numel()
        arm, hand = chunk[..., :-columns], chunk[..., -columns:].double()
        if self._space == "joint":
            joints = hand.flatten(0, 1)
            moved = solve_fingertips(fingertips(joints) + errors.flatten(0, 1), joints)
        else:
            moved = hand + errors.flatten(2)
        return torch.cat([arm, moved.view_as(hand).to(chunk)], -1)


class SupportRemoval:
    """Passes drafts on, but now and then takes the most loaded finger off the object. Satisfies `Interface`.

    As if the operator's tracker had lost the finger, or the policy lifted it: for 8 steps the finger is
    commanded to move outward from where it is felt, so that it lets go at once however deep the squeeze was;
    then the draft holds again. The draft's later steps go on outward: nobody knows when the removal ends.
    When removals begin, and how long they last, is that of `removal` in `eval/degraded_commands.py`.

    Args:
        inner: Any interface; of planned joints, those of the finger are solved for its way outward.
        speed: Outward motion [m per step].
    """

    def __init__(self, inner: Interface, speed: float) -> None:
        self._inner, self._speed = inner, speed
        self.name: str = inner.name
        self.command_space: CommandSpace = inner.command_space
        self.begin(())

    def begin(self, seeds: Sequence[int]) -> None:
        """Draw the removals of an episode per seed."""
        corruption = Corruption("removal", self._speed)
        self._streams = [corruption.stream(np.random.default_rng((seed, _REMOVALS))) for seed in seeds]
        self._outside: list[NDArray[np.float64]] = [np.zeros((4, 3)) for _ in seeds]

    @property
    def command(self) -> Tensor | None:
        """Executed commanded fingertips [m]. Shape (batch, 4, 3)."""
        return self._inner.command

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self._inner.reset(mask)

    def start(self, observation: Mapping[str, Tensor], initial: Tensor | None = None) -> Tensor:
        """Return the commanded fingertips before this step [m], (batch, 4, 3); see `Interface.start`."""
        return self._inner.start(observation, initial)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the inner interface's joint targets for the draft or what is left of it."""
        return self._inner.step(observation, self._disturbed(observation, draft))

    def _disturbed(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the draft with the fingers that leave; the schedule moves on by one step."""
        loads = observation["observation.tactile"].double().unflatten(1, (4, -1)).sum(-1).numpy()
        felt = observation["observation.fingertips"].double().unflatten(1, (4, 3))
        inward = pads(observation["observation.state"].double()[:, -_HAND:])[1].numpy()
        draft = draft.clone()
        for row, stream in enumerate(self._streams):
            outward = stream.step(np.zeros((4, 3)), loads[row], inward[row])
            if not stream.in_event:
                self._outside[row] = felt[row].numpy()
                continue
            self._outside[row] = self._outside[row] + outward
            draft[row] = self._leaving(
                draft[row], start=self.start(observation)[row], outward=outward, row=row
            )
        return draft

    def _leaving(self, draft: Tensor, start: Tensor, outward: NDArray[np.float64], row: int) -> Tensor:
        """Return one hand's draft in which the finger that `outward` moves is where it should not be."""
        [finger] = np.flatnonzero(outward.any(1))
        target = torch.from_numpy(self._outside[row])
        if self.command_space == "joint":
            joints = draft.double()
            tips = fingertips(joints)
            tips[:, finger] = target[finger]
            solved = solve_fingertips(tips, joints).unflatten(1, (4, 4))
            moved = joints.unflatten(1, (4, 4)).clone()
            moved[:, finger] = solved[:, finger]
            return moved.flatten(1).to(draft)
        moved = draft.clone()
        moved[:, finger] = torch.from_numpy(outward[finger]).to(draft)
        moved[0, finger] = (target[finger] - start[finger]).to(draft)
        return moved
