"""Draw pictures with OpenGL: one context per thread, re-used for every size and every rebuilt model."""

import atexit
import importlib
import os
import threading
import weakref
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex._gl import select_backend
from lerobot_dexflex.errors import DexFlexError

_MAX_GEOMS = 2000
_HIDDEN_EFFECTS = (
    mujoco.mjtRndFlag.mjRND_SHADOW,
    mujoco.mjtRndFlag.mjRND_REFLECTION,
    mujoco.mjtRndFlag.mjRND_SKYBOX,
    mujoco.mjtRndFlag.mjRND_HAZE,
)
_CONTEXT_MODULES = {"egl": "mujoco.egl", "osmesa": "mujoco.osmesa", "glfw": "mujoco.glfw"}
_thread = threading.local()
_created_in: int | None = None
"""Process in which a context was created last; after a fork it is not ours."""


class GlRenderer:
    """An offscreen OpenGL context that draws any camera of any model at any size.

    Creating it costs about 0.1 s and leaks about 1 MB when freed, so models that are rebuilt every episode
    must share one. What it keeps on the graphics side are planes, meshes, textures and height fields; these
    are uploaded anew only when they differ.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Create the context in the calling thread, the only one that may use it.

        Args:
            model: The first model to draw.
        """
        self._owner = os.getpid(), threading.get_ident()
        self._context: Any = None
        self._graphics: mujoco.MjrContext | None = None
        module = importlib.import_module(_CONTEXT_MODULES[select_backend()])
        self._context = module.GLContext(640, 480)
        self._context.make_current()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._load(model)

    def render(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        camera: int,
        height: int,
        width: int,
        visible_groups: NDArray[np.uint8],
    ) -> NDArray[np.uint8]:
        """Return the picture. Shape (height, width, 3), RGB.

        Args:
            model: The model `data` belongs to.
            data: Simulation data with up-to-date kinematics.
            camera: Camera id.
            height: Image height in pixels.
            width: Image width in pixels.
            visible_groups: Which geom groups are drawn. Shape (6,), 0 or 1.
        """
        self._context.make_current()
        if model is not self._model and not self._shares_assets(model):
            self._load(model)
        self._model = model
        graphics = self._graphics
        assert graphics is not None
        if height > graphics.offHeight or width > graphics.offWidth:
            size = max(width, graphics.offWidth), max(height, graphics.offHeight)
            mujoco.mjr_resizeOffscreen(*size, graphics)
        self._camera.fixedcamid = camera
        self._option.geomgroup[:] = visible_groups
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._scene)
        rectangle = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rectangle, self._scene, graphics)
        image = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(image, None, rectangle, graphics)  # pyright: ignore[reportArgumentType]
        return image[::-1]

    def close(self) -> None:
        """Free the context; does nothing the second time, in a forked child or in another thread."""
        if self._context is None or self._owner != (os.getpid(), threading.get_ident()):
            return
        self._context.make_current()
        self._free_graphics()
        self._context.free()
        self._context = None

    def __del__(self) -> None:
        self.close()

    def _load(self, model: mujoco.MjModel) -> None:
        """Upload the assets of a model to the graphics side."""
        self._free_graphics()
        self._model = model
        self._assets = _assets(model)
        self._graphics = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._graphics)
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        for effect in _HIDDEN_EFFECTS:
            self._scene.flags[effect] = 0

    def _shares_assets(self, model: mujoco.MjModel) -> bool:
        return all(np.array_equal(a, b) for a, b in zip(self._assets, _assets(model), strict=True))

    def _free_graphics(self) -> None:
        if self._graphics is not None:
            self._graphics.free()
        self._graphics = None


def thread_renderer(model: mujoco.MjModel) -> GlRenderer:
    """Return the renderer of the calling thread, created on first use for `model`.

    Raises:
        DexFlexError: In a process forked after its parent created a context, where OpenGL would hang.
    """
    global _created_in
    if _created_in is not None and _created_in != os.getpid():
        raise DexFlexError(
            f"OpenGL was already in use when process {_created_in} forked this one and would hang here. "
            "Start workers with 'forkserver' or 'spawn'."
        )
    renderer = getattr(_thread, "renderer", None)
    if renderer is None:
        renderer = _thread.renderer = GlRenderer(model)
        _created_in = os.getpid()
        # OpenGL is gone when Python deletes modules; a weak reference leaves the contexts of threads to them.
        atexit.register(_close, weakref.ref(renderer))
    return renderer


def _close(reference: weakref.ref[GlRenderer]) -> None:
    renderer = reference()
    if renderer is not None:
        renderer.close()


def _assets(model: mujoco.MjModel) -> tuple[Any, ...]:
    """Return what a graphics context copies from a model when it is created."""
    quality = model.vis.quality
    planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE  # Unlike other primitives stored at their size.
    return (
        (quality.numslices, quality.numstacks, quality.numquads, quality.offsamples, quality.shadowsize),
        (model.nskin, model.nflex),
        model.geom_size[planes],
        model.mesh_vert,
        model.mesh_face,
        model.hfield_data,
        model.tex_data,
    )
