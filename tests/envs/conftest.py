import sys
from pathlib import Path

import mujoco
import pytest

sys.path.insert(0, str(Path(__file__).parent))  # rendering_scenes, env_checks


@pytest.fixture(params=["gl", "ray"])
def backend(request):
    if request.param == "gl":
        request.getfixturevalue("opengl")
    return request.param


@pytest.fixture
def opengl():
    from rendering_scenes import flat_scene, ready

    from lerobot_dexflex import _gl
    from lerobot_dexflex.envs.rendering import Camera

    model, data = ready(flat_scene(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0)))
    if _gl.select_backend() == "ray":
        pytest.skip("no OpenGL library on this machine")
    try:
        Camera(model, "top", 8, 8, backend="gl").render(data)
    except Exception as error:
        pytest.skip(f"OpenGL does not work on this machine: {error}")
