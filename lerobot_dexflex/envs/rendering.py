"""Cameras: the same picture with OpenGL or, without any graphics library, by casting rays.

Both paths draw the visible geoms (groups 0-2, no sites) with plain colours, Lambert shading, directional
lights and the headlight, on black, without shadows, textures or highlights. `tune_visuals` puts a spec into
the form in which they agree and in which software OpenGL is fast. Rays blend one translucent geom:
of two in a row the nearer, and as if nothing were inside it.

OpenGL contexts belong to one thread and do not survive a fork: every thread gets its own, and a process
forked after its parent has rendered casts rays instead of hanging. Start workers with `forkserver`/`spawn`.
"""

import warnings
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex._gl import select_backend
from lerobot_dexflex.envs.gl_renderer import thread_renderer
from lerobot_dexflex.envs.ray_renderer import RayRenderer
from lerobot_dexflex.errors import DexFlexError

VISIBLE_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)
"""Geom groups that cameras see; taxel plates are in group 5."""

_KEY_LIGHT = (0.4, 0.35, -0.85)
_FILL_LIGHT = (-0.6, -0.5, -0.6)
_opengl_failed = False


def tune_visuals(spec: mujoco.MjSpec) -> None:
    """Give a spec the light, quality and clipping settings that both rendering paths reproduce.

    Curved surfaces get 12 slices and 8 stacks and there is no multisampling, which makes software OpenGL five
    times faster. The extent is fixed at 1 m, so that clipping does not change with procedural objects.

    Args:
        spec: The spec to change in place; two directional lights are added unless it has them already.
    """
    visual = spec.visual
    visual.quality.offsamples = 0
    visual.quality.shadowsize = 0
    visual.quality.numslices, visual.quality.numstacks, visual.quality.numquads = 12, 8, 1
    visual.headlight.ambient = (0.3, 0.3, 0.3)
    visual.headlight.diffuse = (0.2, 0.2, 0.2)
    visual.headlight.specular = (0, 0, 0)
    visual.map.znear, visual.map.zfar = 0.005, 20.0
    spec.stat.extent = 1.0
    add_lights(spec)


def add_lights(spec: mujoco.MjSpec) -> None:
    """Add a key and a fill light, directional and without shadows, unless the spec has them already."""
    for name, direction, diffuse in (("key", _KEY_LIGHT, 0.45), ("fill", _FILL_LIGHT, 0.15)):
        if spec.light(name) is None:
            spec.worldbody.add_light(
                name=name,
                type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
                pos=(0, 0, 2),
                dir=direction,
                diffuse=(diffuse, diffuse, diffuse),
                ambient=(0, 0, 0),
                specular=(0, 0, 0),
                castshadow=False,
            )


class Camera:
    """A named camera of a model. Nothing is created before the first frame."""

    def __init__(
        self,
        model: mujoco.MjModel,
        name: str,
        height: int = 96,
        width: int = 96,
        backend: Literal["auto", "gl", "ray"] = "auto",
    ) -> None:
        """Check that the camera exists and that both paths can draw the model.

        Args:
            model: The compiled model. After a rebuild make a new `Camera`: it costs microseconds.
            name: Name of a perspective camera in the model.
            height: Image height in pixels.
            width: Image width in pixels.
            backend: `"auto"` uses OpenGL if it works in this process and rays otherwise, with one warning if
                OpenGL was there but failed; `"gl"` fails where OpenGL does; `"ray"` never touches OpenGL.

        Raises:
            DexFlexError: For an unknown camera, one that is not perspective, or lights that rays cannot
                reproduce.
        """
        self._model = model
        self._camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if self._camera < 0:
            valid = [model.camera(i).name for i in range(model.ncam)]
            raise DexFlexError(f"The model has no camera '{name}'. Available cameras: {valid}.")
        _check_reproducible(model, self._camera, name)
        self._size = (height, width)
        self._backend = backend
        self._rays: RayRenderer | None = None

    def render(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Return the picture. Shape (height, width, 3), RGB.

        Args:
            data: Simulation data with up-to-date kinematics (after `mj_step` or `mj_forward`).
        """
        return np.ascontiguousarray(self._draw(data))

    def _draw(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        if self._rays is None and self._wants_opengl():
            try:
                renderer = thread_renderer(self._model)
                return renderer.render(self._model, data, self._camera, *self._size, VISIBLE_GROUPS)
            except Exception as error:  # Drivers, PyOpenGL and MuJoCo fail in many types.
                if self._backend == "gl":
                    raise
                _give_up_opengl(error)
        if self._rays is None:
            self._rays = RayRenderer(self._model, self._camera, *self._size, VISIBLE_GROUPS)
        return self._rays.render(data)

    def _wants_opengl(self) -> bool:
        if self._backend == "auto":
            return not _opengl_failed and select_backend() != "ray"
        return self._backend == "gl"


def _give_up_opengl(error: Exception) -> None:
    global _opengl_failed
    _opengl_failed = True
    warnings.warn(
        f"OpenGL cannot be used in this process ({type(error).__name__}: {error}). Images are ray-cast "
        "instead: the same pictures, about three times slower.",
        stacklevel=4,
    )


def _check_reproducible(model: mujoco.MjModel, camera: int, name: str) -> None:
    if model.cam_projection[camera] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
        raise DexFlexError(f"Camera '{name}' must be a perspective camera.")
    directional = model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    if not directional.all():
        lights = [model.light(i).name for i in np.flatnonzero(~directional)]
        raise DexFlexError(f"Lights must be directional. Got others: {lights}. Use `add_lights(spec)`.")
