"""Execute the actions of any policy through an action interface, one control step at a time."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lerobot_dexflex.conventions import STATE, TACTILE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces import Interface, Method
from lerobot_policy_dexflex.chunk_execution import execute
from lerobot_policy_dexflex.frame_index import FRAME_INDEX
from lerobot_policy_dexflex.normalization import action_columns, action_sizes, tip_numbers


class ActionExecution:
    """Turns actions into joint targets; every action needs the observation of its control step.

    Args:
        method: What the interface is.
        interface: Commands the hand.
    """

    def __init__(self, method: Method, interface: Interface) -> None:
        self.interface = interface
        self._reads = (STATE, TACTILE) if _feels(method) else (STATE,)

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, shape (batch,) bool, or in all."""
        self.interface.reset(mask)

    @torch.no_grad()
    def step(self, observation: Mapping[str, Tensor], action: Tensor) -> Tensor:
        """Return the joint targets of this control step [rad]. Shape (batch, joints), float32.

        Rows whose `observation.frame_index` is 0 begin a new episode, where an environment offers this key.

        Args:
            observation: Raw units.
            action: Arm joint targets [rad], then fingertips in the palm frame [m]; or a dataset's whole
                action. Shape (batch, size), one step, which is then held; or (batch, steps, size), of which
                the first is executed and the others are looked at. Of `joint`, joint targets.

        Raises:
            DexFlexError: If the observation lacks a key or the action has another shape.
        """
        n_joints = self._check(observation, action)
        observation = {key: value.to(action.device) for key, value in observation.items()}
        if FRAME_INDEX in observation:
            begins = observation[FRAME_INDEX].flatten() == 0
            if begins.any():
                self.reset(None if begins.all() else begins)
        chunk = action if action.ndim == 3 else action[:, None]
        columns = action_columns(self.interface.hand, n_joints, self.interface.command_space)
        if chunk.shape[-1] != len(columns):
            chunk = chunk[..., columns]
        n_arm = n_joints - self.interface.hand.n_joints
        return execute(self.interface, n_arm, chunk, 0, observation)

    def _check(self, observation: Mapping[str, Tensor], action: Tensor) -> int:
        """Return the number of joints."""
        if missing := [key for key in self._reads if key not in observation]:
            blind = " raw and dexflex-notouch need no touch." if missing == [TACTILE] else ""
            raise DexFlexError(
                f"The interface {self.interface.name!r} reads {', '.join(self._reads)}, but the observation "
                f"lacks {', '.join(missing)}. It has: {', '.join(sorted(observation)) or 'nothing'}.{blind}"
            )
        hand, state, shape = self.interface.hand, observation[STATE], tuple(action.shape)
        if state.ndim != 2 or state.shape[1] < hand.n_joints:
            raise DexFlexError(
                f"{STATE!r} must have shape (batch, joints), the hand's {hand.n_joints} last [rad]. "
                f"Got {tuple(state.shape)}."
            )
        rows, n_joints = state.shape
        part, whole = action_sizes(hand, n_joints, self.interface.command_space)
        if action.ndim not in (2, 3) or shape[0] != rows or shape[-1] not in (part, whole):
            raise DexFlexError(
                f"The action must have shape ({rows}, size) or ({rows}, steps, size) with size {part}: "
                f"{n_joints - hand.n_joints} joint targets of the arm [rad], then {self._executed}; or "
                f"{whole}: the whole action of a dataset. Got {shape}."
            )
        return n_joints

    @property
    def _executed(self) -> str:
        if self.interface.command_space == "joint":
            return f"{self.interface.hand.n_joints} of the hand"
        return f"{tip_numbers(self.interface.hand)} fingertip coordinates in the palm frame [m]"


def _feels(method: Method) -> bool:
    """Tell whether an interface reads touch."""
    hidden = method.ablation == "notouch" or not dict(method.options).get("use_touch", True)
    return method.base not in ("joint", "raw") and not hidden
