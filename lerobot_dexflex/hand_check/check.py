"""All checks of a hand, and the table of what they found."""

from collections.abc import Callable, Iterator, Sequence

from lerobot_dexflex.hand_check.collisions import check_collisions
from lerobot_dexflex.hand_check.finding import Finding
from lerobot_dexflex.hand_check.fingertip import check_pads, check_taxels, check_tips
from lerobot_dexflex.hand_check.motion import check_inverse, check_opposition
from lerobot_dexflex.hand_check.numbers import check_limits, check_strength
from lerobot_dexflex.hand_check.postures import check_facing, check_mount, check_order, check_region
from lerobot_dexflex.hand_check.simulation import check_holding, check_motors
from lerobot_dexflex.hands import Hand

CHECKS: tuple[Callable[[Hand], Finding], ...] = (
    check_limits,
    check_tips,
    check_pads,
    check_taxels,
    check_facing,
    check_order,
    check_region,
    check_opposition,
    check_inverse,
    check_strength,
    check_mount,
    check_collisions,
    check_motors,
    check_holding,
)
"""From the numbers themselves to what the simulator makes of them."""


def findings(hand: Hand) -> Iterator[Finding]:
    """Yield what every check finds.

    Raises:
        DexFlexError: If the simulator refuses the hand's numbers.
    """
    for check in CHECKS:
        yield check(hand)


def told(finding: Finding) -> str:
    """Return a finding in a line; of a failed check also what would be valid, and the remedy."""
    line = f"{'pass' if finding.passed else 'FAIL'}  {finding.check:<12}{finding.found}"
    if finding.passed:
        return line
    indent = "\n" + " " * 18
    return f"{line}{indent}valid: {finding.valid}{indent}{finding.remedy}"


def summary(hand: Hand, found: Sequence[Finding]) -> str:
    """Return how many checks a hand passes, and the names of those that it fails."""
    failed = [finding.check for finding in found if not finding.passed]
    if not failed:
        return f"{hand.name} passes all {len(found)} checks."
    return f"{hand.name} fails {len(failed)} of {len(found)} checks: {', '.join(failed)}."
