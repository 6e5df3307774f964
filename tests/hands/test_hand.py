"""A hand refuses numbers that make none, and says what is wrong, what is valid and the remedy."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP


def with_link(finger, **changes):
    return replace(finger, links=(finger.links[0]._replace(**changes), *finger.links[1:]))


def with_motor(finger, **changes):
    return replace(finger, motors=(finger.motors[0]._replace(**changes), *finger.motors[1:]))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda f: replace(f, links=()), "has no links. Give it at least one"),
        (lambda f: replace(f, motors=f.motors[1:]), "3 links but 2 entries in `motors`. Give one per link"),
        (lambda f: replace(f, collision=()), "3 links but 0 entries in `collision`"),
        (
            lambda f: replace(f, pad_half_size=(0.01, 0.0)),
            "`pad_half_size` of finger 'left'",
        ),
        (lambda f: replace(f, pad_quaternion=(0, 0, 0, 0)), "`pad_quaternion` of finger 'left' must be four"),
        (
            lambda f: with_link(f, parent="left_9"),
            "'left_0' of finger 'left' must hang on 'palm'",
        ),
        (lambda f: with_link(f, joint_range=(1.0, -1.0)), r"lower < upper. Got \(1.0, -1.0\). Swap"),
        (
            lambda f: with_link(f, axis=(0.0, 0.0, 2.0)),
            "unit vector. Got .* of length 2. Divide it",
        ),
        (lambda f: with_link(f, axis=(0.0, 0.0, float("nan"))), "must be a unit vector"),
        (lambda f: with_link(f, quaternion=(0, 0, 0, 0)), "quaternion of link 'left_0' must be four numbers"),
        (
            lambda f: with_motor(f, torque=0.0),
            "`torque` of the motor of joint 'left_joint0' must",
        ),
        (lambda f: with_motor(f, damping=-1.0), "`damping` of the motor .* must not be negative. Got -1"),
        (lambda f: with_motor(f, grip_torque=0.9), "at most its `torque`, 0.8 N m. Got 0.9"),
    ],
)
def test_what_is_no_finger_is_refused(ragged, wrong, message):
    with pytest.raises(DexFlexError, match=message):
        wrong(ragged.fingers[0])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda h: {"fingers": h.fingers[:1]}, "needs two fingers or more. Got 1"),
        (lambda h: {"fingers": (h.fingers[0],) * 2}, "Every finger of a hand needs a name of its own"),
        (
            lambda h: {"fingers": (replace(h.fingers[0], prefix="th"), *h.fingers[1:])},
            "Every prefix of a hand needs a name of its own. Got 'th' again",
        ),
        (
            lambda h: {"fingers": (with_link(h.fingers[0], joint="thumb_joint1"), *h.fingers[1:])},
            "Every joint of a hand needs a name of its own. Got 'thumb_joint1' again",
        ),
        (lambda h: {"opposing": ("pinky",)}, r"`opposing` names 'pinky'.* Choose from \['left', 'thumb'"),
        (lambda h: {"opposing": ()}, "not none and not all"),
        (lambda h: {"opposing": h.finger_names}, "not none and not all"),
        (lambda h: {"excluded": (("palm", "left_8"),)}, r"`excluded` names 'left_8'.* Choose from \['palm'"),
        (lambda h: {"relaxed_joints": (0.0,) * 11}, r"`relaxed_joints` must hold 12 angles .* Got 11"),
        (
            lambda h: {"idle_joints": (9.0,) * 12},
            "`idle_joints` puts joint 'left_joint0' at 9.0 rad",
        ),
        (lambda h: {"taxels": (10, 0)}, "`taxels` must be two positive numbers"),
        (lambda h: {"taxel_pitch": (0.002, -0.002)}, "`taxel_pitch` must be two positive numbers"),
        (lambda h: {"object_region": ((0, 0, 0), (1, 0, 1))}, "lower < upper along x, y and z"),
        (lambda h: {"pad_spacing": 0.0}, "`pad_spacing` must be positive"),
        (lambda h: {"finger_order": (0.0, 2.0, 0.0)}, "`finger_order` must be a unit vector"),
    ],
)
def test_what_is_no_hand_is_refused(ragged, wrong, message):
    with pytest.raises(DexFlexError, match=message):
        replace(ragged, **wrong(ragged))


def test_the_signature_tells_hands_of_one_name_apart(ragged):
    assert ragged.signature.startswith(f"{ragged.name}-")
    assert replace(ragged).signature == ragged.signature
    wider = replace(ragged, pad_spacing=ragged.pad_spacing + 1e-4)
    assert wider.signature != ragged.signature


def test_joints_are_counted_finger_by_finger(ragged):
    assert (ragged.n_fingers, ragged.n_joints) == (3, 12)
    assert ragged.finger_joints == (slice(0, 3), slice(3, 8), slice(8, 12))
    assert ragged.finger_of_joint.tolist() == [0] * 3 + [1] * 5 + [2] * 4
    assert ragged.joint_names[3:5] == ("thumb_joint0", "thumb_joint1")
    assert ragged.distal_links == ("left_2", "thumb_4", "right_3")
    assert (ragged.opposing_fingers, ragged.opposed_fingers) == ((1,), (0, 2))
    assert ragged.joint_lower.tolist() == [link.joint_range[0] for link in ragged.links]
    assert ragged.tables.starts.tolist() == [0, 3, 8, 12]
    assert ragged.tables.widest == 5


def test_a_table_is_made_once_and_nobody_changes_shared_arrays(ragged):
    assert ragged.tables is ragged.tables
    with pytest.raises(ValueError, match="read-only"):
        ragged.joint_lower[0] = 0.0


def test_a_link_that_turns_about_minus_z_keeps_its_numbers_to_the_last_bit():
    """Recorded episodes replay bit for bit only if LEAP's tables are the plain numbers of its links."""
    assert not LEAP.tables.turned.any()
    assert LEAP.tables.positions.tolist() == [list(link.position) for link in LEAP.links]
    assert LEAP.tables.ends[:, 0].tolist() == [list(finger.tip_position) for finger in LEAP.fingers]
    assert LEAP.tables.ends[:, 1].tolist() == [list(finger.pad_position) for finger in LEAP.fingers]
    assert np.array_equal(LEAP.tables.ends[:, 2], [[1.0, 0.0, 0.0]] * 4)


def test_leap_has_four_fingers_of_four_joints():
    assert LEAP.finger_names == ("index", "middle", "ring", "thumb")
    assert LEAP.prefixes == ("if", "mf", "rf", "th")
    assert LEAP.distal_links == ("if_ds", "mf_ds", "rf_ds", "th_ds")
    assert (LEAP.n_fingers, LEAP.n_joints) == (4, 16)
    assert LEAP.joint_speeds == pytest.approx(8.482, abs=1e-3)
