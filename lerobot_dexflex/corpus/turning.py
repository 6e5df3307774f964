"""Kind 2: turn an object that a hinge carries, stroke by stroke, and go back with the fingers in between.

So are screws, nuts, knobs and lids turned: the fingers lead the object farther ahead than one that they
carry, leave it all together, and take hold of it again where they began.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.corpus.acquisition import Acquisition, Opening
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.world import Hinge
from lerobot_dexflex.envs.reach import ReachEpisode
from lerobot_dexflex.experts.reach.operator import LEAD, SPEED, Guidance
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.poses import quaternion_matrix, quaternion_of, quaternion_product, rotation_between
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

_FRICTION, _SOFTNESS = (0.002, 0.03), (0.01, 0.03)
"""Torque of the hinge [N m], and its time constant [s]."""
_STEP, _STEPS = 0.1, 7
"""Angles from the grasp that are tried: so far apart [rad], so many to either side."""
_LEAST_ANGLE = 0.3
"""Shortest stroke that is worth it [rad]."""
_LONGEST_OF_EDGED = 0.6
"""Longest stroke where an object is not round about the axis: its surface comes nearer as it turns [rad]."""
_SHORTEST = 0.6
"""Shortest stroke, as a share of the longest."""
_AXES = 24
_MAX_ERROR = 0.002
"""Fingertips come so near to where they turn to [m]."""
_AHEAD, _SPEED, _PRELOAD = (LEAD[1], 0.35), (SPEED[1], 0.09), (2.5, 5.5)
"""How far [rad] and how fast [rad] per control step the operator leads; squeeze per finger [N]."""
_STROKE_STEPS, _PATIENCE, _LEAST_TURN = 30, 8, 0.06
"""Longest duration of a stroke; it ends if the object turns by less in so many steps [rad]."""
_STROKES = (2, 6)


class Turn(NamedTuple):
    """What the fingers can do with an object that a hinge carries."""

    hinge: Hinge
    begin: float
    """Where strokes begin, from where the grasp was found [rad]."""
    end: float
    """Where they end [rad]."""


def find_turn(hand: Hand, opening: Opening, episode: ReachEpisode, rng: np.random.Generator) -> Turn | None:
    """Return the longest strokes that a grasp can do about its object's own or some random axes, or None.

    Args:
        hand: Whose fingers turn it.
        opening: The grasp and the way into it.
        episode: Where the object is.
        rng: Source of randomness.
    """
    position = np.array(episode.position)
    axes = rng.normal(size=(_AXES, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    longest = np.full(_AXES, _LONGEST_OF_EDGED)
    if episode.object_spec.kind != "box":  # Round about its z axis, at least the part that is held.
        axes[0], longest[0] = quaternion_matrix(np.array(episode.quaternion))[:, 2], np.inf
    ends = [_ends(hand, opening, np.array(episode.hand_joints), position, axis) for axis in axes]
    angles = np.minimum([high - low for low, high in ends], longest)
    best = int(np.argmax(angles))
    if angles[best] < _LEAST_ANGLE:
        return None
    hinge = Hinge(
        episode.position,
        episode.quaternion,
        tuple(axes[best].tolist()),
        float(rng.uniform(*_FRICTION)),
        float(rng.uniform(*_SOFTNESS)),
    )
    low, high = ends[best]
    share = float(rng.uniform(_SHORTEST, 1.0)) * angles[best] / (high - low)
    begin, end = (low * share, high * share) if rng.random() < 0.5 else (high * share, low * share)
    return Turn(hinge, begin, end)


def turned(opening: Opening, position: Array, turn: Array) -> Opening:
    """Return a grasp turned about a point [m] (3,) by a rotation vector [rad] (3,)."""
    rotation = rotation_matrix(turn)
    near, closed = ((tips - position) @ rotation.T + position for tips in (opening.near, opening.closed))
    return Opening(opening.joints, near, closed, opening.inward @ rotation.T)


def _ends(hand: Hand, opening: Opening, start: Array, position: Array, axis: Array) -> tuple[float, float]:
    """Return how far the fingers reach about an axis from the grasp's joints, backward and forward [rad]."""
    ends = []
    for sense in (-_STEP, _STEP):
        steps, joints = 0, start
        while steps < _STEPS:
            wanted = turned(opening, position, (steps + 1) * sense * axis).closed
            joints = kernels.solve_fingertips(hand.tables, wanted, joints)
            missed = np.linalg.norm(kernels.fingertips(hand.tables, joints) - wanted, axis=1)
            if missed[opening.active].max() > _MAX_ERROR:
                break
            steps += 1
        ends.append(steps * sense)
    return ends[0], ends[1]


