"""Every check passes three hands that work, and fails one with the fault that it looks for."""

import re
from dataclasses import replace

import pytest
from allegro import ALLEGRO

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand_check.check import CHECKS, findings
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.hands.body import Box, Rod

INDEX, THUMB = 0, 3


def with_finger(number, **changes):
    fingers = list(ALLEGRO.fingers)
    fingers[number] = replace(fingers[number], **changes)
    return replace(ALLEGRO, fingers=tuple(fingers))


def with_link(number, place, **changes):
    links = list(ALLEGRO.fingers[number].links)
    links[place] = links[place]._replace(**changes)
    return with_finger(number, links=tuple(links))


def with_motors(**changes):
    fingers = [
        replace(finger, motors=tuple(motor._replace(**changes) for motor in finger.motors))
        for finger in ALLEGRO.fingers
    ]
    return replace(ALLEGRO, fingers=tuple(fingers))


def with_joints(posture, joints):
    angles = list(getattr(ALLEGRO, posture))
    for joint, angle in joints.items():
        angles[ALLEGRO.joint_names.index(joint)] = angle
    return replace(ALLEGRO, **{posture: tuple(angles)})


def coiling_thumb():
    """All joints of the thumb may turn all the way round."""
    links = tuple(link._replace(joint_range=(-6.0, 6.0)) for link in ALLEGRO.fingers[THUMB].links)
    return with_finger(THUMB, links=links)


BAD = {
    "limits": {
        "degrees": (with_link(INDEX, 0, joint_range=(-27.0, 27.0)), r"\(-27.0, 27.0\) rad at ff_base_joint"),
        "pinned": (
            with_joints(
                "idle_joints", {"ff_base_joint": -0.47, "ff_medial_joint": -0.174, "ff_distal_joint": -0.227}
            ),
            "3 joints of index at their limits in `idle_joints`",
        ),
    },
    "tips": {
        "in the air": (with_finger(INDEX, tip_position=(0.0, 0.0, 0.06)), r"-19.0 mm below .* \(index\)"),
        "behind": (with_finger(INDEX, pad_quaternion=(0, -1, 0, 1)), r"ahead .* by -1.71 .* \(index\)"),
    },
    "pads": {
        "beside": (with_finger(INDEX, pad_position=(0.02, 0.0, 0.022)), r"8.0 mm .* \(index\)"),
        "inward": (with_finger(THUMB, pad_quaternion=(1, 0, -1, 0)), r"by -1.00 .* \(thumb\)"),
    },
    "taxels": {
        "wide": (replace(ALLEGRO, taxel_pitch=(0.002, 0.004)), "pad of index by 3.5 mm"),
        "millimetres": (replace(ALLEGRO, taxel_pitch=(2.0, 2.7)), "20000.0 x 16200.0 mm"),
        "palmar": (
            replace(ALLEGRO, palmar=Box((0.016, 0.012, 0.002), (0.0, 0.0, -0.005))),
            "`palmar` by 3.0 mm",
        ),
    },
    "facing": {
        "open": (replace(ALLEGRO, nominal_joints=ALLEGRO.idle_joints), "normals oppose by 0.48"),
        "back to front": (
            with_finger(THUMB, pad_position=(-0.012, 0.0, 0.038), pad_quaternion=(1, 0, -1, 0)),
            "normals oppose by -0.79",
        ),
        "wrong thumb": (replace(ALLEGRO, opposing=("ring",)), "normals oppose by -"),
    },
    "order": {
        "reversed": (replace(ALLEGRO, finger_order=(0.0, -1.0, 0.0)), "by -46 mm"),
        "narrow": (replace(ALLEGRO, pad_spacing=0.0022), "0.13 to 0.13 pads wide"),
    },
    "region": {"elsewhere": (replace(ALLEGRO, object_region=((0, 0, 0.1), (0.05, 0.05, 0.15))), "11. mm")},
    "opposition": {
        "far": (with_link(THUMB, 0, position=(-0.2, 0.02, -0.2)), r"thumb \d{2,} mm"),
    },
    "inverse": {"coils": (coiling_thumb(), r"95 % of thumb's by less than 6")},
    "strength": {"weak": (with_motors(torque=0.1, grip_torque=0.1), "has 0.1 N m and needs 0.267")},
    "collisions": {
        "crossed": (
            with_joints("nominal_joints", {"ff_base_joint": -0.47, "rf_base_joint": 0.47}),
            "tips in the hand at rest: .* mm",
        ),
        "at a joint": (
            with_finger(INDEX, tip=Rod(0.012, 0.06, (0.0, 0.0, 0.019))),
            r"tips in their own finger: \S+ mm \(ff_",
        ),
        "drawn in mm": (
            with_finger(INDEX, collision=((), (), (Box((0.0098, 0.1, 0.02), (0.0, 0.0, 0.02)),), ())),
            r"links in other fingers: \S+ mm \(ff_medial in mf_",
        ),
    },
    "mount": {
        "turned": (
            replace(ALLEGRO, mount_quaternion=(0, 1, 0, 0), mount_position=(0.3, 0.0, 0.0)),
            "are -28 mm",
        ),
        "on the arm": (replace(ALLEGRO, mount_position=(0.0, 0.0, -0.1)), "tips touch link"),
    },
    "motors": {"stuck": (with_motors(friction_loss=0.65), "rad off its target")},
    "holding": {"no room": (replace(ALLEGRO, pad_spacing=0.5), "0 were grasped and 0 held")},
}
"""Hands with one fault each, and what the check has to say, by check."""
CHECK = {check.__name__.removeprefix("check_"): check for check in CHECKS}


@pytest.mark.parametrize("hand", [ALLEGRO, LEAP, SHARPA], ids=lambda hand: hand.name)
def test_hands_that_work_pass_every_check(hand):
    found = list(findings(hand))
    assert [finding.check for finding in found] == list(CHECK)
    assert [finding for finding in found if not finding.passed] == []


def test_every_check_is_tried_on_a_bad_hand():
    assert set(BAD) == set(CHECK)


@pytest.mark.parametrize(
    ("check", "hand", "says"),
    [
        pytest.param(check, *bad, id=f"{check}: {fault}")
        for check, faults in BAD.items()
        for fault, bad in faults.items()
    ],
)
def test_a_check_fails_its_fault(check, hand, says):
    finding = CHECK[check](hand)
    assert not finding.passed
    assert re.search(says, finding.found), finding.found


def test_links_that_the_simulator_refuses_are_an_error():
    inertia = ALLEGRO.links[0].inertia._replace(diagonal=(1e-5, 1e-5, 1e-3))
    with pytest.raises(DexFlexError, match=r"MuJoCo refuses .*'allegro' .*none of them more than the sum"):
        list(findings(with_link(INDEX, 0, inertia=inertia)))
