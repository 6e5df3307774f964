"""Keys of the operator, read without waiting for them."""

import sys
from collections.abc import Iterator
from queue import Empty, SimpleQueue
from typing import Protocol, Self

from lerobot_dexflex.errors import DexFlexError

HELP = "SPACE take or release   s start   k keep   d discard   o open hand again   q quit"


class Keys(Protocol):
    """What was pressed."""

    def pressed(self) -> Iterator[str]:
        """Yield the keys that were pressed since the last call: a character, `space`, `esc`, ..."""
        ...


class NoKeys:
    """Nobody presses anything. Satisfies `Keys`."""

    def pressed(self) -> Iterator[str]:
        """Yield nothing."""
        yield from ()


class TerminalKeys:
    """Keys of this terminal, over ssh, too. Satisfies `Keys`; use it in a `with`, which restores it.

    LeRobot's reader, which needs no display. Its other one listens to the whole desktop: somebody who types a
    `q` elsewhere would end the session.

    Raises:
        DexFlexError: If standard input is no terminal.
    """

    def __init__(self) -> None:
        # LeRobot takes seconds to import.
        from lerobot.utils.keyboard_input import TerminalKeyListener

        if not sys.stdin.isatty():
            raise DexFlexError(
                "There is no terminal to press keys in. Run this in one, or begin and end episodes by "
                "themselves: --hands_free."
            )
        self._queue: SimpleQueue[str] = SimpleQueue()
        self._listener = TerminalKeyListener(self._queue.put)

    def pressed(self) -> Iterator[str]:
        """Yield the keys that were pressed since the last call."""
        while True:
            try:
                yield self._queue.get_nowait()
            except Empty:
                return

    def __enter__(self) -> Self:
        self._listener.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.stop()
