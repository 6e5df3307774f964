"""MuJoCo 4 is a C extension without type information: to pyright, everything in it is Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
