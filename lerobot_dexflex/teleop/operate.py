"""Put a session together from its configuration, and run it."""

import contextlib
import sys
from collections.abc import Iterator

import gymnasium

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.source import check_source
from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.envs.registration import NAMESPACE, TASKS
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.recording.attempt import one_thread
from lerobot_dexflex.recording.recipe import SIMULATED
from lerobot_dexflex.teleop.clock import SteppedClock, SystemClock
from lerobot_dexflex.teleop.config import TeleopConfig
from lerobot_dexflex.teleop.hands import Hands
from lerobot_dexflex.teleop.keys import HELP, Keys, NoKeys, TerminalKeys
from lerobot_dexflex.teleop.leader import ExpertLeader, Leader, Say
from lerobot_dexflex.teleop.session import Rules, Session
from lerobot_dexflex.teleop.shelf import open_shelf
from lerobot_dexflex.teleop.sources import open_source
from lerobot_dexflex.teleop.stream_leader import StreamLeader
from lerobot_dexflex.teleop.view import NoView, View, make_view

LATE = 0.05
"""Share of late ticks that is worth telling."""


def operate(config: TeleopConfig, arguments: list[str] | None = None, keys: Keys | None = None) -> bool:
    """Run a session; at its end, however it ends, the dataset holds every episode that was kept.

    Args:
        config: What to do.
        arguments: Command-line arguments for the card; None takes those of this process.
        keys: Of the operator; None reads the terminal.

    Returns:
        True, as a session that the operator leaves is no failure.

    Raises:
        DexFlexError: If something is missing, or the recording cannot go on; nothing is lost then.
        KeyboardInterrupt: After an interrupt, when the dataset is written.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(one_thread())
        pressed = stack.enter_context(_terminal(config)) if keys is None else keys
        leader = stack.enter_context(_leader(config, _say))
        shelf = stack.enter_context(open_shelf(config, arguments))
        if shelf is None:
            _say(f"{config.root} is complete: {config.episodes} episodes. Nothing to record.")
            return True
        hands, env = _hands(config), stack.enter_context(_environment(config))
        rules = Rules(
            config.episodes, config.seed, config.hands_free, round(config.time_limit / CONTROL_PERIOD)
        )
        _say(f"{TASKS[config.task].description}\n{HELP}")
        session = Session(env, leader, hands, shelf, pressed, _view(config), rules, _say)
        session.run(SystemClock() if config.realtime else SteppedClock())
        if session.late > LATE * session.ticks:
            _say(f"This machine is slow: {session.late} of {session.ticks} ticks came late.")
    return True


def _say(text: str) -> None:
    print(text, flush=True)


@contextlib.contextmanager
def _terminal(config: TeleopConfig) -> Iterator[Keys]:
    """Read the terminal's keys; who is hands-free needs none."""
    if config.hands_free and not sys.stdin.isatty():
        yield NoKeys()
    else:
        with TerminalKeys() as keys:
            yield keys


@contextlib.contextmanager
def _leader(config: TeleopConfig, say: Say) -> Iterator[Leader]:
    if config.source == SIMULATED:
        yield ExpertLeader(config.task, config.seed)
        return
    with open_source(config.source, config.stream) as source:
        yield StreamLeader(get_hand(config.hand), source, say, config, engaged=config.hands_free)


def _hands(config: TeleopConfig) -> Hands:
    interface = make_interface(get_hand(config.hand), config.interface, config.controller)
    if config.source != SIMULATED:
        return Hands(interface)
    errors, source = CommandErrors.parse(config.simulated.glove), check_source(config.simulated.source)
    return Hands(interface, config.seed, errors, source)


@contextlib.contextmanager
def _environment(config: TeleopConfig) -> Iterator[gymnasium.Env]:
    """Make the task without its time limit, which is an expert's."""
    env = gymnasium.make(
        f"{NAMESPACE}/{config.task}", hand=config.hand, disable_env_checker=True, max_episode_steps=-1
    )
    try:
        yield env
    finally:
        env.close()


def _view(config: TeleopConfig) -> View:
    if config.view == "none":
        return NoView()
    return make_view(config.interface, config.view_folder, config.root)
