"""The learned controller: propose, dream, score and decode fingertip motion around a draft."""

from lerobot_dexflex.controller.chunks import Candidates as Candidates
from lerobot_dexflex.controller.config import ControllerConfig as ControllerConfig
from lerobot_dexflex.controller.controller import DexFlexController as DexFlexController
from lerobot_dexflex.controller.controller import Dream as Dream
from lerobot_dexflex.controller.controller import Selection as Selection
from lerobot_dexflex.controller.encoder import State as State
from lerobot_dexflex.controller.history import History as History
from lerobot_dexflex.controller.history import HistoryBuffer as HistoryBuffer
from lerobot_dexflex.controller.settings import SelectionSettings as SelectionSettings
