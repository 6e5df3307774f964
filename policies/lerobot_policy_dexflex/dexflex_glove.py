"""A person's hand as a LeRobot teleoperator: joint targets by name, from inverse kinematics of a stream."""

import logging
from contextlib import ExitStack
from typing import Any

from lerobot.lerobot_types import RobotAction
from lerobot.teleoperators import Teleoperator
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import xarm7
from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.teleop.clock import TICK, Clock, SystemClock
from lerobot_dexflex.teleop.sources import open_source
from lerobot_dexflex.teleop.stream_leader import StreamLeader
from lerobot_policy_dexflex.config_dexflex_glove import DexflexGloveConfig

_logger = logging.getLogger(__name__)


class DexflexGlove(Teleoperator):
    """Leads any robot whose action is `joint1.pos` ... `joint7.pos`, then the hand's joints [rad].

    The robot must wait at `config.start` when it connects. It stays there until an open hand was held still;
    then it follows, and holds still within 100 ms when the stream stops or the hand is lost.

    Args:
        config: What leads, and how.
        clock: Of the stream's age.
    """

    config_class = DexflexGloveConfig
    name = "dexflex_glove"

    def __init__(self, config: DexflexGloveConfig, clock: Clock | None = None) -> None:
        super().__init__(config)
        self.config = config
        self._hand = get_hand(config.hand)
        self._clock = clock or SystemClock()
        self._stack = ExitStack()
        self._leader: StreamLeader | None = None

    @property
    def action_features(self) -> dict[str, type]:
        """Joints by name, arm then hand [rad]."""
        return {f"{joint}.pos": float for joint in robot_joints(self._hand)}

    @property
    def feedback_features(self) -> dict[str, type]:
        """None: no glove here pushes back."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether it listens."""
        return self._leader is not None

    @property
    def is_calibrated(self) -> bool:
        """Whether it has seen an open hand since it connected."""
        return self._leader is not None and self._leader.ready

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Listen, and wait for an open hand.

        Args:
            calibrate: Whether to wait; without, the robot waits, in `get_action`, until there was one.

        Raises:
            DexFlexError: If the port or file cannot be had, or no open hand is seen in time.
        """
        config = self.config
        source = self._stack.enter_context(open_source(config.source, config.stream))
        self._leader = StreamLeader(self._hand, source, _logger.info, config, engaged=True)
        self._leader.put(config.start or (*xarm7.HOME, *self._hand.relaxed_joints))
        if calibrate:
            try:
                self.calibrate()
            except BaseException:
                self.disconnect()
                raise

    @check_if_not_connected
    def calibrate(self) -> None:
        """Wait for an open hand.

        Raises:
            DexFlexError: If none is seen in time.
        """
        assert self._leader is not None
        now = self._clock.now()
        until = now + self.config.patience
        while not self._leader.ready:
            self._leader.tick(now)
            if now > until or self._leader.over:
                raise DexFlexError(
                    f"{self.config.source} showed no open hand in {self.config.patience:g} s. Check that it "
                    "sends to this machine and port, and hold the open hand still; --teleop.patience waits "
                    "for longer."
                )
            self._clock.wait(now + TICK)
            now = self._clock.now()

    def configure(self) -> None:
        """Do nothing: all there is to set is in the configuration."""

    @check_if_not_connected
    def get_action(self) -> RobotAction:
        """Return the joint targets of now, by name [rad]."""
        assert self._leader is not None
        self._leader.tick(self._clock.now())
        return dict(zip(self.action_features, self._leader.joints.tolist(), strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing; see `feedback_features`."""
        del feedback

    @check_if_not_connected
    def disconnect(self) -> None:
        """Stop listening."""
        self._leader = None
        self._stack.close()
