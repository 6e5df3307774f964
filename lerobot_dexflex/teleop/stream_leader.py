"""A person's stream leads the hand, and the person is told what happens."""

import math

import gymnasium
import numpy as np
from numpy.typing import ArrayLike

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.experts.command import Command, fingertips_of
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.streams.record import Array
from lerobot_dexflex.streams.source import Newest, Source
from lerobot_dexflex.teleop.calibration import OpenHand
from lerobot_dexflex.teleop.follower import Follower, Status
from lerobot_dexflex.teleop.leader import Say
from lerobot_dexflex.teleop.stream_config import LeadConfig

OPEN_YOUR_HAND = "Show your open hand, thumb spread, and hold it still for a second."
HOLDS: dict[Status, str] = {
    "released": "Released: the robot stays. SPACE takes it again.",
    "waiting": "Nothing has come yet: the robot holds still.",
    "stale": "The stream stopped: the robot holds still.",
    "lost": "Your hand is not seen: the robot holds still.",
}
FOLLOWS = "The robot follows you."
NO_WRIST = "The stream does not say where your wrist is: the arm stays, the fingers follow."


class StreamLeader:
    """A person, seen by a device. Satisfies `Leader`.

    The robot stays until an open hand has been held still, and while it is released.

    Args:
        hand: The robot's.
        source: Of the person's records.
        say: Tells the person what happens.
        lead: How the person's motions become the robot's.
        engaged: Whether the hand leads as soon as it is calibrated, without `toggle`.
    """

    def __init__(self, hand: Hand, source: Source, say: Say, lead: LeadConfig, engaged: bool = False) -> None:
        self._hand, self._source, self._say, self._engaged = hand, source, say, engaged
        self._lead = lead
        self._joints: Array = np.zeros(0)
        self._now, self._end = -np.inf, np.inf
        self._told: dict[str, str] = {}
        self._status: Status = "released"
        self.calibrate()

    @property
    def ready(self) -> bool:
        """Whether it is calibrated."""
        return self._follower is not None

    @property
    def over(self) -> bool:
        """Whether a stored stream has ended."""
        return self._now > self._end

    @property
    def joints(self) -> Array:
        """Joint targets, arm then hand [rad]. Shape (arm + hand,)."""
        return self._joints if self._follower is None else self._follower.joints

    def calibrate(self) -> None:
        """See `Leader.calibrate`."""
        if self._joints.size:
            self._joints = self.joints
        self._follower: Follower | None = None
        self._told.clear()
        self._open_hand = OpenHand(self._hand, self._lead.thumb_scale)

    def toggle(self) -> None:
        """See `Leader.toggle`."""
        if self._follower is None:
            self._say(OPEN_YOUR_HAND)
        else:
            self._follower.engaged = self._engaged = not self._follower.engaged

    def begin(self, env: gymnasium.Env, index: int) -> None:
        """See `Leader.begin`."""
        del index
        self.put(env.get_wrapper_attr("command"))

    def put(self, joints: ArrayLike) -> None:
        """Go on from where a robot is: arm then hand [rad], shape (arm + hand,)."""
        self._joints = np.array(joints, float)
        if self._follower is not None:
            self._follower.begin(self._joints)

    def tick(self, now: float) -> None:
        """See `Leader.tick`."""
        if np.isinf(self._end):
            self._end = now + getattr(self._source, "duration", np.inf)
        self._now = now
        newest = self._source.newest(now)
        if self._follower is None:
            self._look(newest, now)
        else:
            self._follower.step(newest, now)
            self._tell_of(self._follower)
        # Packets come, and no record does: why?
        self._tell("refusal", str(getattr(self._source, "refusal", None) or ""))

    def command(self) -> Command | None:
        """See `Leader.command`; a glove knows no future, so a draft's steps are all the same."""
        if self.over:
            return None
        joints = self.joints
        tips = fingertips_of(self._hand, joints[-self._hand.n_joints :])
        return Command(joints, joints, np.tile(tips, (DRAFT_HORIZON, 1, 1)))

    def _look(self, newest: Newest, now: float) -> None:
        """Look for an open hand."""
        found = self._open_hand.look(newest, now)
        if found is not None:
            self._follower = Follower(found, self._joints, self._lead.scale, math.radians(self._lead.heading))
            self._follower.engaged = self._engaged
            fit = f"{found.scale:.2f} times yours, to {1e3 * found.residual:.0f} mm"
            keys = "" if self._engaged else " SPACE takes it, and releases it."
            self._say(f"Calibrated: the robot's hand is {fit}.{keys}")
            self._told["status"] = "" if self._engaged else HOLDS["released"]
        else:
            self._tell("open hand", self._open_hand.complaint or OPEN_YOUR_HAND)

    def _tell_of(self, follower: Follower) -> None:
        """Tell the status; of a hold at its second look: after a pause of the caller there is one."""
        before, self._status = self._status, follower.status
        if follower.status == "following":
            self._tell("status", FOLLOWS if follower.arm_follows else NO_WRIST)
        elif before == follower.status:
            self._tell("status", HOLDS[follower.status])

    def _tell(self, topic: str, text: str) -> None:
        """Say something about a topic, unless it is what was said last."""
        if text and text != self._told.get(topic):
            self._say(text)
        self._told[topic] = text
