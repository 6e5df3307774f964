"""Execute predicted chunks step by step through an action interface."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lerobot_dexflex.conventions import DRAFT_HORIZON, STATE
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces import Interface
from lerobot_policy_dexflex.drafts import joint_draft, tip_draft
from lerobot_policy_dexflex.normalization import N_HAND_JOINTS


class ChunkExecution:
    """The plan of one policy and how far it has been executed.

    Args:
        interface: Commands the hand.
        n_arm: Leading joints of the arm, which are executed as planned.
        n_steps: Control steps executed before a new chunk is due.
    """

    def __init__(self, interface: Interface, n_arm: int, n_steps: int) -> None:
        self.interface = interface
        self._n_arm, self._n_steps = n_arm, n_steps
        self.reset()

    @property
    def due(self) -> bool:
        """Whether a chunk must be planned before the next step."""
        return self._chunk is None or self._step >= self._n_steps

    def reset(self) -> None:
        """Begin a new episode in every row: forget the chunk and the last command."""
        self.interface.reset()
        self._chunk: Tensor | None = None
        self._step = 0

    def begin(self, chunk: Tensor) -> None:
        """Follow a new chunk from its first step on.

        Args:
            chunk: Arm joints [rad], then what the interface executes: hand joints [rad] or
                fingertips in the palm frame [m], both absolute. Shape (batch, steps, n_arm + 16 or 12).
        """
        self._chunk, self._step = chunk.float(), 0

    def step(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Return the joint targets of the chunk's next step [rad]. Shape (batch, n_arm + 16), float32.

        Args:
            batch: Observation in raw units.
        """
        assert self._chunk is not None
        # --policy.use_amp=true is for the networks that plan: bfloat16 resolves a joint to 0.01 rad only.
        with torch.autocast(self._chunk.device.type, enabled=False):
            return self._step_in_full_precision(self._chunk, batch)

    def _step_in_full_precision(self, chunk: Tensor, batch: Mapping[str, Tensor]) -> Tensor:
        arm, hand = chunk[..., : self._n_arm], chunk[..., self._n_arm :]
        if self.interface.command_space == "joint":
            draft = joint_draft(hand, self._step, DRAFT_HORIZON)
        else:
            planned = hand.double().unflatten(-1, (4, 3))
            tips = fingertips(batch[STATE][:, -N_HAND_JOINTS:].double())
            draft = tip_draft(planned, self._step, DRAFT_HORIZON, tips)
        hand_targets = self.interface.step(batch, draft).to(chunk.dtype)
        targets = torch.cat([arm[:, self._step], hand_targets], -1)
        self._step += 1
        return targets
