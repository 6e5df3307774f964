"""Hands as data: their numbers and how to get one by name."""

from lerobot_dexflex.hands.body import PALM as PALM
from lerobot_dexflex.hands.finger import Finger as Finger
from lerobot_dexflex.hands.hand import Hand as Hand
from lerobot_dexflex.hands.leap import LEAP as LEAP
from lerobot_dexflex.hands.registry import HANDS as HANDS
from lerobot_dexflex.hands.registry import get_hand as get_hand
from lerobot_dexflex.hands.sharpa import SHARPA as SHARPA
