"""Find how a hand holds tools: from the posture in which its pads face each other, by small searches.

That posture says in which direction the fingers push, hence the working frame. Where a bar is between the
pads, and where on it the opposing pads are, is what lays pads flattest on bars of all widths as they lean.
"""

from collections.abc import Callable, Iterable

import numpy as np
import torch
from scipy.optimize import minimize

from lerobot_dexflex.experts.command import Array
from lerobot_dexflex.experts.tool.grip import Handle, pad_places, without
from lerobot_dexflex.experts.tool.holds import BAR_RADIUS, PUSH, BarHold, DriverHold, Habit, Holds
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.contacts import solve_pads
from lerobot_dexflex.hand.grasp_frame import palm_turn
from lerobot_dexflex.hand.kinematics import pads
from lerobot_dexflex.hands import Hand

ROOM = 0.024
"""How far from a bar the open pads are [m]."""
_RADII, _LEANS, _TURNS = (0.010, 0.013, 0.016), (-0.3, 0.0, 0.3), (-0.35, 0.0, 0.35)
"""Of the bars that a hold is tried with: [m], [rad], and turns of the fingers about upright ones [rad]."""
_DISTANCE, _MISALIGNMENT, _MARGIN = 0.002, 0.05, 0.1
"""What counts as much: pads off by so much [m], one minus the cosine of their tilt, and joints that are at
their limits; these count less the farther from them they are, up to this angle [rad]."""
_APPROACH = 0.2
"""From where hands reach straight for a driver [m]: they may turn on their way to there."""
_ROLL, _PER_METRE = 0.9, 50.0
"""How far fingers roll a driver in a stroke [rad], and what angle is searched for like a metre [rad/m]."""
_ROLLING_V = 0.275
"""By how much the pads that roll a driver are turned toward each other [rad], on each side."""
_V = 0.25
"""By how much the two pads of a habit are turned toward each other [rad]."""
_SHIFT = -0.03
"""See `Habit.shift`."""

Places = tuple[Array, Array]
"""Where pads are [m] and normals into the bar, palm frame, each (fingers, 3)."""


def find_holds(hand: Hand) -> Holds:
    """Return how a hand holds tools."""
    frame = working_frame(hand)
    bar = _find_bar(hand, frame)
    habits = _find_habit(hand, frame, 0), _find_habit(hand, frame, 1)
    return Holds(frame, bar, bar, _find_driver(bar), habits)


def working_frame(hand: Hand) -> Array:
    """Return the axes of a hand's working frame in its palm frame, as columns. Shape (3, 3)."""
    _, outward = pads(hand, torch.tensor([hand.nominal_joints]))
    alike = palm_turn(hand)
    push = alike.T @ outward[0, list(hand.opposed_fingers)].mean(0).numpy()
    return alike @ rotation_matrix(np.array([0.0, np.arctan2(push[2], -push[0]), 0.0]))


def _nominal(hand: Hand, frame: Array) -> Array:
    """Return where the pads are in the nominal posture, working frame [m]. Shape (fingers, 3)."""
    centres, _ = pads(hand, torch.tensor([hand.nominal_joints]))
    return centres[0].numpy() @ frame


def _find_bar(hand: Hand, frame: Array) -> BarHold:
    opposed, opposing = list(hand.opposed_fingers), list(hand.opposing_fingers)
    nominal = _nominal(hand, frame)
    start = 0.5 * (nominal[opposed].mean(0) + nominal[opposing].mean(0))

    def made(values: Array) -> BarHold:
        centre, along = start + values[:3], nominal[:, 1].copy()
        along[opposed] += values[3]
        along[opposing] += values[4]
        along -= centre[1]
        return BarHold(hand, frame, centre, np.array(hand.nominal_joints), _idle(hand), along, room=ROOM)

    def asked(hold: BarHold) -> Iterable[Places]:
        for radius in _RADII:
            for lean in _LEANS:
                axis = rotation_matrix(np.array([lean, 0.0, 0.0])) @ np.array([0.0, 1.0, 0.0])
                yield pad_places(hand, frame, Handle(hold.centre, axis, radius), hold.along, PUSH)

    hold = made(_best(hand, range(hand.n_fingers), lambda values: asked(made(values)), 5))
    bar = Handle(hold.centre, np.array([0.0, 1.0, 0.0]), BAR_RADIUS)
    return hold._replace(touch=_solved(hand, [pad_places(hand, frame, bar, hold.along, PUSH)])[0])


