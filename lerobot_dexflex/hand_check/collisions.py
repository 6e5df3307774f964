"""Does the hand stand in its own way?"""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np

from lerobot_dexflex.hand_check.bench import POSTURES, Bench, sweep
from lerobot_dexflex.hand_check.finding import Finding
from lerobot_dexflex.hands import PALM, Hand

_DEEP, _SHAPES_DEEP = 0.001, 0.005
_SWEEP_STEPS = 24


class Overlap(NamedTuple):
    """How deep two links are in each other."""

    depth: float
    """[m]."""
    links: tuple[str, str]
    where: str
    """The posture."""

    def __str__(self) -> str:
        """Return the overlap as a part of a sentence."""
        return (
            f"{1000 * self.depth:.1f} mm ({' in '.join(self.links)}, {self.where})" if self.depth else "none"
        )


_NONE = Overlap(0.0, ("", ""), "")


def check_collisions(hand: Hand) -> Finding:
    """Check that no tip is inside the hand in its postures, nor inside its own finger on the way to a limit.

    In simulation only tips collide with the hand; links that overlap elsewhere are drawn wrong all the same.
    """
    bench = Bench(hand)
    at_rest, shapes, own = _NONE, _NONE, _NONE
    for posture in POSTURES:
        bench.pose(np.array(getattr(hand, posture)))
        at_rest = max(at_rest, *_contacts(bench, f"`{posture}`"), _NONE)
        shapes = max(shapes, *_shapes(hand, bench, f"`{posture}`"), _NONE)
    finger_of = {link.name: finger.name for finger in hand.fingers for link in finger.links}
    for joint, postures in zip(hand.joint_names, sweep(hand, _SWEEP_STEPS), strict=True):
        for angles in postures:
            bench.pose(angles)
            for overlap in _contacts(bench, f"moving {joint}"):
                first, second = (finger_of.get(link, PALM) for link in overlap.links)
                own = max(own, overlap) if first == second else own
    return Finding(
        "collisions",
        at_rest.depth <= _DEEP and own.depth <= _DEEP and shapes.depth <= _SHAPES_DEEP,
        f"tips in the hand at rest: {at_rest}; tips in their own finger: {own}; links in other fingers: "
        f"{shapes}",
        f"{1000 * _DEEP:.0f} mm, {1000 * _DEEP:.0f} mm and {1000 * _SHAPES_DEEP:.0f} mm or less",
        "Move the postures apart; name links that overlap at a joint in `excluded`; give `collision`, `tip` "
        "and `nose` as half sizes and radii in m in the frame of their link.",
    )


def _contacts(bench: Bench, where: str) -> Iterator[Overlap]:
    """Yield the overlaps that the simulator sees."""
    for contact in bench.data.contact:
        bodies = bench.model.geom_bodyid[contact.geom]
        first, second = (bench.model.body(body).name for body in bodies)
        yield Overlap(-float(contact.dist), (first, second), where)


def _shapes(hand: Hand, bench: Bench, where: str) -> Iterator[Overlap]:
    """Yield the overlaps of links of different fingers, which the simulator does not look for."""
    of_finger = [_geoms(bench.model, [link.name for link in finger.links]) for finger in hand.fingers]
    for some, others in combinations(of_finger, 2):
        for first in some:
            for second in others:
                distance = mujoco.mj_geomDistance(bench.model, bench.data, first, second, 0.0, None)
                if distance >= 0:
                    continue
                bodies = bench.model.geom_bodyid[[first, second]]
                names = (bench.model.body(bodies[0]).name, bench.model.body(bodies[1]).name)
                yield Overlap(-distance, names, where)


def _geoms(model: mujoco.MjModel, links: list[str]) -> list[int]:
    bodies = [model.body(link).id for link in links]
    return [int(geom) for geom in np.flatnonzero(np.isin(model.geom_bodyid, bodies))]
