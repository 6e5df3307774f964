"""Choose how images are rendered, before MuJoCo is imported.

MuJoCo reads `MUJOCO_GL` once, while it is imported, and an `egl` or `osmesa` whose library is missing makes
`import mujoco` itself raise AttributeError. Hence this probe: ctypes only, a few milliseconds.
"""

import ctypes
import os
import sys
import warnings
from typing import Literal

Backend = Literal["egl", "osmesa", "glfw", "ray"]

# One name of each inner tuple must load. PyOpenGL needs desktop GL beside EGL.
_LIBRARIES: dict[Backend, tuple[tuple[str, ...], ...]] = {
    "egl": (("libEGL.so.1",), ("libOpenGL.so.0", "libGL.so.1")),
    "osmesa": (("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"),),
}
_DISABLED = ("disable", "disabled", "off", "false", "0")
_WINDOWED = ("enable", "enabled", "on", "true", "1", "glfw", "glx")


def select_backend() -> Backend:
    """Return the rendering backend of this process and make `MUJOCO_GL` agree with it.

    A `MUJOCO_GL` set by the user is kept if its library loads; otherwise it is replaced with a warning,
    because MuJoCo would fail at import. `"ray"` (`MUJOCO_GL=disable`) needs no library: images then come
    from the ray-casting camera of `lerobot_dexflex.envs.rendering`. Calling this again gives the same answer.

    Returns:
        `"egl"` or `"osmesa"` (headless OpenGL), `"ray"` (no OpenGL), or `"glfw"`, only if the user asked
        for it (it needs a display).
    """
    requested = os.environ.get("MUJOCO_GL", "").lower().strip()
    if requested in _DISABLED:
        return "ray"
    if requested in _WINDOWED:
        return "glfw"
    if (requested == "egl" or requested == "osmesa") and _loadable(requested):
        return requested
    backend = _first_loadable()
    if requested:
        warnings.warn(
            f"MUJOCO_GL={requested!r} cannot be used here: unknown name, missing library, or a different "
            f"PYOPENGL_PLATFORM. Valid: egl, osmesa, glfw, disable. Using {backend!r} instead; on Debian "
            "install libegl1 libgl1 libgl1-mesa-dri for egl or libosmesa6 for osmesa.",
            stacklevel=2,
        )
    os.environ["MUJOCO_GL"] = "disable" if backend == "ray" else backend
    return backend


def _first_loadable() -> Backend:
    for backend in _LIBRARIES:
        if _loadable(backend):
            return backend
    return "ray"


def _loadable(backend: Backend) -> bool:
    if not sys.platform.startswith("linux"):
        return False
    if os.environ.get("PYOPENGL_PLATFORM", backend).lower() != backend:
        return False
    return all(any(_loads(name) for name in names) for names in _LIBRARIES[backend])


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
