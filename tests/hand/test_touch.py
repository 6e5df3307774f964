import itertools

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.touch import TouchConfig, TouchSensor, add_touch
from lerobot_dexflex.hands import LEAP

BOX, CYLINDER, CAPSULE, SPHERE = (
    getattr(mujoco.mjtGeom, f"mjGEOM_{name}") for name in ("BOX", "CYLINDER", "CAPSULE", "SPHERE")
)
ALONG, ACROSS = (0.5**0.5, 0, 0.5**0.5, 0), (0.5**0.5, 0.5**0.5, 0, 0)
"""Turn a cylinder's axis from the pad normal to along or across the finger."""
TILTED = (0.9239, 0.3827, 0, 0)
"""Turn a box by 45 degrees, so that an edge along the finger touches."""
SHAPES = {
    "face": (BOX, (0.02, 0.02, 0.02), (1, 0, 0, 0)),
    "edge": (BOX, (0.02, 0.02, 0.02), TILTED),
    "corner": (BOX, (0.02, 0.02, 0.02), (0.8805, 0.2798, 0.3647, 0.1159)),
    "cylinder end": (CYLINDER, (0.008, 0.02, 0), (1, 0, 0, 0)),
    "cylinder across": (CYLINDER, (0.02, 0.03, 0), ACROSS),
    "cylinder along": (CYLINDER, (0.02, 0.03, 0), ALONG),
    "capsule": (CAPSULE, (0.01, 0.02, 0), ACROSS),
    "sphere": (SPHERE, (0.01, 0, 0), (1, 0, 0, 0)),
}


def stiff_hand():
    """The real hand with touch, its joints held by friction as thick as honey, without gravity."""
    spec = robot.base_spec()
    spec.option.gravity = (0, 0, 0)
    robot.add_hand(spec, spec.worldbody, LEAP)
    add_touch(spec, LEAP)
    for joint in spec.joints:
        joint.damping[0] = 1e5
    return spec


def press(shape, force=2.0, finger="if", offset=(0.0, 0.0), collision=robot.WORLD_COLLISION):
    """Push a shape against a pad with `force` [N], its centre `offset` [m] from the pad's (along, across)."""
    model, data = ready(stiff_hand())
    pad = data.site(f"{finger}_pad")
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, pad.xmat)
    spec = stiff_hand()
    start = pad.xpos + pad.xmat.reshape(3, 3) @ (*offset, 0.04)
    body = spec.worldbody.add_body(name="object", pos=start, quat=quaternion)
    slide = body.add_joint(name="press", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, -1))
    slide.damping[0] = 8
    kind, size, turn = SHAPES[shape]
    contype, conaffinity = collision
    body.add_geom(type=kind, size=size, quat=turn, mass=0.05, contype=contype, conaffinity=conaffinity)
    model, data = ready(spec)
    data.joint("press").qfrc_applied[0] = force
    mujoco.mj_step(model, data, 500)
    mujoco.mj_forward(model, data)
    return model, data


def ready(spec):
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def contact_force_on_pads(model, data):
    """Add up MuJoCo's contact forces on tip and nose geoms, along the inward pad normals. Shape (4,), [N]."""
    forces, wrench = np.zeros(4), np.zeros(6)
    for k, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, k, wrench)
        on_second = contact.frame.reshape(3, 3).T @ wrench[:3]
        for sign, geom in ((-1, contact.geom[0]), (1, contact.geom[1])):
            name = model.geom(int(geom)).name
            if name.endswith(("_tip", "_nose")):
                normal = data.site(f"{name[:2]}_pad").xmat.reshape(3, 3)[:, 2]
                forces[LEAP.prefixes.index(name[:2])] -= sign * on_second @ normal
    return forces


def ideal(model):
    return TouchSensor(model, LEAP, TouchConfig.ideal())


