"""The console script `dexflex-hand`."""

import sys

from lerobot_dexflex import console
from lerobot_dexflex.hand_check.check import findings, summary, told
from lerobot_dexflex.hand_check.config import HandCheckConfig
from lerobot_dexflex.hand_check.portrait import write_film, write_picture
from lerobot_dexflex.hands import get_hand


def main(arguments: list[str] | None = None) -> int:
    """Check a hand; return 0 if it passes every check, 1 if not or after an error, 130 after an interrupt.

    Args:
        arguments: Command-line arguments, `check` and the hand's name first; None takes those of this
            process.
    """
    words = sys.argv[1:] if arguments is None else arguments
    return console.run(HandCheckConfig, lambda config, _: _check(config), _with_flag(words))


def _with_flag(words: list[str]) -> list[str]:
    """Return `check NAME ...` as `--hand=NAME ...`; anything else as it is."""
    if words[:1] != ["check"]:
        return words
    name, rest = words[1:2], words[2:]
    return [*(word if word.startswith("-") else f"--hand={word}" for word in name), *rest]


def _check(config: HandCheckConfig) -> int:
    hand = get_hand(config.hand)
    print(f"{hand.name}: {hand.n_fingers} fingers, {hand.n_joints} joints", flush=True)
    found = []
    for finding in findings(hand):
        found.append(finding)
        print(told(finding), flush=True)
    print(summary(hand, found))
    write_picture(hand, config.output / "hand.png")
    print(f"picture: {config.output / 'hand.png'}")
    if config.film:
        write_film(hand, config.output / "sweep.mp4")
        print(f"film: {config.output / 'sweep.mp4'}")
    return 0 if all(finding.passed for finding in found) else 1


if __name__ == "__main__":
    sys.exit(main())
