"""One compiled hand: a batch is its rows, solvers do not break on bad wishes, torques do virtual work."""

from functools import partial

import numpy as np
import pytest

from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hands import LEAP


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def joints(rng):
    return np.array(LEAP.nominal_joints) + rng.normal(scale=0.15, size=(64, 16))


def every_kernel(joints, rng):
    """Pair each kernel that takes batches with arguments of as many rows as `joints`."""
    targets = kernels.fingertips(LEAP.tables, joints) + rng.normal(scale=0.02, size=(len(joints), 4, 3))
    normals = rng.normal(size=targets.shape)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    for kernel, arguments in (
        (kernels.fingertips, (joints,)),
        (kernels.solve_fingertips, (targets, joints)),
        (kernels.solve_pads, (targets, normals, joints)),
        (kernels.contact_torques, (joints, targets, 5 * normals)),
    ):
        yield partial(kernel, LEAP.tables), arguments
    for part in range(3):
        yield (lambda hands, part=part: kernels.frames(LEAP.tables, hands)[part]), (joints,)
    for part in range(2):
        yield (lambda hands, part=part: kernels.pads(LEAP.tables, hands)[part]), (joints,)


def test_a_batch_is_its_rows_to_the_last_bit(joints, rng):
    for kernel, arguments in every_kernel(joints, rng):
        rows = [kernel(*[argument[k] for argument in arguments]) for k in range(len(joints))]
        assert np.array_equal(kernel(*arguments), np.stack(rows))
        folded = kernel(*[argument.reshape(4, 16, *argument.shape[1:]) for argument in arguments])
        assert np.array_equal(folded.reshape(len(joints), *folded.shape[2:]), np.stack(rows))


def test_no_hands_give_no_hands(joints, rng):
    for kernel, arguments in every_kernel(joints, rng):
        assert kernel(*[argument[:0] for argument in arguments]).shape[0] == 0


def test_as_many_wishes_as_hands_are_asked_for(joints):
    tips = kernels.fingertips(LEAP.tables, joints)
    with pytest.raises(ValueError, match="as many rows"):
        kernels.solve_fingertips(LEAP.tables, tips[:3], joints[:2])
    with pytest.raises(ValueError, match="as many rows"):
        kernels.solve_pads(LEAP.tables, tips[:2], tips[:1], joints[:2])
    with pytest.raises(ValueError, match="as many rows"):
        kernels.contact_torques(LEAP.tables, joints[:2], tips[:2], tips[:1])


def test_what_is_not_a_number_stays_within_its_finger(joints):
    tips = kernels.fingertips(LEAP.tables, joints)
    broken = tips.copy()
    broken[:, 1] = np.nan
    for solved, plain in (
        (
            kernels.solve_fingertips(LEAP.tables, broken, joints),
            kernels.solve_fingertips(LEAP.tables, tips, joints),
        ),
        (
            kernels.solve_pads(LEAP.tables, broken, tips, joints),
            kernels.solve_pads(LEAP.tables, tips, tips, joints),
        ),
    ):
        assert np.isnan(solved[:, 4:8]).all()
        assert np.array_equal(np.delete(solved, range(4, 8), 1), np.delete(plain, range(4, 8), 1))


def test_torques_do_the_work_of_the_forces(joints, rng):
    """They are J^T f: each joint's is what the contact points gain along the forces when it turns."""
    hands, turn = joints[:5], 1e-6
    forces = rng.normal(size=(5, 4, 3))
    tips = kernels.fingertips(LEAP.tables, hands)
    torques = kernels.contact_torques(LEAP.tables, hands, tips, forces)
    for joint in range(16):
        change = np.zeros(16)
        change[joint] = turn
        moved = kernels.fingertips(LEAP.tables, hands + change) - kernels.fingertips(
            LEAP.tables, hands - change
        )
        expected = (forces * moved).sum((1, 2)) / (2 * turn)
        assert torques[:, joint] == pytest.approx(expected, abs=1e-9)


def test_a_force_loads_its_own_finger_only_and_acts_where_it_touches(joints, rng):
    hand, forces = joints[0], np.zeros((4, 3))
    forces[2] = rng.normal(size=3)
    tips, (pads, _) = kernels.fingertips(LEAP.tables, hand), kernels.pads(LEAP.tables, hand)
    at_tip, at_pad = (kernels.contact_torques(LEAP.tables, hand, points, forces) for points in (tips, pads))
    assert not np.delete(at_tip, range(8, 12)).any()
    assert np.abs(at_tip[8:12]).min() > 1e-4
    assert not np.allclose(at_tip, at_pad)
    origins, axes, _ = kernels.frames(LEAP.tables, hand)
    expected = [axes[2, k] @ np.cross(pads[2] - origins[2, k], forces[2]) for k in range(4)]
    assert at_pad[8:12] == pytest.approx(expected, abs=1e-12)
