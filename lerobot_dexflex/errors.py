"""The one exception type that callers may want to catch."""


class DexFlexError(ValueError):
    """An input the library refuses; the message names what was wrong, what is valid and the remedy."""
