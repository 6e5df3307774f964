"""Pads lie flat on both sides of a handle, however it lies in the palm."""

import numpy as np
import pytest
from expert_checks import pads_of

from lerobot_dexflex.experts.tool.grip import Handle, grip_handle
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.hands import LEAP

PUSH = np.array([-1.0, 0.0, 0.0])
HOLD = holds_of(LEAP).bar


def handle_turned(yaw: float, radius: float) -> Handle:
    return Handle(HOLD.centre, np.array([np.sin(yaw), np.cos(yaw), 0.0]), radius)


def grip(handle: Handle, fingers: tuple[int, ...] = (0, 1, 2, 3), **options):
    return grip_handle(LEAP, HOLD.frame, handle, HOLD.along, PUSH, fingers, HOLD.touch, HOLD.idle, **options)


def off_the_axis(handle: Handle, points: np.ndarray) -> np.ndarray:
    offsets = points - handle.centre
    return np.linalg.norm(offsets - np.outer(offsets @ handle.axis, handle.axis), axis=1)


@pytest.mark.parametrize("yaw", [-0.5, 0.0, 0.3, 0.5])
@pytest.mark.parametrize("radius", [0.010, 0.016])
def test_pads_lie_flat_on_the_surface_of_an_askew_handle(yaw, radius):
    handle = handle_turned(yaw, radius)
    found = grip(handle)
    centres, outward = pads_of(found.touch)
    assert np.allclose(off_the_axis(handle, centres), radius, atol=2.5e-3)
    assert np.abs((centres - handle.centre) @ handle.axis - HOLD.along).max() < 2.5e-3
    # Flat along the handle's section; fingers cannot turn about palm z, so they are as askew as the handle.
    facing = (outward * found.inward).sum(1)
    assert (facing[:3] > np.cos(yaw) - 0.02).all()
    assert facing[3] > 0.95


def test_fingers_push_across_the_handle_and_the_thumb_against_them():
    handle = handle_turned(0.4, 0.013)
    inward = grip(handle).inward
    assert np.allclose(inward @ handle.axis, 0)
    assert np.allclose(np.linalg.norm(inward, axis=1), 1)
    assert np.allclose(inward[:3], -inward[3])
    assert (inward[:3] @ PUSH > 0.9).all()


def test_an_open_grip_leaves_room_all_around():
    handle = handle_turned(0.2, 0.013)
    for room in (0.010, 0.016):
        centres, _ = pads_of(grip(handle, room=room).open)
        assert np.allclose(off_the_axis(handle, centres), 0.013 + room, atol=3e-3)


@pytest.mark.parametrize(("fingers", "idle"), [((0, 1, 3), 2), ((0, 2, 3), 1)])
def test_idle_fingers_stay_where_they_are_told(fingers, idle):
    found, whole = grip(handle_turned(0.0, 0.013), fingers), grip(handle_turned(0.0, 0.013))
    part = slice(4 * idle, 4 * idle + 4)
    for mine, all_fingers in ((found.open, whole.open), (found.touch, whole.touch)):
        assert np.array_equal(mine[part], HOLD.idle[part])
        others = np.delete(mine, np.r_[part])
        assert np.array_equal(others, np.delete(all_fingers, np.r_[part]))
    assert not found.inward[idle].any()
    assert found.inward[list(fingers)].any(1).all()


def test_turning_a_push_about_the_handle_and_shifting_a_pad_aside_do_so():
    handle = handle_turned(0.0, 0.013)
    turned = grip(handle, around=np.array([0.3, 0.0, 0.0, 0.0])).inward
    assert np.arccos(turned[0] @ turned[1]) == pytest.approx(0.3)
    aside = np.array([0.004, 0.0, 0.0, -0.004])
    (shifted, _), (straight, _) = (pads_of(grip(handle, beside=b).touch) for b in (aside, None))
    # Sideways is across handle and push: palm z for the fingers, -z for the thumb, which pushes back.
    assert np.allclose((shifted - straight)[:, 2], [0.004, 0.0, 0.0, 0.004], atol=5e-4)


def test_the_search_for_a_grip_begins_with_all_four_pads_flat_on_a_handle():
    centres, normals = pads_of(HOLD.touch)
    side = np.array([1, 1, 1, -1])
    assert np.allclose(centres[:, 0] - HOLD.centre[0], side * 0.013, atol=1e-3)
    assert np.allclose(normals[:, 0], -side, atol=1e-3)
