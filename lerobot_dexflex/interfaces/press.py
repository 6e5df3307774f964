"""The hand-written grip: every finger that touches presses with the same force."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import pads
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface, Measured, check_draft
from lerobot_dexflex.interfaces.grip import NO_SERVO, Grip, ServoSettings, loads_of
from lerobot_dexflex.interfaces.raw import MEANING
from lerobot_dexflex.interfaces.touch_watch import checked_taxels


@dataclass(frozen=True)
class PressSettings:
    """Force and rules of `press`, found by a first search on training objects (`eval/LOG.md`).

    Raises:
        DexFlexError: If a value is out of its range.
    """

    force: float = 1.5
    """With which every touching finger presses along its pad's normal [N]."""
    release: float = 0.0
    """A finger that the draft takes outward by more within its horizon [m] stops pressing; 0: never."""
    blocked: bool = False
    """Whether fingers that carry load do not move outward at all."""
    smoothing: float = 1.0
    """Weight of the newest motion in a one-pole low-pass, in (0, 1]; 1 does not smooth."""

    def __post_init__(self) -> None:
        if not (self.force >= 0 and self.release >= 0 and 0 < self.smoothing <= 1):
            raise DexFlexError(
                "`force` [N] and `release` [m] must be 0 or more, `smoothing` in (0, 1]. "
                f"Got {self.force}, {self.release} and {self.smoothing}."
            )


class PressInterface(CommandedInterface):
    """Follow the draft and press with every finger that touches. Satisfies `Interface`.

    The best grip that one constant gives: no finger is pressed for another's sake, nothing is known of what
    is held. It is the baseline for whoever supplies the grip.

    Args:
        hand: The hand that it serves.
        settings: Force and rules.
        servo: Of the felt load; none if None.
    """

    name: str = "press"

    def __init__(
        self, hand: Hand, settings: PressSettings | None = None, servo: ServoSettings | None = None
    ) -> None:
        super().__init__(hand)
        self.settings = settings or PressSettings()
        self._grip = Grip(hand, servo or NO_SERVO)
        self._average: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        super().reset(mask)
        self._grip.reset(mask)
        if mask is None or self._average is None:
            self._average = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._average.device)
        # NaN marks a row without a past: its next motion becomes its average.
        self._average = self._average.masked_fill(mask[:, None, None], torch.nan)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the draft's first step and the grip; see `Interface.step`."""
        with self.all_or_nothing(self._grip):
            measured = self._hand.look(observation)
            rows, fingers = len(measured.joints), self.hand.n_fingers
            checked = check_draft(draft, (fingers, 3), rows, MEANING)
            taxels = checked_taxels(self.hand, observation, rows)
            if taxels is None:
                loads = torch.full_like(measured.tips[..., 0], torch.nan)
            else:
                loads = loads_of(self.hand, taxels).double()
            return self._press(measured, checked, loads).to(draft.dtype)

    def _press(self, measured: Measured, draft: Tensor, loads: Tensor) -> Tensor:
        settings = self.settings
        inward = pads(self.hand, measured.joints)[1]
        holding = self._grip.feel(loads)
        motion = self._smooth(draft[:, 0])
        if settings.release:
            holding = holding & (-(draft[:, -1] * inward).sum(-1) < settings.release)
        if settings.blocked:
            outward = (motion * inward).sum(-1, keepdim=True).clamp(max=0.0)
            motion = motion - torch.where(holding[..., None], outward, 0.0) * inward
        forces = settings.force * inward * holding[..., None]
        torques, push = self._grip.exert(measured.joints, forces, loads)
        return self.move(measured, motion, push, torques)

    def _smooth(self, newest: Tensor) -> Tensor:
        weight = self.settings.smoothing
        if weight == 1.0:
            return newest
        average = newest if self._average is None else self._average
        average = torch.where(average.isnan(), newest, average)
        self._average = average + weight * (newest - average)
        return self._average


def make_press(
    hand: Hand,
    force: float = PressSettings.force,
    release: float = PressSettings.release,
    blocked: bool = PressSettings.blocked,
    smoothing: float = PressSettings.smoothing,
    servo: float = NO_SERVO.gain,
    back: float = NO_SERVO.back,
    limit: float = ServoSettings.limit,
) -> PressInterface:
    """Build the interface from the words of a method's name; see `PressSettings` and `ServoSettings`."""
    settings = PressSettings(force, release, blocked, smoothing)
    return PressInterface(hand, settings, ServoSettings(servo, back, limit=limit))
