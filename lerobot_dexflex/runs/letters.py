"""Compact letter display: which of several methods differ, told by a few letters beside their names."""

import string
from collections.abc import Collection, Sequence

from lerobot_dexflex.errors import DexFlexError

_ALPHABET = string.ascii_lowercase + string.ascii_uppercase


def compact_letters(names: Sequence[str], different: Collection[tuple[str, str]]) -> dict[str, str]:
    """Return the letters of every name: two names share a letter if and only if they do not differ.

    Insert and absorb (Piepho 2004, doi:10.1198/1061860043515): begin with one letter for all; split every
    letter that both of a differing pair have into one without the first and one without the second; drop
    letters whose names another letter has as well.

    Args:
        names: In the order of the letters, such as from the best to the worst: the first name has an `a`.
        different: Pairs of names that differ, in either order.

    Raises:
        DexFlexError: If a pair holds a name twice or one that is not among the names, or the letters run out.
    """
    groups = [frozenset(names)]
    for first, second in different:
        if first == second or not {first, second} <= set(names):
            raise DexFlexError(f"A pair must be two of {', '.join(names)}. Got {first!r} and {second!r}.")
        split = [
            part
            for group in groups
            for part in ((group - {first}, group - {second}) if {first, second} <= group else (group,))
        ]
        distinct = list(dict.fromkeys(split))
        groups = [group for group in distinct if not any(group < other for other in distinct)]
    if len(groups) > len(_ALPHABET):
        raise DexFlexError(f"{len(groups)} letters would be needed; there are {len(_ALPHABET)}.")
    groups.sort(key=lambda group: [k for k, name in enumerate(names) if name in group])
    return {
        name: "".join(letter for letter, group in zip(_ALPHABET, groups, strict=False) if name in group)
        for name in names
    }
