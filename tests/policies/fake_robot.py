"""A robot that does as it is told at once, as LeRobot finds third-party robots: config and class by name."""

from dataclasses import dataclass

from lerobot.robots import Robot, RobotConfig

from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import LEAP


@RobotConfig.register_subclass("fake_xarm7_leap")
@dataclass(kw_only=True)
class FakeRobotConfig(RobotConfig):
    pass


class FakeRobot(Robot):
    config_class = FakeRobotConfig
    name = "fake_xarm7_leap"
    sent: list = []  # noqa: RUF012
    """All actions of all of them."""

    def __init__(self, config):
        super().__init__(config)
        self._connected = False
        self._joints = dict.fromkeys(self.action_features, 0.0)
        self.cameras = {}

    @property
    def action_features(self):
        return {f"{joint}.pos": float for joint in robot_joints(LEAP)}

    @property
    def observation_features(self):
        return self.action_features

    @property
    def is_connected(self):
        return self._connected

    @property
    def is_calibrated(self):
        return True

    def connect(self, calibrate=True):
        self._connected = True

    def calibrate(self):
        pass

    def configure(self):
        pass

    def get_observation(self):
        return self._joints

    def send_action(self, action):
        self._joints = action
        self.sent.append(action)
        return action

    def disconnect(self):
        self._connected = False
