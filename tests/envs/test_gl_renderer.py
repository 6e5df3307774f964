import os
import subprocess
import sys
import threading

import mujoco
import numpy as np
import pytest
from rendering_scenes import flat_scene, hand_scene, mean_difference, ready

from lerobot_dexflex import _gl
from lerobot_dexflex.envs import gl_renderer
from lerobot_dexflex.envs.rendering import Camera


def test_one_renderer_draws_rebuilt_models(opengl):
    renderers, images = set(), []
    for scale in (1.0, 1.5):
        model, data = hand_scene(scale)
        images.append(Camera(model, "front", 96, 96, backend="gl").render(data))
        by_rays = Camera(model, "front", 96, 96, backend="ray").render(data)
        assert mean_difference(images[-1], by_rays) < 0.7
        renderers.add(gl_renderer.thread_renderer(model))
    assert len(renderers) == 1
    assert mean_difference(*images) > 1


def test_a_floor_shows_although_the_first_model_had_none(opengl):
    sphere = flat_scene(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0))
    floor = flat_scene(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(2, 2, 0.1))
    images = []
    for spec in (sphere, floor):
        model, data = ready(spec)
        images.append(Camera(model, "top", 96, 96, backend="gl").render(data).max(axis=-1))
    assert (images[0] > 0).mean() < 0.05
    assert (images[1] > 0).all()


def test_a_rebuilt_model_with_another_mesh_shows_that_mesh(opengl):
    areas = []
    for width in (0.1, 0.3):
        geom = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": "slab"}
        spec = flat_scene(**geom)
        corners = [(x, y, z) for x in (-width, width) for y in (-0.2, 0.2) for z in (-0.01, 0.01)]
        spec.add_mesh(name="slab", uservert=np.ravel(corners))
        model, data = ready(spec)
        image = Camera(model, "top", 100, 100, backend="gl").render(data)
        areas.append((image.max(axis=-1) > 0).mean())
    # 2 m x 2 m are visible at the slab's depth.
    assert areas == pytest.approx([0.2 * 0.4 / 4, 0.6 * 0.4 / 4], rel=0.1)


def test_sizes_may_alternate_and_exceed_the_default_buffer(opengl):
    model, data = hand_scene()
    small = Camera(model, "front", 64, 64, backend="gl")
    first = small.render(data)
    assert Camera(model, "front", 700, 900, backend="gl").render(data).shape == (700, 900, 3)
    assert np.array_equal(small.render(data), first)


def test_another_thread_draws_the_same_picture(opengl):
    model, data = hand_scene()
    images = [Camera(model, "front", backend="gl").render(data)]
    thread = threading.Thread(target=lambda: images.append(Camera(model, "front", backend="gl").render(data)))
    thread.start()
    thread.join()
    assert np.array_equal(images[0], images[1])


def run_script(body, **environment):
    """Run a script that knows `scenes` and `Camera`; returns the finished process."""
    header = f"""
import sys
sys.path.insert(0, {os.path.dirname(__file__)!r})
import rendering_scenes as scenes
from lerobot_dexflex.envs.rendering import Camera
"""
    return subprocess.run(
        [sys.executable, "-c", header + body],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_process_forked_after_rendering_casts_rays_instead_of_hanging(opengl):
    run = run_script("""
import os
model, data = scenes.hand_scene()
parent = Camera(model, "front").render(data)
child = os.fork()
if child == 0:
    image = Camera(model, "front").render(data)
    os._exit(0 if scenes.mean_difference(image, parent) < 0.5 else 1)
print(os.waitpid(child, 0)[1])
""")
    assert run.stdout.split() == ["0"], run.stderr
    assert "forkserver" in run.stderr


def test_osmesa_draws_what_this_process_draws(opengl, tmp_path):
    if not _gl._loads("libOSMesa.so.8"):
        pytest.skip("no OSMesa library on this machine")
    path = tmp_path / "image.npy"
    run = run_script(
        f"""
import numpy as np
model, data = scenes.hand_scene()
np.save({str(path)!r}, Camera(model, "front", backend="gl").render(data))
""",
        MUJOCO_GL="osmesa",
        PYOPENGL_PLATFORM="osmesa",
    )
    assert run.returncode == 0, run.stderr
    model, data = hand_scene()
    assert mean_difference(np.load(path), Camera(model, "front", backend="gl").render(data)) < 0.1
