import mujoco
import numpy as np
import pytest
from rendering_scenes import flat_scene, hand_scene, mean_difference, ready, share_off

from lerobot_dexflex.envs import rendering
from lerobot_dexflex.envs.rendering import Camera, tune_visuals
from lerobot_dexflex.errors import DexFlexError


def test_a_lit_floor_has_the_colour_that_lambert_predicts(backend):
    geom = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": (2, 2, 0.1), "rgba": (0.5, 0.4, 0.2, 1)}
    model, data = ready(flat_scene(**geom))
    image = Camera(model, "top", 5, 5, backend=backend).render(data)
    # Ambient .3; headlight .2 straight on; key .45 from (.4, .35, -.85) and fill .15 from (-.6, -.5, -.6),
    # of which the vertical share of the unit direction counts.
    light = 0.3 + 0.2 + 0.45 * 0.85 / np.sqrt(1.005) + 0.15 * 0.6 / np.sqrt(0.97)
    assert np.abs(image[2, 2] - 255 * light * np.array([0.5, 0.4, 0.2])).max() < 1.01


@pytest.mark.parametrize(("fovy", "pixels_per_metre"), [(90.0, 50.0), (53.1301, 100.0)])
def test_a_point_lands_where_the_pinhole_model_puts_it(backend, fovy, pixels_per_metre):
    # Half of 100 pixels span tan(45 deg) = 1 or tan(26.565 deg) = 0.5 at 1 m.
    geom = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": (0.03, 0.03, 0.001), "pos": (0.2, 0.3, 0)}
    model, data = ready(flat_scene(fovy, **geom))
    image = Camera(model, "top", 100, 120, backend=backend).render(data)
    rows, columns = np.nonzero(image.max(axis=-1))
    assert columns.mean() + 0.5 == pytest.approx(60 + 0.2 * pixels_per_metre, abs=0.6)
    assert rows.mean() + 0.5 == pytest.approx(50 - 0.3 * pixels_per_metre, abs=0.6)


def test_opengl_and_rays_draw_the_same_hand_and_objects(opengl):
    model, data = hand_scene()
    by_gl, by_rays = (Camera(model, "front", 96, 96, backend=b).render(data) for b in ("gl", "ray"))
    assert by_gl.std() > 10
    # OpenGL's round shapes have 12 sides: a pixel of their outline differs here and there.
    assert mean_difference(by_gl, by_rays) < 0.5
    assert share_off(by_gl, by_rays) < 0.01


def test_with_finely_tessellated_shapes_opengl_and_rays_agree_to_a_tenth_of_a_grey_level(opengl):
    model, data = hand_scene()
    model.vis.quality.numslices, model.vis.quality.numstacks = 28, 16
    by_gl, by_rays = (Camera(model, "front", 96, 96, backend=b).render(data) for b in ("gl", "ray"))
    assert mean_difference(by_gl, by_rays) < 0.1
    assert share_off(by_gl, by_rays) < 0.002


def test_a_translucent_object_lets_the_floor_shine_through(backend):
    geom = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": (2, 2, 0.1), "pos": (0, 0, -0.5)}
    spec = flat_scene(**geom, rgba=(0.5, 0.5, 0.5, 1))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.3, 0.3, 0.05), rgba=(0.9, 0.1, 0.1, 0.35))
    model, data = ready(spec)
    pixel = Camera(model, "top", 9, 9, backend=backend).render(data)[4, 4]
    light = 0.3 + 0.2 + 0.45 * 0.85 / np.sqrt(1.005) + 0.15 * 0.6 / np.sqrt(0.97)
    # Entering and leaving the box each leave 65 % of what lies behind.
    through = 0.65**2
    expected = 255 * light * (through * np.full(3, 0.5) + (1 - through) * np.array([0.9, 0.1, 0.1]))
    assert np.abs(pixel - expected).max() < 2
    assert model.geom_rgba[1, 3] == np.float32(0.35)


def test_taxels_and_sites_are_invisible(backend):
    images = []
    for touch in (True, False):
        model, data = hand_scene(touch=touch, camera_height=0.45)
        images.append(Camera(model, "front", 96, 96, backend=backend).render(data))
    assert np.array_equal(images[0], images[1])


def test_a_colour_changed_at_run_time_shows(backend):
    geom = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": (0.3, 0.3, 0.01), "rgba": (0, 1, 0, 1)}
    model, data = ready(flat_scene(**geom))
    camera = Camera(model, "top", 9, 9, backend=backend)
    assert camera.render(data)[4, 4].argmax() == 1
    model.geom_rgba[0] = (0, 0, 1, 1)
    assert camera.render(data)[4, 4].argmax() == 2


def test_a_material_colours_geoms_without_a_colour_of_their_own(backend):
    spec = flat_scene(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.3, 0.3, 0.01), material="paint")
    spec.add_material(name="paint", rgba=(0.9, 0, 0, 1), emission=0.5, specular=0)
    model, data = ready(spec)
    pixel = Camera(model, "top", 9, 9, backend=backend).render(data)[4, 4]
    assert pixel.tolist() == [255, 0, 0]  # 0.9 x 0.97 of reflected light alone would be 223.


def test_tuning_a_spec_twice_adds_its_lights_once():
    spec = mujoco.MjSpec()
    tune_visuals(spec)
    tune_visuals(spec)
    assert len(spec.lights) == 2


def test_an_unknown_camera_is_refused_with_the_valid_names():
    model, _ = hand_scene()
    with pytest.raises(DexFlexError, match=r"no camera 'side'. Available cameras: \['front'\]"):
        Camera(model, "side")


def test_a_light_that_rays_cannot_reproduce_is_refused():
    spec = flat_scene(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0))
    spec.worldbody.add_light(name="lamp", type=mujoco.mjtLightType.mjLIGHT_SPOT)
    with pytest.raises(DexFlexError, match=r"must be directional. Got others: \['lamp'\]"):
        Camera(spec.compile(), "top")


def test_an_orthographic_camera_is_refused():
    spec = flat_scene(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0))
    spec.camera("top").proj = mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC
    with pytest.raises(DexFlexError, match="perspective"):
        Camera(spec.compile(), "top")


def test_opengl_that_fails_at_run_time_is_replaced_by_rays_with_one_warning(monkeypatch):
    def fail(model):
        raise mujoco.FatalError("gladLoadGL error")

    monkeypatch.setattr(rendering, "thread_renderer", fail)
    monkeypatch.setattr(rendering, "select_backend", lambda: "egl")
    monkeypatch.setattr(rendering, "_opengl_failed", False)
    model, data = hand_scene()
    expected = Camera(model, "front", 32, 32, backend="ray").render(data)
    with pytest.warns(UserWarning, match="FatalError: gladLoadGL error") as warnings:
        images = [Camera(model, "front", 32, 32).render(data) for _ in range(2)]
    assert len(warnings) == 1
    assert all(np.array_equal(image, expected) for image in images)
    with pytest.raises(mujoco.FatalError):
        Camera(model, "front", 32, 32, backend="gl").render(data)
