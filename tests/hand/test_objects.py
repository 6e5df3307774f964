"""Programmatic objects: physical numbers, honest sampling, clear refusals."""

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.model import base_spec
from lerobot_dexflex.hand.objects import SIZES, ObjectSpec, add_ghost, add_object, sample_object

EXAMPLES = {
    "box": (0.01, 0.02, 0.03),
    "cylinder": (0.02, 0.03),
    "capsule": (0.02, 0.03),
    "tool": (0.012, 0.05, 0.02, 0.03, 0.02),
}


@pytest.mark.parametrize(
    ("kind", "volume"),
    [
        ("box", 8 * 0.01 * 0.02 * 0.03),
        ("cylinder", np.pi * 0.02**2 * 0.06),
        ("capsule", np.pi * 0.02**2 * 0.06 + 4 / 3 * np.pi * 0.02**3),
        ("tool", np.pi * 0.012**2 * 0.1 + 4 / 3 * np.pi * 0.012**3 + 8 * 0.02 * 0.03 * 0.02),
    ],
)
def test_density_times_volume_is_mass(kind, volume):
    assert ObjectSpec.of_density(kind, EXAMPLES[kind], 500.0).mass == pytest.approx(500 * volume)


@pytest.mark.parametrize("kind", SIZES)
def test_the_compiled_body_has_the_mass_and_moves_freely(kind):
    spec = base_spec()
    add_object(spec, ObjectSpec(kind, EXAMPLES[kind], 0.123), "thing", (0.1, 0.2, 0.3))
    model = spec.compile()
    assert model.body("thing").mass[0] == pytest.approx(0.123)
    data = mujoco.MjData(model)
    assert data.joint("thing_free").qpos[:3] == pytest.approx((0.1, 0.2, 0.3))
    mujoco.mj_step(model, data, 50)
    # Free fall for 0.1 s, semi-implicit Euler: half g t (t + dt).
    assert data.joint("thing_free").qpos[2] == pytest.approx(0.3 - 0.5 * 9.81 * 0.1 * 0.102, abs=1e-6)


def test_a_tool_is_heavier_on_the_side_of_its_head():
    spec = base_spec()
    add_object(spec, ObjectSpec("tool", EXAMPLES["tool"], 0.2), "tool")
    handle = np.pi * 0.012**2 * 0.1 + 4 / 3 * np.pi * 0.012**3
    head = 8 * 0.02 * 0.03 * 0.02
    # The head's centre sits half a handle radius above the handle's end: 0.05 + 0.006.
    assert spec.compile().body("tool").ipos == pytest.approx((0, 0, 0.056 * head / (handle + head)))


def test_an_object_rests_on_another_and_a_ghost_lets_it_through():
    cube = ObjectSpec("box", (0.02, 0.02, 0.02), 0.1)
    spec = base_spec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1))
    add_object(spec, cube, "lower", (0, 0, 0.02))
    add_object(spec, cube, "upper", (0, 0, 0.10))
    add_ghost(spec, cube, "ghost")
    model = spec.compile()
    data = mujoco.MjData(model)
    data.mocap_pos[0] = (0, 0, 0.07)
    mujoco.mj_step(model, data, 500)
    assert data.body("upper").xpos[2] == pytest.approx(0.06, abs=1e-3)
    assert model.body("ghost").mass[0] == 0
    assert not any("ghost" in model.geom(int(g)).name for contact in data.contact for g in contact.geom)


def test_samples_lie_in_the_documented_ranges_and_repeat_with_the_seed():
    objects = [sample_object(np.random.default_rng(seed)) for seed in range(400)]
    assert {o.kind for o in objects} == set(SIZES)
    masses = np.array([o.mass for o in objects])
    assert masses.min() >= 0.03
    assert masses.max() <= 0.25
    # Log-uniform: half of the objects weigh less than the geometric mean, 87 g (binomial: +-5 %, 2 sigma).
    assert np.mean(masses < np.sqrt(0.03 * 0.25)) == pytest.approx(0.5, abs=0.075)
    assert all(0.5 <= o.friction <= 1.2 for o in objects)
    for o in objects:
        if o.kind == "box" or o.kind == "cylinder":
            extents = 2 * np.array(o.size)
        elif o.kind == "capsule":
            extents = 2 * np.array([o.size[0], o.size[0] + o.size[1]])
        else:
            extents = 2 * np.array(o.size[2:])
        assert extents.min() >= 0.03
        assert extents.max() <= (0.11 if o.kind == "capsule" else 0.08)
    assert objects[3] == sample_object(np.random.default_rng(3))
    assert sample_object(np.random.default_rng(3), "capsule").kind == "capsule"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("ball", (0.02,), 0.1), "Valid kinds: box, cylinder, capsule, tool"),
        (("box", (0.02, 0.02), 0.1), r"3 lengths \(half_x, half_y, half_z\)"),
        (("cylinder", (0.02, -0.03), 0.1), r"Got \(0.02, -0.03\)"),
        (("cylinder", (20, 30), 0.1), r"in \(0, 1\) m"),
        (("box", (0.02,) * 3, 0.0), "`mass` must be positive"),
        (("box", (0.02,) * 3, float("nan")), "`mass` must be positive"),
        (("box", (0.02,) * 3, 0.1, -0.5), "`friction` must be 0 or more"),
        (("box", (0.02,) * 3, 0.1, 1.0, (255, 0, 0)), "`colour` must be red, green, blue"),
    ],
)
def test_senseless_objects_are_refused_with_the_remedy(arguments, message):
    with pytest.raises(DexFlexError, match=message):
        ObjectSpec(*arguments)
