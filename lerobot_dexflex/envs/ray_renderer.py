"""Draw a camera's picture by casting one ray per pixel: MuJoCo's physics library and numpy, nothing else."""

import mujoco
import numpy as np
from numpy.typing import NDArray

_UNSET_COLOR = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
"""MuJoCo's default geom rgba: a geom with a material and this colour shows the material's."""


class RayRenderer:
    """One pinhole camera with Lambert shading, directional lights and the headlight, on black.

    Colours, lights and poses are read at every frame, so they may be changed at run time.
    """

    def __init__(
        self, model: mujoco.MjModel, camera: int, height: int, width: int, visible_groups: NDArray[np.uint8]
    ) -> None:
        """Precompute the rays in the camera frame.

        Args:
            model: The compiled model.
            camera: Camera id; perspective, any `fovy`.
            height: Image height in pixels.
            width: Image width in pixels.
            visible_groups: Which geom groups are drawn. Shape (6,), 0 or 1.
        """
        self._model = model
        self._camera = camera
        self._shape = (height, width)
        self._groups = visible_groups
        self._far = float(model.vis.map.zfar * model.stat.extent)
        focal = 0.5 * height / np.tan(np.radians(model.cam_fovy[camera]) / 2)  # pixels
        right, up = np.meshgrid(np.arange(width) + 0.5 - width / 2, height / 2 - np.arange(height) - 0.5)
        rays = np.stack([right, up, np.full_like(up, -focal)], axis=-1).reshape(-1, 3)
        self._rays_camera = rays / np.linalg.norm(rays, axis=1, keepdims=True)  # (pixels, 3)
        n = height * width
        self._rays_world = np.empty((n, 3))
        self._geom = np.empty(n, np.int32)
        self._distance = np.empty(n)
        self._normal = np.empty((n, 3))

    def render(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Return the picture. Shape (height, width, 3), RGB."""
        orientation = data.cam_xmat[self._camera].reshape(3, 3)
        np.matmul(self._rays_camera, orientation.T, out=self._rays_world)
        everything = np.arange(len(self._rays_world))
        color, opacity = self._cast(data, everything, -orientation[:, 2])
        veiled = np.flatnonzero(opacity < 1)
        if veiled.size:
            behind = self._cast_behind(data, veiled, -orientation[:, 2])
            color[veiled] = opacity[veiled] * color[veiled] + (1 - opacity[veiled]) * behind
        return (color * 255 + 0.5).astype(np.uint8).reshape(*self._shape, 3)

    def _cast_behind(
        self, data: mujoco.MjData, pixels: NDArray[np.intp], forward: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Return what lies behind translucent geoms. Shape (pixels, 3)."""
        alpha = self._model.geom_rgba[:, 3]
        kept = alpha.copy()
        alpha[kept < 1] = 0.0  # Rays pass through invisible geoms.
        try:
            return self._cast(data, pixels, forward)[0]
        finally:
            alpha[:] = kept

    def _cast(
        self, data: mujoco.MjData, pixels: NDArray[np.intp], forward: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return colour (pixels, 3) in [0, 1] and opacity (pixels, 1) of the first geom along some rays."""
        n = len(pixels)
        mujoco.mj_multiRay(
            self._model,
            data,
            data.cam_xpos[self._camera],
            self._rays_world[pixels].ravel(),  # pyright: ignore[reportArgumentType]
            self._groups,  # pyright: ignore[reportArgumentType]
            1,
            -1,
            self._geom[:n],  # pyright: ignore[reportArgumentType]
            self._distance[:n],  # pyright: ignore[reportArgumentType]
            self._normal[:n].reshape(-1),  # pyright: ignore[reportArgumentType]
            n,
            self._far,
        )
        hit = np.flatnonzero(self._geom[:n] >= 0)
        geom = self._geom[hit]
        reflectance, emission = self._surfaces()
        light = self._light(data, self._normal[hit].astype(np.float32), forward) + emission[geom]
        color, opacity = np.zeros((n, 3), np.float32), np.ones((n, 1), np.float32)
        color[hit] = np.minimum(reflectance[geom, :3] * light, 1.0)
        # OpenGL blends a translucent geom twice, where a ray enters and where it leaves.
        opacity[hit] = 1 - (1 - reflectance[geom, 3:]) ** 2
        return color, opacity

    def _light(
        self, data: mujoco.MjData, normals: NDArray[np.float32], forward: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Sum ambient + diffuse max(0, -normal . direction) over the lights. Shape (pixels, 3)."""
        model, headlight = self._model, self._model.vis.headlight
        on = np.flatnonzero(model.light_active)
        directions, diffuse, ambient = (
            data.light_xdir[on],
            model.light_diffuse[on],
            model.light_ambient[on].sum(0),
        )
        if headlight.active:
            directions = np.vstack([directions, forward])
            diffuse = np.vstack([diffuse, headlight.diffuse])
            ambient = ambient + headlight.ambient
        facing = np.maximum(normals @ -directions.T.astype(np.float32), 0.0)  # (pixels, lights)
        return facing @ diffuse.astype(np.float32) + ambient.astype(np.float32)

    def _surfaces(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return reflectance and opacity (geoms, 4) and emission (geoms, 1), unitless in [0, 1]."""
        model = self._model
        color = model.geom_rgba.copy()
        emission = np.zeros((model.ngeom, 1), np.float32)
        shaded = np.flatnonzero(model.geom_matid >= 0)
        if shaded.size:
            material = model.geom_matid[shaded]
            emission[shaded, 0] = model.mat_emission[material]
            plain = (color[shaded] == _UNSET_COLOR).all(axis=1)
            color[shaded[plain]] = model.mat_rgba[material[plain]]
        return color, emission