@pytest.mark.parametrize("offset", [(0, 0), (0.004, 0.003), (0.0125, 0)])
@pytest.mark.parametrize("shape", SHAPES)
def test_taxels_sum_to_the_true_contact_force(shape, offset):
    model, data = press(shape, offset=offset)
    taxels = ideal(model).true_taxels(data)
    assert taxels.shape == (4, 10, 6)
    assert taxels.min() >= 0
    assert contact_force_on_pads(model, data) == pytest.approx([2, 0, 0, 0], rel=0.002, abs=1e-6)
    assert taxels.sum(axis=(1, 2)) == pytest.approx(contact_force_on_pads(model, data), rel=0.02, abs=1e-9)
    assert ideal(model).normal_forces(data) == pytest.approx(taxels.sum(axis=(1, 2)))


def test_force_at_the_nose_is_carried_by_the_rows_nearest_to_it():
    model, data = press("sphere", offset=(0.018, 0.0))
    rows = ideal(model).true_taxels(data)[0].sum(axis=1)
    assert rows.sum() == pytest.approx(2, rel=0.02)
    assert rows[8:].sum() > 1.9


@pytest.mark.parametrize("finger", LEAP.prefixes)
def test_every_finger_feels_its_own_pad_only(finger):
    model, data = press("sphere", finger=finger)
    touched = ideal(model).normal_forces(data) > 0
    assert [f for f, t in zip(LEAP.prefixes, touched, strict=True) if t] == [finger]


def test_a_flat_face_loads_all_taxels_alike():
    model, data = press("face")
    taxels = ideal(model).true_taxels(data)[0]
    assert np.abs(taxels * 60 / 2 - 1).max() < 0.05


def test_a_cylinder_on_its_end_loads_the_taxels_below_it():
    model, data = press("cylinder end")
    taxels = ideal(model).true_taxels(data)[0]
    along, across = np.meshgrid((np.arange(10) - 4.5) * 2.5, (np.arange(6) - 2.5) * 3.3, indexing="ij")
    radius = np.hypot(along, across)  # [mm]; the cylinder's is 8
    assert taxels[radius < 7].min() > 0.5 * taxels.max()
    assert taxels[radius > 11].max() < 0.02 * taxels.max()


def test_a_sphere_is_felt_where_it_is():
    offset = np.array([0.00625, -0.00495])
    model, data = press("sphere", offset=offset)
    taxels = ideal(model).true_taxels(data)[0]
    along = taxels.sum(axis=1) @ (np.arange(10) - 4.5) * 0.0025 / taxels.sum()
    across = taxels.sum(axis=0) @ (np.arange(6) - 2.5) * 0.0033 / taxels.sum()
    assert [along, across] == pytest.approx(offset, abs=0.0007)
    assert (taxels > 0.05 * taxels.max()).sum() < 25


def test_a_cylinder_along_the_finger_and_one_across_it_feel_different():
    spreads = []
    for shape in ("cylinder along", "cylinder across"):
        model, data = press(shape)
        taxels = ideal(model).true_taxels(data)[0]
        spreads.append((taxels.sum(axis=1).std(), taxels.sum(axis=0).std()))
    assert spreads[0][0] < spreads[1][0]
    assert spreads[0][1] > spreads[1][1]


def test_more_force_never_lowers_a_taxel_and_always_raises_the_sum():
    frames = []
    for force in (0.5, 1.0, 2.0, 4.0):
        model, data = press("sphere", force)
        frames.append(ideal(model).true_taxels(data)[0])
    assert all((after - before).min() > -0.002 for before, after in itertools.pairwise(frames))
    assert [frame.sum() for frame in frames] == pytest.approx([0.5, 1.0, 2.0, 4.0], rel=0.02)


def test_another_fingers_tip_is_felt_like_an_object():
    model, data = press("capsule", collision=robot.TIP_COLLISION)
    assert ideal(model).true_taxels(data)[0].sum() == pytest.approx(2, rel=0.02)


