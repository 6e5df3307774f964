"""Compiling numeric loops, with and without a place to keep the result."""

from lerobot_dexflex.compiled import compiled


def test_what_cannot_be_kept_is_compiled_all_the_same():
    names = {}
    exec("def double(number):\n    return 2 * number", names)  # Without a file, numba finds no folder for it.
    assert compiled(names["double"])(21) == 42
