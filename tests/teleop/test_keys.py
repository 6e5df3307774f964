import os
import pty
import sys
import time

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.teleop.keys import NoKeys, TerminalKeys


def wait_for(keys, count):
    """Return so many keys, or those that came within two seconds."""
    found, until = [], time.monotonic() + 2.0
    while len(found) < count and time.monotonic() < until:
        found += keys.pressed()
        time.sleep(0.01)
    return found


def test_keys_of_a_terminal_come_without_enter_and_without_waiting(monkeypatch):
    import termios

    main, terminal = pty.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        before = termios.tcgetattr(terminal)
        with TerminalKeys() as keys:
            assert list(keys.pressed()) == []
            os.write(main, b"s k")
            assert wait_for(keys, 3) == ["s", "space", "k"]
        assert termios.tcgetattr(terminal) == before
    os.close(main)


def test_without_a_terminal_the_remedy_is_told(monkeypatch):
    with open(os.devnull) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with pytest.raises(DexFlexError, match=r"no terminal to press keys in.*--hands_free"):
            TerminalKeys()


def test_nobody_presses_nothing():
    assert list(NoKeys().pressed()) == []
