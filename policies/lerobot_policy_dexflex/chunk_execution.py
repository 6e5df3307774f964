"""Execute predicted chunks step by step through an action interface."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lerobot_dexflex.conventions import DRAFT_HORIZON, STATE
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces import Interface
from lerobot_policy_dexflex.drafts import joint_draft, tip_draft


class ChunkExecution:
    """The plan of one policy and how far it has been executed.

    Args:
        interface: Commands the hand.
        n_arm: Leading joints of the arm, which are executed as planned.
        n_steps: Control steps executed before a new chunk is due.
    """

    def __init__(self, interface: Interface, n_arm: int, n_steps: int) -> None:
        self.interface, self._n_arm, self._n_steps = interface, n_arm, n_steps
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
            chunk: As `execute` takes it. Shape (batch, steps, n_arm + hand's).
        """
        self._chunk, self._step = chunk, 0

    def step(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Return the joint targets of the chunk's next step [rad]. Shape (batch, joints), float32.

        Args:
            batch: Observation in raw units.
        """
        assert self._chunk is not None
        targets = execute(self.interface, self._n_arm, self._chunk, self._step, batch)
        self._step += 1
        return targets


def execute(
    interface: Interface, n_arm: int, chunk: Tensor, step: int, observation: Mapping[str, Tensor]
) -> Tensor:
    """Return the joint targets of one step of a chunk [rad]. Shape (batch, joints), float32.

    Args:
        interface: Commands the hand.
        n_arm: Leading joints of the arm, which are executed as planned.
        chunk: Arm joints [rad], then what the interface executes: hand joints [rad] or fingertips in the
            palm frame [m], both absolute. Shape (batch, steps, n_arm + hand's).
        step: Of the chunk; the draft holds this and all that follow.
        observation: In raw units.
    """
    # --policy.use_amp=true is for the networks that plan: bfloat16 resolves a joint to 0.01 rad only.
    with torch.autocast(chunk.device.type, enabled=False):
        chunk = chunk.float()
        arm, part = chunk[..., :n_arm], chunk[..., n_arm:]
        if interface.command_space == "joint":
            draft = joint_draft(part, step, DRAFT_HORIZON)
        else:
            hand = interface.hand
            planned = part.double().unflatten(-1, (hand.n_fingers, 3))
            tips = fingertips(hand, observation[STATE][:, -hand.n_joints :].double())
            draft = tip_draft(planned, step, DRAFT_HORIZON, tips)
        hand_targets = interface.step(observation, draft).to(chunk.dtype)
        return torch.cat([arm[:, step], hand_targets], -1)