class StillHand:
    """A touch sensor whose true taxels are given."""

    def __init__(self, taxels, **config):
        self.sensor = ideal(ready(stiff_hand())[0])
        self.sensor.config = TouchConfig(**config)
        self.taxels = np.broadcast_to(np.asarray(taxels, float), (4, 10, 6))
        self.sensor.true_taxels = lambda data: self.taxels.copy()  # pyright: ignore

    def read(self, seed=0):
        return self.sensor.read(None, np.random.default_rng(seed))  # pyright: ignore


def test_without_sensor_effects_the_reading_is_the_truth():
    model, data = press("sphere")
    sensor = ideal(model)
    reading = sensor.read(data, np.random.default_rng(0))
    assert reading.dtype == np.float32
    assert reading == pytest.approx(sensor.true_taxels(data), abs=1e-6)


def test_noise_has_its_standard_deviation_and_no_bias():
    readings = StillHand(0.5, noise_std=0.01, threshold=0.0)
    samples = np.array([readings.read(seed) for seed in range(100)]) - 0.5  # 24000 of them
    assert samples.std() == pytest.approx(0.01, rel=0.03)
    assert abs(samples.mean()) < 4 * 0.01 / np.sqrt(samples.size)


def test_readings_below_the_threshold_are_zero_and_never_negative():
    taxels = np.linspace(0, 0.03, 240).reshape(4, 10, 6)
    reading = StillHand(taxels, noise_std=0.0, threshold=0.02).read()
    assert (reading[taxels < 0.02] == 0).all()
    assert reading[taxels > 0.02] == pytest.approx(taxels[taxels > 0.02])
    assert StillHand(0.0).read().min() == 0


def test_an_untouched_sensor_with_default_settings_hardly_ever_reports_contact():
    # The threshold is 2.5 standard deviations: 0.62 % of one-sided Gaussian noise exceeds it.
    readings = np.array([StillHand(0.0).read(seed) for seed in range(10)])
    assert (readings > 0).mean() == pytest.approx(0.0062, abs=0.006)


def test_readings_saturate():
    assert StillHand(3.0, saturation=0.8).read().max() == pytest.approx(0.8)


def test_the_same_generator_gives_the_same_reading():
    sensor = StillHand(0.1)
    assert np.array_equal(sensor.read(7), sensor.read(7))
    assert not np.array_equal(sensor.read(7), sensor.read(8))


def test_latency_delays_readings_and_repeats_the_first_one_meanwhile():
    sensor = StillHand(0.0, noise_std=0.0, latency_steps=2)
    seen = []
    for force in (0.1, 0.2, 0.3, 0.4):
        sensor.taxels = np.full((4, 10, 6), force)
        seen.append(sensor.read().max())
    assert seen == pytest.approx([0.1, 0.1, 0.1, 0.2])
    sensor.sensor.reset()
    assert sensor.read().max() == pytest.approx(0.4)


def test_a_restored_state_continues_exactly():
    sensor = StillHand(0.0, latency_steps=2)

    def run(seeds):
        readings = []
        for seed in seeds:
            sensor.taxels = np.full((4, 10, 6), 0.1 * seed)
            readings.append(sensor.read(seed))
        return np.array(readings)

    run((1, 2))
    state = sensor.sensor.state()
    expected = run((3, 4, 5))
    run((6, 7))
    sensor.sensor.set_state(state)
    assert np.array_equal(run((3, 4, 5)), expected)


def test_a_model_without_touch_is_refused():
    spec = robot.base_spec()
    robot.add_hand(spec, spec.worldbody, LEAP)
    with pytest.raises(DexFlexError, match=r"no sensor 'if_taxels'. Call `add_touch\(spec, hand\)`"):
        TouchSensor(spec.compile(), LEAP)


@pytest.mark.parametrize(("field", "value"), [("skin", 0.0), ("noise_std", -0.1), ("latency_steps", -1)])
def test_impossible_settings_are_refused(field, value):
    with pytest.raises(DexFlexError, match=rf"`{field}` must .* Got {value}"):
        TouchConfig(**{field: value})