class Turning(Acquisition):
    """Grasp, turn, let go, go back, again and again; satisfies `Leader`.

    Args:
        opening: The way into the grasp in the middle of a stroke.
        rng: Source of randomness: paces, how far and how hard.
        strength: Factor of the executed squeeze.
        turn: About what, and how far.
    """

    APPROACH, CLOSE, SQUEEZE, LET_GO = (4, 10), (4, 10), (1, 5), (4, 10)
    LATE, DELAY, RAMP = 3, (0, 4), 3

    def __init__(self, opening: Opening, rng: np.random.Generator, strength: float, turn: Turn) -> None:
        super().__init__(opening, rng, strength)
        self._axis, self._pivot = np.array(turn.hinge.axis), np.array(turn.hinge.position)
        self._ahead, self._speed, self._preload = (
            float(rng.uniform(*between)) for between in (_AHEAD, _SPEED, _PRELOAD)
        )
        self.strokes = 0
        self.wanted = self.done = 0.0
        """Angles that strokes wanted and reached, added up [rad]."""
        self._angle, self._last = 0.0, 0.0
        self._begun: Array = np.array([1.0, 0.0, 0.0, 0.0])
        self._phases = []
        for k in range(int(rng.integers(*_STROKES))):
            begin = turn.begin if k else 0.0
            there = turned(opening, self._pivot, begin * self._axis)
            set_out = partial(self._set_out, there, turn.end - begin)
            grasp = [self._approach, self._close, self._squeeze]
            self._phases += [set_out, *grasp, self._stroke, self._let_go]

    def _set_out(self, opening: Opening, angle: float, run: RunningEpisode) -> None:
        """Aim at the beginning of a stroke."""
        del run
        self._opening, self._angle = opening, angle

    def _squeeze(self, run: RunningEpisode) -> Guidance | None:
        """Squeeze as for a stroke; nothing has to be carried."""
        guidance = super()._squeeze(run)
        assert self._operator is not None
        self._operator.preload = self._preload
        return guidance

    def _stroke(self, run: RunningEpisode) -> Guidance | None:
        """Turn the object until the stroke is done, or it turns no more."""
        operator, now = self._operator, run.now
        assert operator is not None
        if self._timer == 0:
            operator.ahead, operator.speed = (LEAD[0], self._ahead), (SPEED[0], self._speed)
            self._begun, self._last = now.quaternion.copy(), 0.0
            goal = quaternion_product(quaternion_of(self._angle * self._axis), now.quaternion)
            operator.set_goal(self._pivot, goal)
            self.strokes += 1
            self.wanted += abs(self._angle)
        done = float(rotation_between(self._begun, now.quaternion) @ self._axis) * np.sign(self._angle)
        over = self._timer >= _STROKE_STEPS or done > 0.9 * abs(self._angle)
        if self._timer and self._timer % _PATIENCE == 0:
            over |= done - self._last < _LEAST_TURN
            self._last = done
        if over:
            self.done += done
            return None
        return operator.guide(now)

    def _give_back(self, run: RunningEpisode) -> None:
        """Leave it to the hinge, which has carried it all the time."""
