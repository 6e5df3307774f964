"""Keys that are pressed after so many looks at them."""


class ScriptedKeys:
    """Satisfies `Keys`.

    Args:
        presses: Keys by the number of the look, which is that of the tick, control steps between two counted.
    """

    def __init__(self, presses):
        self._presses, self._looks = presses, 0

    def pressed(self):
        self._looks += 1
        yield from self._presses.get(self._looks, ())


class InterruptedKeys(ScriptedKeys):
    """Ctrl-C instead of a key. Satisfies `Keys`."""

    def pressed(self):
        for key in super().pressed():
            if key == "^":
                raise KeyboardInterrupt
            yield key
