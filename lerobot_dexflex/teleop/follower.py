"""From a stream of records to joint targets: the hand follows, or holds still and knows why."""

from math import inf
from typing import Literal

from lerobot_dexflex.streams.record import Array, Record
from lerobot_dexflex.streams.retarget import Retargeting
from lerobot_dexflex.streams.source import STALE_AFTER, Newest
from lerobot_dexflex.streams.wrist_frame import Frame
from lerobot_dexflex.teleop.clutch import Clutch
from lerobot_dexflex.teleop.fingers import FingerLead
from lerobot_dexflex.teleop.ik import RobotIK

Status = Literal["released", "waiting", "stale", "lost", "following"]
"""`released`: the operator's clutch is out. `waiting`: no record has come. `stale`: records stopped coming.
`lost`: the device does not see the hand. In all of them the robot holds still."""


class Follower:
    """Leads arm and hand by records, tick by tick.

    A record leads for 100 ms, counted from the look before the one that found it: nothing moves on an older
    one, however late the looks are. What was solved is kept in the inverse kinematics alone: who asks between
    two looks gets the newest, and while it holds, the same to the last bit.

    Args:
        retargeting: Of this person.
        joints: Where the robot is, arm then hand [rad]. Shape (arm + hand,).
        scale: Motion of the palm per motion of the wrist.
        heading: See `Clutch`.
    """

    def __init__(
        self, retargeting: Retargeting, joints: Array, scale: float = 1.0, heading: float = 0.0
    ) -> None:
        self._ik = RobotIK(retargeting.hand, joints)
        self._clutch = Clutch(retargeting.offset, scale, heading)
        self._fingers = FingerLead(retargeting, self._ik.tips)
        self._record: Record | None = None
        self._came, self._last = -inf, -inf
        self.engaged = False
        """Whether the operator leads. Set it as you like."""
        self.status: Status = "released"
        """Of the last step."""

    @property
    def joints(self) -> Array:
        """Joint targets, arm then hand [rad]. Shape (arm + hand,)."""
        return self._ik.joints

    @property
    def arm_follows(self) -> bool:
        """Whether the last record said where the wrist is."""
        return self._record is not None and self._record.wrist_tracked

    def begin(self, joints: Array) -> None:
        """Go on from where the robot is after a reset: joints [rad], shape (arm + hand,)."""
        self._ik.put(joints)
        self._fingers.begin(self._ik.tips)
        self._clutch.uncouple()

    def step(self, newest: Newest, now: float) -> None:
        """Follow the newest record for the time since the last step, or hold still.

        Args:
            newest: Of the source.
            now: The caller's clock [s].
        """
        if newest.record is not self._record:
            # It may have come right after the last look; before the first, nobody knows when.
            self._record, self._came = newest.record, self._last
        dt, self._last = now - self._last, now
        self.status = self._judge(newest, now)
        if self.status != "following" or self._record is None:
            self._clutch.uncouple()
            self._fingers.lose()
        elif dt > 0:  # At most 100 ms: after a longer pause the record found is stale.
            self._ik.solve(self._palm(self._record), self._fingers.lead(self._record, dt), dt)

    def _judge(self, newest: Newest, now: float) -> Status:
        if not self.engaged:
            return "released"
        if newest.record is None:
            return "waiting"
        if newest.stale or now - self._came > STALE_AFTER:
            return "stale"
        return "lost" if newest.record.is_lost else "following"

    def _palm(self, record: Record) -> Frame | None:
        if not record.wrist_tracked:
            self._clutch.uncouple()
            return None
        return self._clutch.lead(Frame(record.wrist_position, record.wrist_rotation), self._ik.palm)
