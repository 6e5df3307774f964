"""Turn things with the fingers about an upright axis: strokes, and between them the way back."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.reach.operator import FRICTION_SHARE, LEAD
from lerobot_dexflex.experts.tool.grip import Grip, Handle
from lerobot_dexflex.experts.tool.script import Pose, Script
from lerobot_dexflex.hand.arm import rotation_matrix

UP = np.array([0.0, 0.0, 1.0])
"""The axis z, of the world or of the working frame."""
LEAST_TURN = 0.01
"""Turns in 8 steps below which a stroke has come to its end."""


class Screw(NamedTuple):
    """What the fingers turn about its z axis, and what the operator sees of it."""

    pose: Callable[[], tuple[Array, Array]]
    """Position [m] (3,) and orientation (3, 3) of its body in the world."""
    axis: Array
    """Unit vector in the working frame along which its z axis stands. Shape (3,)."""
    grasp_at: float
    """Where along its z axis the fingers hold it [m]."""
    radius: float
    """Half of its width there [m]."""
    turns: Callable[[], float]
    """By how many turns it is screwed in."""
    tight: Callable[[], bool]
    """Whether it is to be turned no more."""
    seat: Callable[[], Array] | None = None
    """Where its body belongs [m] (3,), world frame; None if it cannot lean or leave."""

    def in_palm(self, script: Script) -> Pose:
        """Return where its body is in the working frame, or belongs if it has a seat."""
        held = script.in_palm(*self.pose())
        if self.seat is None:
            return held
        return Pose(script.in_palm(self.seat(), np.eye(3)).position, aligned(held.rotation, self.axis))

    def handle(self, script: Script) -> Handle:
        """Return what the fingers hold."""
        held = self.in_palm(script)
        centre = held.position + held.rotation @ np.array([0, 0, self.grasp_at])
        return Handle(centre, held.rotation[:, 2], self.radius)


class Strokes(NamedTuple):
    """How the fingers turn things."""

    angle: float
    """How far they turn it before they grasp again [rad]."""
    most: int
    """After so many the operator gives up."""
    room: float
    """How far the pads leave it at the end of a stroke [m]."""
    room_back: float
    """How far they are off it at the beginning of the next [m]."""
    squeeze: float
    """Squeeze per finger that is wished for while screwing [N]: the thread resists."""
    ahead: float = LEAD[1]
    """How far the operator leads it at most [rad]: the fingers push as far ahead."""
    press: float = 0.0
    """How far against its axis the operator wants it [m]: 100 N/m press it into its seat."""


def insert(
    script: Script,
    pose: Callable[[], tuple[Array, Array]],
    goal: Array,
    palm: Array,
    length: float,
    caught: Callable[[], bool],
    steps: int = 60,
    pressing: int = 6,
) -> Iterator[Command]:
    """Lower the end of what is held into a hole, steered by where it is measured, until it is caught.

    Pressing on for a few steps lets also those who repeat the motion less exactly catch it.

    Args:
        script: Moves the arm.
        pose: Position [m] and orientation of the held body in the world, z up along it.
        goal: Where the body is once it is in [m]. Shape (3,).
        palm: Orientation of the level palm. Shape (3, 3).
        length: How far below the body's origin its end is [m].
        caught: Whether it is in.
        steps: How long the operator tries.
        pressing: How many steps longer it presses.
    """
    held = script.in_palm(*pose())
    upright = aligned(palm @ held.rotation, UP)
    above = goal + np.array([0, 0, 0.035])
    yield from script.glide(*script.palm_for(held, above, upright), 8)
    correction = np.zeros(3)
    for k in range(1, steps + 1):
        position, rotation = pose()
        beside = goal - (position - length * rotation[:, 2])
        if not caught():
            correction[:2] = np.clip(correction[:2] + 0.15 * beside[:2], -0.006, 0.006)
        height = np.array([0, 0, max(0.035 - 0.0015 * k, -0.006)])
        yield script.step(*script.palm_for(held, goal + height + correction, upright))
        pressing -= caught()
        if pressing < 0:
            return


def turn(
    script: Script, screw: Screw, grip: Callable[[Handle, float, float], Grip], strokes: Strokes
) -> Iterator[Command]:
    """Turn something clockwise with the fingers that hold it, stroke by stroke, until it is tight.

    Args:
        script: Moves the hand; the palm stands still.
        screw: What is turned.
        grip: Returns the grip of a handle with all fingers turned back by an angle [rad], and the room that
            they leave while open [m].
        strokes: How far, how often, how carefully.
    """
    hand = script.hand
    angle = strokes.angle / 2
    for _ in range(strokes.most):
        assert hand.operator is not None
        hand.operator.ahead = LEAD[0], strokes.ahead
        position, rotation = screw.in_palm(script)
        hand.lead(position - strokes.press * screw.axis, rotation_matrix(-angle * screw.axis) @ rotation)
        yield from _turn_on(script, screw, screw.turns() + 0.9 * angle / (2 * np.pi))
        if screw.tight():
            yield from script.hold(4)
            return
        yield from grasp_again(script, screw, grip, strokes, strokes.angle / 2)
        angle = strokes.angle


def grasp_again(
    script: Script, screw: Screw, grip: Callable[[Handle, float, float], Grip], strokes: Strokes, back: float
) -> Iterator[Command]:
    """Let go of what is screwed and grip it again, with all fingers turned back by an angle [rad]."""
    hand, handle = script.hand, screw.handle(script)
    end, begin = grip(handle, 0.0, strokes.room), grip(handle, back, strokes.room_back)
    hand.let_go()
    for joints, steps in ((end.open, 5), (begin.open, 6), (begin.touch, 6)):
        yield from script.move_hand(joints, steps)
    hand.grip(begin, strokes.squeeze, FRICTION_SHARE)
    yield from script.wait(lambda: hand.gripped, 5)


def _turn_on(script: Script, screw: Screw, goal: float, patience: int = 8) -> Iterator[Command]:
    """Let the fingers turn until the screw is tight or has so many turns, or until it turns no more."""
    since = last = screw.turns()
    for k in range(1, 31):
        yield from script.hold(1)
        last = screw.turns()
        if screw.tight() or last > goal:
            return
        if k % patience == 0:
            if last - since < LEAST_TURN:
                return
            since = last


def aligned(rotation: Array, axis: Array) -> Array:
    """Return the orientation (3, 3) nearest to `rotation` whose z axis is along `axis` (3,)."""
    normal = np.cross(rotation[:, 2], axis)
    sine = np.linalg.norm(normal)
    if sine < 1e-9:
        return rotation
    return rotation_matrix(np.arcsin(min(1.0, sine)) / sine * normal) @ rotation
