from itertools import combinations

import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.letters import compact_letters


def test_the_letters_of_a_chain_overlap():
    # Sorted means where only far ones differ: {a,b,c}, {b,c,d}, {d,e} by hand.
    different = [("1", "4"), ("1", "5"), ("2", "5"), ("3", "5")]
    assert compact_letters("12345", different) == {"1": "a", "2": "ab", "3": "ab", "4": "bc", "5": "c"}


def test_insert_and_absorb_step_by_step():
    # 1|2: {1,3,4}, {2,3,4}. 1|3: {1,4} + ({3,4} in {2,3,4}, absorbed), {2,3,4}. 2|4: {1,4}, {2,3}, {3,4}.
    different = [("1", "2"), ("1", "3"), ("2", "4")]
    assert compact_letters("1234", different) == {"1": "a", "4": "ac", "2": "b", "3": "bc"}


def test_equal_methods_share_one_letter_and_different_ones_none():
    assert compact_letters("xyz", []) == {"x": "a", "y": "a", "z": "a"}
    assert compact_letters("xyz", list(combinations("xyz", 2))) == {"x": "a", "y": "b", "z": "c"}


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.8])
def test_names_share_a_letter_if_and_only_if_they_do_not_differ(share):
    names, rng = "abcdefgh", np.random.default_rng(0)
    for _ in range(20):
        different = [pair for pair in combinations(names, 2) if rng.random() < share]
        letters = compact_letters(names, different)
        assert letters["a"].startswith("a")
        for first, second in combinations(names, 2):
            assert bool(set(letters[first]) & set(letters[second])) == ((first, second) not in different)
        groups = {letter: {n for n in names if letter in letters[n]} for letter in "".join(letters.values())}
        assert not any(groups[x] <= groups[y] for x in groups for y in groups if x != y)


def test_a_pair_of_strangers_is_refused():
    with pytest.raises(DexFlexError, match="two of a, b"):
        compact_letters("ab", [("a", "c")])
