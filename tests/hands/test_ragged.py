"""A hand of fingers of three, five and four joints about any axes: against transforms composed here."""

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from lerobot_dexflex.hand import contacts, kernels, kinematics
from lerobot_dexflex.hand.grasp import hand_scene
from lerobot_dexflex.hand.model import add_hand, base_spec
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hand.touch import TouchSensor, add_touch


def transform(rotation=None, position=(0, 0, 0)):
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) if rotation is None else rotation.as_matrix()
    matrix[:3, 3] = position
    return matrix


def followed(finger, angles):
    """Return the transform of every link of a finger, its joint turned, in the palm frame."""
    here, found = np.eye(4), []
    for link, angle in zip(finger.links, angles, strict=True):
        mounted = transform(Rotation.from_quat(link.quaternion, scalar_first=True), link.position)
        here = here @ mounted @ transform(Rotation.from_rotvec(angle * np.array(link.axis)))
        found.append(here)
    return np.array(found)


def test_forward_kinematics_composes_the_transforms_of_the_links(ragged, joints):
    tips, (centres, normals) = kernels.fingertips(ragged.tables, joints), kernels.pads(ragged.tables, joints)
    origins, axes, distal = kernels.frames(ragged.tables, joints)
    assert origins.shape == axes.shape == (40, 3, 5, 3)
    for row, hand in enumerate(joints):
        for f, (finger, own) in enumerate(zip(ragged.fingers, ragged.finger_joints, strict=True)):
            links, n = followed(finger, hand[own]), len(finger.links)
            turned = [at[:3, :3] @ link.axis for at, link in zip(links, finger.links, strict=True)]
            pad = Rotation.from_quat(finger.pad_quaternion, scalar_first=True).as_matrix()
            place = {"atol": 1e-12, "rtol": 0}
            np.testing.assert_allclose(origins[row, f, :n], links[:, :3, 3], **place)
            np.testing.assert_allclose(axes[row, f, :n], turned, **place)
            np.testing.assert_allclose(distal[row, f], links[-1, :3, :3], **place)
            np.testing.assert_allclose(tips[row, f], (links[-1] @ [*finger.tip_position, 1])[:3], **place)
            np.testing.assert_allclose(centres[row, f], (links[-1] @ [*finger.pad_position, 1])[:3], **place)
            np.testing.assert_allclose(normals[row, f], links[-1, :3, :3] @ pad[:, 2], **place)
            assert not origins[row, f, n:].any()
            assert not axes[row, f, n:].any()


def test_the_simulated_hand_has_the_same_fingertips_and_pads(ragged, joints):
    spec = base_spec()
    add_hand(spec, spec.worldbody, ragged, (0, 0, 0), (1, 0, 0, 0))
    model = spec.compile()
    assert [model.joint(k).name for k in range(model.njnt)] == list(ragged.joint_names)
    data = mujoco.MjData(model)
    data.qpos[:] = joints[0]
    mujoco.mj_kinematics(model, data)
    tips, (centres, normals) = (
        kernels.fingertips(ragged.tables, joints[0]),
        kernels.pads(ragged.tables, joints[0]),
    )
    for f, prefix in enumerate(ragged.prefixes):
        pad = data.site(f"{prefix}_pad")
        np.testing.assert_allclose(data.site(f"{prefix}_tip").xpos, tips[f], atol=1e-9)
        np.testing.assert_allclose(pad.xpos, centres[f], atol=1e-9)
        np.testing.assert_allclose(pad.xmat.reshape(3, 3)[:, 2], normals[f], atol=1e-9)


def test_fingertips_that_a_near_posture_reaches_are_reached(ragged, joints):
    near = np.clip(joints + 0.1, ragged.joint_lower, ragged.joint_upper)
    targets = kernels.fingertips(ragged.tables, near)
    solved = kernels.solve_fingertips(ragged.tables, targets, joints, 0.0, 30)
    missed = np.linalg.norm(kernels.fingertips(ragged.tables, solved) - targets, axis=-1)
    assert np.median(missed) < 1e-6
    assert missed.max() < 3e-3
    assert (solved >= ragged.joint_lower).all()
    assert (solved <= ragged.joint_upper).all()


def test_pads_that_a_near_posture_lays_are_laid(ragged):
    seed = torch.tensor([ragged.nominal_joints], dtype=torch.float64)
    centres, outward = kinematics.pads(ragged, seed + 0.08)
    solution = contacts.solve_pads(ragged, centres, -outward, seed, iterations=30)
    assert solution.distance.max() < 2e-3
    assert solution.alignment.min() > 0.98


def test_contact_torques_do_the_work_of_the_forces(ragged, joints):
    """Each joint's is what the fingertips gain along the forces when it turns: J^T f."""
    hands, turn = joints[:5], 1e-6
    forces = np.random.default_rng(1).normal(size=(5, 3, 3))
    torques = kernels.contact_torques(ragged.tables, hands, kernels.fingertips(ragged.tables, hands), forces)
    for joint, change in enumerate(turn * np.eye(ragged.n_joints)):
        ahead, behind = (kernels.fingertips(ragged.tables, hands + c) for c in (change, -change))
        expected = (forces * (ahead - behind)).sum((1, 2)) / (2 * turn)
        assert torques[:, joint] == pytest.approx(expected, abs=1e-8)


def test_a_batch_is_its_rows_to_the_last_bit(ragged, joints):
    targets = kernels.fingertips(ragged.tables, joints) + 0.01
    batch = kernels.solve_fingertips(ragged.tables, targets, joints)
    rows = [kernels.solve_fingertips(ragged.tables, *row) for row in zip(targets, joints, strict=True)]
    assert np.array_equal(batch, rows)


def test_a_grip_is_bounded_by_the_motors_and_the_limits(ragged, joints):
    points, _ = kernels.pads(ragged.tables, joints[0])
    led = contacts.gripping_joints(ragged, joints[0], joints[0], points, np.full((3, 3), 1000.0))
    assert (np.abs(led - joints[0]) <= 0.5 / 2.0 + 1e-12).all()
    assert (led >= ragged.joint_lower).all()
    assert (led <= ragged.joint_upper).all()


def test_who_touches_is_told_by_the_links_of_the_hand(ragged):
    assert contacts.pinched(ragged, {"thumb_4", "right_3"})
    assert not contacts.pinched(ragged, {"left_2", "right_3"})
    assert not contacts.pinched(ragged, {"thumb_4", "right_2"})
    assert contacts.contact_flags(ragged, {"left_2", "table"}).tolist() == [True, False, False, True]
    assert contacts.touched_by_hand(ragged, {"thumb_0"})
    assert not contacts.touched_by_hand(ragged, {"table"})


def test_every_fingertip_feels_with_the_taxels_of_the_hand(ragged):
    spec = hand_scene(ragged, ObjectSpec("box", (0.02, 0.025, 0.03), 0.1))
    add_touch(spec, ragged)
    model = spec.compile()
    sensor, data = TouchSensor(model, ragged), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert sensor.true_taxels(data).shape == (3, 6, 4)
    assert sensor.normal_forces(data).shape == (3,)
