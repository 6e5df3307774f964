import ctypes
import os
import subprocess
import sys
import textwrap

import pytest

from lerobot_dexflex._gl import select_backend

EGL, DESKTOP_GL, OSMESA = "libEGL.so.1", "libGL.so.1", "libOSMesa.so.8"


@pytest.fixture
def machine(monkeypatch):
    """Pretend to be a Linux machine with these libraries and these environment variables only."""

    def pretend(*libraries, **environment):
        def load(name, *args, **kwargs):
            if name not in libraries:
                raise OSError(f"{name}: cannot open shared object file")

        monkeypatch.setattr(ctypes, "CDLL", load)
        monkeypatch.setattr(sys, "platform", "linux")
        for variable in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
            monkeypatch.setenv(variable, "")  # So that whatever is set meanwhile is undone.
            monkeypatch.delenv(variable)
        for variable, value in environment.items():
            monkeypatch.setenv(variable, value)

    return pretend


def test_egl_is_preferred(machine):
    machine(EGL, DESKTOP_GL, OSMESA)
    assert select_backend() == "egl"
    assert os.environ["MUJOCO_GL"] == "egl"


def test_egl_without_desktop_gl_is_passed_over(machine):
    machine(EGL, OSMESA)
    assert select_backend() == "osmesa"
    assert os.environ["MUJOCO_GL"] == "osmesa"


def test_without_any_library_images_are_ray_cast(machine):
    machine()
    assert select_backend() == "ray"
    assert os.environ["MUJOCO_GL"] == "disable"


def test_a_library_that_is_not_on_linux_is_not_tried(machine, monkeypatch):
    machine(EGL, DESKTOP_GL)
    monkeypatch.setattr(sys, "platform", "darwin")
    assert select_backend() == "ray"


def test_asking_twice_gives_the_same_answer_without_a_warning(machine, recwarn):
    machine(OSMESA)
    assert [select_backend(), select_backend()] == ["osmesa", "osmesa"]
    assert not recwarn


@pytest.mark.parametrize(
    ("value", "backend"), [("osmesa", "osmesa"), ("disable", "ray"), ("OFF", "ray"), ("glfw", "glfw")]
)
def test_the_users_choice_is_kept_when_it_can_work(machine, recwarn, value, backend):
    machine(EGL, DESKTOP_GL, OSMESA, MUJOCO_GL=value)
    assert select_backend() == backend
    assert os.environ["MUJOCO_GL"] == value
    assert not recwarn


@pytest.mark.parametrize("value", ["egl", "vulkan"])
def test_the_users_choice_is_replaced_with_a_warning_when_it_cannot_work(machine, value):
    machine(OSMESA, MUJOCO_GL=value)
    with pytest.warns(UserWarning, match=rf"MUJOCO_GL='{value}' cannot be used.*Using 'osmesa'"):
        assert select_backend() == "osmesa"
    assert os.environ["MUJOCO_GL"] == "osmesa"


def test_a_platform_chosen_for_pyopengl_is_respected(machine):
    machine(EGL, DESKTOP_GL, OSMESA, PYOPENGL_PLATFORM="osmesa")
    assert select_backend() == "osmesa"


WITHOUT_LIBRARIES = """
    import ctypes
    load = ctypes.CDLL
    def refuse(name=None, *args, **kwargs):
        if name and any(part in str(name) for part in ("EGL", "OSMesa", "libGL", "libOpenGL")):
            raise OSError(f"{name}: cannot open shared object file")
        return load(name, *args, **kwargs)
    ctypes.CDLL = refuse
    import lerobot_dexflex
    import mujoco
    from lerobot_dexflex.envs.rendering import Camera
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><camera name='top' pos='0 0 1'/><geom size='.2'/></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    image = Camera(model, "top", 9, 9).render(data)
    print(image[4, 4].min() > 0, image[0, 0].max() == 0)
"""


@pytest.mark.parametrize("requested", [None, "egl", "osmesa"])
def test_a_machine_without_graphics_libraries_imports_and_renders(requested):
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    environment |= {"MUJOCO_GL": requested} if requested else {}
    code = textwrap.dedent(WITHOUT_LIBRARIES)
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["True", "True"]
    assert ("MUJOCO_GL" in run.stderr) == (requested is not None)