def _find_driver(bar: BarHold) -> DriverHold:
    hand, opposed, opposing = bar.hand, list(bar.hand.opposed_fingers), list(bar.hand.opposing_fingers)

    def made(values: Array) -> DriverHold:
        along, around = bar.along.copy(), np.zeros(hand.n_fingers)
        along[opposing] += values[3]
        turn = _PER_METRE * values[4]
        around[opposed], around[opposing] = turn + _ROLLING_V, turn - _ROLLING_V
        rolled = bar._replace(centre=bar.centre + values[:3], along=along, approach=_APPROACH)
        return DriverHold(rolled, around, _ROLL)

    def asked(hold: DriverHold) -> Iterable[Places]:
        for radius in _RADII[:2]:
            handle = Handle(hold.bar.centre, np.array([0.0, 1.0, 0.0]), radius)
            for back in (-_ROLL / 2, 0.0, _ROLL / 2):
                yield pad_places(hand, bar.frame, handle, hold.bar.along, PUSH, *hold.places(handle, back))

    return made(_best(hand, without(hand, -1), lambda values: asked(made(values)), 5))


def _find_habit(hand: Hand, frame: Array, place: int) -> Habit:
    first, second = hand.opposed_fingers[place : place + 2]
    opposing = list(hand.opposing_fingers)
    nominal, fingers = _nominal(hand, frame), (first, second, *opposing)
    around, beside = np.zeros(hand.n_fingers), np.zeros(hand.n_fingers)
    around[[first, second]] = _V, -_V
    beside[[first, second]] = np.array([-0.5, 0.5]) * hand.pad_spacing + BAR_RADIUS * np.sin([_V, _V]) * [
        1,
        -1,
    ]
    start = 0.5 * (nominal[[first, second]].mean(0) + nominal[opposing].mean(0))
    start[1] = nominal[[first, second], 1].mean()

    def made(values: Array) -> Habit:
        touch = np.array(hand.nominal_joints)
        return Habit(hand, frame, fingers, start + values, touch, around, beside, _SHIFT)

    def asked(habit: Habit, turns: Iterable[float] = _TURNS) -> Iterable[Places]:
        for turn in turns:
            aside = habit.beside.copy()
            aside[opposing] = habit.shift * turn
            bar = Handle(habit.centre, np.array([0.0, 0.0, 1.0]), BAR_RADIUS)
            yield pad_places(hand, frame, bar, np.zeros(hand.n_fingers), PUSH, habit.around + turn, aside)

    habit = made(_best(hand, fingers, lambda values: asked(made(values)), 3))
    solved = _solved(hand, asked(habit, [0.0]))[0]
    taking_part = np.isin(hand.finger_of_joint, fingers)
    return habit._replace(touch=np.where(taking_part, solved, _idle(hand)))


def _idle(hand: Hand) -> Array:
    return np.array(hand.idle_joints)


def _best(
    hand: Hand, fingers: Iterable[int], asked: Callable[[Array], Iterable[Places]], unknowns: int
) -> Array:
    """Return the values that lay the pads of some fingers flattest where they are asked to be."""
    used = np.array(list(fingers))
    theirs = np.isin(hand.finger_of_joint, used)

    def cost(values: Array) -> float:
        places = list(asked(values))
        joints = _solved(hand, places)
        centres, outward = (part.numpy() for part in pads(hand, torch.from_numpy(joints)))
        wanted, inward = (np.array(part) for part in zip(*places, strict=True))
        off = np.linalg.norm(centres - wanted, axis=-1)[:, used] / _DISTANCE
        tilted = (1 - (outward * inward).sum(-1)[:, used]) / _MISALIGNMENT
        margin = np.minimum(joints - hand.joint_lower, hand.joint_upper - joints)[:, theirs]
        near = np.clip(1 - margin / _MARGIN, 0, 1)
        return float((off**2 + tilted).mean() + 0.5 * near.mean())

    simplex = np.vstack([np.zeros(unknowns), 0.005 * np.eye(unknowns)])
    found = minimize(
        cost,
        np.zeros(unknowns),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxiter": 60 * unknowns, "xatol": 1e-4, "fatol": 1e-3},
    )
    return found.x


def _solved(hand: Hand, places: Iterable[Places]) -> Array:
    """Return joints [rad] that lay pads as asked. Shape (rows, joints)."""
    points, inward = (torch.from_numpy(np.array(part)) for part in zip(*places, strict=True))
    seed = torch.tensor(hand.nominal_joints, dtype=torch.float64).expand(len(points), -1)
    return solve_pads(hand, points, -inward, seed, iterations=20).joints.numpy()
