"""A grasp that the search returns holds, in a model of its own, under the gravity it was found for."""

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.contacts import fingertip_contacts
from lerobot_dexflex.hand.grasp import OBJECT, GraspSearch, hand_scene
from lerobot_dexflex.hand.grasp_candidates import grasp_candidates
from lerobot_dexflex.hand.objects import SIZES, ObjectSpec, sample_object
from lerobot_dexflex.hand.poses import pose_error, quaternion_matrix
from lerobot_dexflex.hands import LEAP

DIRECTIONS = {"box": (0, 0, -1), "cylinder": (0, 0, 1), "capsule": (1, 0, 0), "tool": (0, -1, 0)}


@pytest.mark.parametrize("kind", SIZES)
def test_a_found_grasp_holds_for_three_seconds_with_its_constant_command(kind):
    rng = np.random.default_rng(11)
    thing, gravity = sample_object(rng, kind), np.array(DIRECTIONS[kind], float)
    grasp = GraspSearch(LEAP, thing, gravity).find(rng)
    assert grasp.touching[3]
    assert grasp.touching.sum() >= 3
    model = hand_scene(LEAP, thing).compile()
    model.opt.gravity = 9.81 * gravity
    data = mujoco.MjData(model)
    data.qpos[:] = (*grasp.hand_joints, *grasp.position, *grasp.quaternion)
    data.ctrl[:] = grasp.joint_targets
    mujoco.mj_step(model, data, 1500)
    pose = data.joint(f"{OBJECT}_free").qpos
    distance, angle = pose_error(grasp.position, grasp.quaternion, pose[:3], pose[3:])
    assert distance < 2e-3
    assert angle < 0.05
    mujoco.mj_forward(model, data)
    assert np.array_equal(fingertip_contacts(LEAP, model, data, OBJECT).loads > 0.15, grasp.touching)


def test_the_weight_rests_on_the_fingertips():
    thing, down = ObjectSpec("cylinder", (0.025, 0.03), 0.2), np.array([0, 0, -1.0])
    search = GraspSearch(LEAP, thing, down)
    search.find(np.random.default_rng(0))
    model, data = search.model, search.data
    mujoco.mj_step(model, data, 500)
    total, force = np.zeros(3), np.zeros(6)
    for k, contact in enumerate(data.contact):
        names = [model.geom(int(g)).name for g in contact.geom]
        assert any(name.startswith(OBJECT) for name in names) or contact.dist > 0
        mujoco.mj_contactForce(model, data, k, force)
        sign = 1.0 if names[1].startswith(OBJECT) else -1.0
        total += sign * contact.frame.reshape(3, 3).T @ force[:3]
    assert total == pytest.approx((0, 0, 0.2 * 9.81), abs=0.02)


def test_the_seed_decides_the_grasp():
    thing, gravity = ObjectSpec("box", (0.02, 0.025, 0.03), 0.1), np.array([0, 0, -1.0])
    first, second = (GraspSearch(LEAP, thing, gravity).find(np.random.default_rng(1)) for _ in "ab")
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    other = GraspSearch(LEAP, thing, gravity).find(np.random.default_rng(2))
    assert not np.array_equal(first.position, other.position)


def test_four_fingers_can_be_asked_for():
    grasp = GraspSearch(LEAP, ObjectSpec("cylinder", (0.03, 0.04), 0.1), np.array([0, 0, -1.0])).find(
        np.random.default_rng(0), min_fingers=4
    )
    assert grasp.touching.all()


def test_candidates_oppose_the_thumb_and_lie_on_the_object():
    thing, rng, found = ObjectSpec("capsule", (0.025, 0.02), 0.1), np.random.default_rng(0), 0
    for _ in range(20):
        for candidate in grasp_candidates(LEAP, thing, rng):
            found += 1
            normals = candidate.normals[candidate.active]
            assert candidate.active[3]
            assert normals[:-1].mean(0) @ normals[-1] < -0.3
            local = (candidate.points - candidate.position) @ quaternion_matrix(candidate.quaternion)
            axis = np.clip(local[:, 2], -0.02, 0.02)[:, None] * [0, 0, 1]
            height = np.linalg.norm(local - axis, axis=1) - 0.025
            # On the surface, or raised by no more than a tilted pad's half diagonal reaches down.
            assert (height > -1e-9).all()
            assert height[candidate.active].max() < 0.013 + 0.0105
    assert found > 3


def test_an_object_that_no_hand_can_hold_is_reported_with_the_remedy():
    with pytest.raises(DexFlexError, match=r"found in 3 object poses\. Try another object"):
        GraspSearch(LEAP, ObjectSpec("box", (0.12, 0.12, 0.12), 0.5), np.array([0, 0, -1.0])).find(
            np.random.default_rng(0), tries=3
        )
