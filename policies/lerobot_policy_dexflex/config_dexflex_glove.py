"""Configuration of `--teleop.type=dexflex_glove`. LeRobot finds the device beside it, by the file's name."""

from dataclasses import dataclass, field

from draccus.utils import ParsingError
from lerobot.teleoperators import TeleoperatorConfig

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import xarm7
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.teleop.stream_config import STREAMS, LeadConfig, StreamConfig


@TeleoperatorConfig.register_subclass("dexflex_glove")
@dataclass(kw_only=True)
class DexflexGloveConfig(LeadConfig, TeleoperatorConfig):
    """A person's hand, seen by a glove, a headset or a camera, leads an xArm7 with a hand."""

    hand: str = "leap"
    """Which hand is on the arm: a name of `lerobot_dexflex.hands`."""
    source: str = "rokoko"
    """How records come: `rokoko`, `openxr` or `mediapipe` by UDP, or `replay` of a stored stream."""
    stream: StreamConfig = field(default_factory=StreamConfig)
    """How the stream is read."""
    start: list[float] = field(default_factory=list)
    """Joints at which the robot waits before it is led, arm then hand [rad]; none means the arm's home and
    relaxed fingers."""
    patience: float = 60.0
    """How long to wait for an open hand when it connects [s]."""

    def __post_init__(self) -> None:
        """Check all values.

        Raises:
            ParsingError: If one is invalid. draccus hides the message of a ValueError, not of this.
        """
        if self.source not in STREAMS:
            raise ParsingError(f"`source` must be one of {', '.join(STREAMS)}. Got {self.source!r}.")
        try:
            joints = len(xarm7.LINKS) + get_hand(self.hand).n_joints
            self.stream.check(self.source)
            self.check_lead()
        except DexFlexError as error:
            raise ParsingError(str(error).replace("--s", "--teleop.s")) from error
        if len(self.start) not in (0, joints):
            raise ParsingError(f"`start` must be {joints} joints [rad], or none. Got {len(self.start)}.")
        if not self.patience > 0:
            raise ParsingError(f"`patience` must be positive. Got {self.patience}.")
