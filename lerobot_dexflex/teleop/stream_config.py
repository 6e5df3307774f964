"""Which stream a person's hand comes by, how it is read and leads. Nothing here loads MuJoCo or LeRobot."""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, get_args

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.packets import check_hand
from lerobot_dexflex.streams.rokoko import PORT

Format = Literal["rokoko", "openxr", "mediapipe"]
"""What comes by UDP; see `docs/streams.md`."""
STREAMS = (*get_args(Format), "replay")
"""Where records can come from."""
_BY_UDP = ("port", "host", "hand", "save")
_READ = {
    "rokoko": (*_BY_UDP, "actor", "trust_wrist"),
    "openxr": (*_BY_UDP, "quaternions"),
    "mediapipe": (*_BY_UDP, "mirrored_image", "labels"),
    "replay": ("file",),
}
"""What each source reads of the configuration."""


@dataclass(kw_only=True)
class LeadConfig:
    """How a person's motions become the robot's."""

    scale: float = 1.0
    """Motion of the palm per motion of the wrist."""
    heading: float = 0.0
    """How far the person's forward is to the left of the robot's [deg]."""
    thumb_scale: float = 1.0
    """Extra scale of the thumb, from the wrist; 1 keeps what touches touching."""

    def check_lead(self) -> None:
        """Refuse numbers that cannot be right.

        Raises:
            DexFlexError: If there is one.
        """
        for name in ("scale", "thumb_scale"):
            if not 0 < getattr(self, name) < math.inf:
                raise DexFlexError(f"`{name}` must be positive. Got {getattr(self, name)}.")
        if not abs(self.heading) <= 360:
            raise DexFlexError(f"`heading` must be in [-360, 360] degrees. Got {self.heading}.")


@dataclass
class StreamConfig:
    """How a stream comes and is read."""

    port: int = PORT
    """UDP port to listen at."""
    host: str = "0.0.0.0"
    """Address of this machine to listen at; all of them unless told."""
    hand: str = "right"
    """Which hand of the operator leads; a left one is mirrored, for the robot's is a right one."""
    actor: str = ""
    """Rokoko: name of the person; may be empty if the scene has one only."""
    trust_wrist: bool = False
    """Rokoko: whether the wrist counts although the gloves alone do not measure where it is."""
    quaternions: str = "xyzw"
    """OpenXR: order of the numbers of orientations, `xyzw` or `wxyz`."""
    mirrored_image: bool = False
    """MediaPipe: whether the image was flipped, like a selfie, before the hand was looked for."""
    labels: str = "subject"
    """MediaPipe: for which images `handedness` names the person's hand, `subject` or `selfie`."""
    file: Path | None = None
    """Replay: the stored stream."""
    save: Path | None = None
    """Store what comes in this new file, for a replay."""

    def check(self, source: str) -> None:
        """Refuse settings that cannot be right, or that a source does not read.

        Args:
            source: One of `STREAMS`, or another that reads none.

        Raises:
            DexFlexError: If there is one, or the file of a replay is missing.
        """
        check_hand(self.hand)
        if not 0 <= self.port < 2**16:
            raise DexFlexError(f"`port` must be in [0, 65535]; 0 takes a free one. Got {self.port}.")
        read = _READ.get(source, ())
        default = StreamConfig()
        changed = [f.name for f in fields(self) if getattr(self, f.name) != getattr(default, f.name)]
        if idle := [name for name in changed if name not in read]:
            valid = ", ".join(f"--stream.{name}" for name in read) or "none"
            raise DexFlexError(f"--source={source} does not read --stream.{idle[0]}. It reads: {valid}.")
        if source == "replay" and self.file is None:
            raise DexFlexError(
                "--source=replay needs --stream.file=<stored stream>, which --stream.save=<file> makes."
            )
