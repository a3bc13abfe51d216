"""The one door to Open3D's ray caster."""

from __future__ import annotations

import ctypes
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: What the caster reports for a ray that hits nothing.
NO_HIT = 4294967295


@cache
def import_open3d() -> ModuleType:
    """Import Open3D; its library needs libusb-1.0, which the package libusb-package carries."""
    import libusb_package

    path = libusb_package.get_library_path()
    if path:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    import open3d

    return open3d


class RayScene:
    """Triangles to cast rays at. Made anew for every frame; the tree is built at the first cast.

    Parameters
    ----------
    vertices : (V, 3) float, mm
    triangles : (F, 3) int
    """

    def __init__(self, vertices: NDArray[Any], triangles: NDArray[Any]) -> None:
        o3d = import_open3d()
        self._o3d = o3d
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
            o3d.core.Tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
        )

    def cast(
        self, origins: NDArray[Any], directions: NDArray[Any]
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]:
        """First hits of rays.

        Parameters
        ----------
        origins, directions : (N, 3) float, mm
            One origin, (3,), serves for all.

        Returns
        -------
        (N,) float32, in lengths of the direction
            Distance; inf where nothing is hit.
        (N,) uint32
            Triangle; `NO_HIT` where nothing is hit.
        (N, 2) float32
            Barycentric weights of the triangle's second and third corner.
        """
        rays = np.empty((len(directions), 6), dtype=np.float32)
        rays[:, :3] = origins
        rays[:, 3:] = directions
        hit = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        return (
            hit["t_hit"].numpy(),
            hit["primitive_ids"].numpy(),
            hit["primitive_uvs"].numpy(),
        )

    def closest(
        self, points: NDArray[Any]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """Closest surface points: positions (N, 3), triangles (N,), barycentric (N, 3)."""
        query = self._o3d.core.Tensor(np.ascontiguousarray(points, dtype=np.float32))
        found = self._scene.compute_closest_points(query)
        uv = found["primitive_uvs"].numpy().astype(np.float64)
        b = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
        return (
            found["points"].numpy().astype(np.float64),
            found["primitive_ids"].numpy().astype(np.int64),
            b,
        )
