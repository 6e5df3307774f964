import numpy as np
import pytest
from moving_hand import turned

from lerobot_dexflex.streams.wrist_frame import Frame
from lerobot_dexflex.teleop.clutch import Clutch

PIVOT = np.array([-0.1, 0.02, 0.0])
"""The wrist is 10 cm behind the palm."""
PALM = Frame(np.array([0.5, 0.0, 0.3]), np.eye(3))


def at(*place, angle=0.0):
    return Frame(np.array(place, float), turned(angle))


def led(clutch, *wrists, palm=PALM):
    """Return where the palm is led by wrists, one after another."""
    return [clutch.lead(wrist, palm) for wrist in wrists][-1]


def test_a_palm_that_is_coupled_now_stays():
    palm = led(Clutch(PIVOT), at(7.0, 8.0, 9.0, angle=1.2))
    np.testing.assert_allclose(palm.position, PALM.position)
    np.testing.assert_allclose(palm.rotation, PALM.rotation, atol=1e-12)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_the_palm_moves_as_the_wrist_does_scaled(scale):
    palm = led(Clutch(PIVOT, scale), at(1, 1, 1), at(1.1, 0.98, 1.04))
    np.testing.assert_allclose(palm.position, PALM.position + scale * np.array([0.1, -0.02, 0.04]))
    np.testing.assert_allclose(palm.rotation, np.eye(3))


def test_the_palm_turns_about_the_wrist():
    """A quarter turn to the left about a wrist that stays at (0.4, 0.02, 0.3)."""
    clutch = Clutch(PIVOT)
    turns = [at(1, 1, 1, angle=angle) for angle in (0.0, np.pi / 4, np.pi / 2)]
    palm = led(clutch, *turns)
    np.testing.assert_allclose(palm.rotation, turned(np.pi / 2), atol=1e-12)
    np.testing.assert_allclose(palm.position, (0.42, 0.12, 0.3), atol=1e-12)


def test_the_persons_forward_may_be_to_the_left_of_the_robots():
    """Who looks to the robot's left moves it there by moving forward."""
    palm = led(Clutch(PIVOT, heading=np.pi / 2), at(0, 0, 0), at(0.1, 0.02, 0.03))
    np.testing.assert_allclose(palm.position, PALM.position + np.array((-0.02, 0.1, 0.03)), atol=1e-12)

    s = np.sqrt(0.5)
    rolled = Frame(np.zeros(3), np.array([[1.0, 0, 0], [0, s, -s], [0, s, s]]))
    palm = led(Clutch(np.zeros(3), heading=np.pi / 2), at(0, 0, 0), rolled)
    # About the person's forward, which is the robot's left, its y.
    np.testing.assert_allclose(palm.rotation, [[s, 0, s], [0, 1, 0], [-s, 0, s]], atol=1e-12)


def test_a_wrist_that_moves_uncoupled_moves_nothing():
    clutch = Clutch(PIVOT)
    led(clutch, at(0, 0, 0), at(0.1, 0, 0))
    clutch.uncouple()
    moved = Frame(PALM.position + np.array((0.1, 0, 0)), PALM.rotation)
    palm = led(clutch, at(0.02, 0.05, 0.0), palm=moved)
    np.testing.assert_allclose(palm.position, moved.position)
    palm = led(clutch, at(0.02, 0.15, 0.0), palm=moved)
    np.testing.assert_allclose(palm.position, moved.position + np.array((0, 0.1, 0)))


@pytest.mark.parametrize("there", [at(0.3, 0, 0), at(0, 0, 0, angle=1.5)])
def test_a_wrist_that_jumps_is_coupled_anew(there):
    clutch = Clutch(PIVOT)
    palm = led(clutch, at(0, 0, 0), there)
    np.testing.assert_allclose(palm.position, PALM.position)
    np.testing.assert_allclose(palm.rotation, PALM.rotation, atol=1e-12)
    after = Frame(there.position + np.array((0, 0, 0.1)), there.rotation)
    np.testing.assert_allclose(led(clutch, after).position, PALM.position + np.array((0, 0, 0.1)), atol=1e-12)
