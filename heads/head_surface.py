"""What the renderer needs of a head, once a head: coordinates, parts, textures in all sizes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from .head import Head
from .raycast import NO_HIT, RayScene
from .shading import EYE, EYE_LEFT, LASH, SKIN, TEETH, TONGUE

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

#: Part codes of the shading loop; all else is skin.
_CODE = {
    "eye_right": EYE,
    "eye_left": EYE_LEFT,
    "lashes": LASH,
    "teeth_upper": TEETH,
    "teeth_lower": TEETH,
    "tongue": TONGUE,
}
_THICKEST_MM = 14.0  # light does not come through more
_TEXELS_PER_MM = 4.4 / 2048  # on the face, of a texture one texel high
_SMALLEST_LEVEL = 128


@dataclass(frozen=True, eq=False)
class HeadSurface:
    """A head's constant part of the work.

    Attributes
    ----------
    triangles, uv_triangles : (F, 3) int32
    uv : (U, 2) float32
    part : (F,) uint8
        Codes of `shading`.
    skin, normal : lists of (h, w, 3) uint8; roughness : list of (h, w) uint8
        Textures, each half the size of the one before.
    eye : (h, w, 3) uint8; details : (h, w, 4) uint8
    thickness_mm : (V,) float32
        Of the skin mesh along the normal at rest; inf where it is thick.
    eye_fronts : part code → (vertices of the ball, 8 vertices about its axis)
    """

    triangles: NDArray[np.int32]
    uv_triangles: NDArray[np.int32]
    uv: Floats
    part: NDArray[np.uint8]
    skin: list[Picture]
    normal: list[Picture]
    roughness: list[Picture]
    eye: Picture
    details: Picture
    thickness_mm: Floats
    eye_fronts: dict[int, tuple[NDArray[np.int32], NDArray[np.int32]]]

    @classmethod
    def of(cls, head: Head, normals: Floats) -> HeadSurface:
        """Read a head; `normals` (V, 3) are those of its neutral face."""
        mesh, looks = head.mesh, head.appearance
        triangles = np.ascontiguousarray(mesh.triangles, dtype=np.int32)
        uv = mesh.uv if looks.uv is None else looks.uv
        if uv is None or mesh.uv_triangles is None:
            uv, uv_triangles = np.full((1, 2), 0.5), np.zeros_like(triangles)
        else:
            uv_triangles = np.asarray(mesh.uv_triangles)
        if uv_triangles.size and uv_triangles.max() >= len(uv):
            raise InputError(f"head {head.name}: its appearance's uv do not fit its mesh")
        part = np.full(len(triangles), SKIN, dtype=np.uint8)
        for name, code in _CODE.items():
            if name in mesh.groups and (looks.eye is not None or code > EYE_LEFT):
                part[mesh.groups[name]] = code
        if looks.details is None:
            part[part >= LASH] = SKIN
        flat = np.full((4, 4, 3), (128, 128, 255), np.uint8)
        middling = np.full((4, 4), 128, np.uint8)
        no_details = np.zeros((4, 4, 4), np.uint8)
        uv32 = np.ascontiguousarray(uv, dtype=np.float32)
        uv_triangles = np.ascontiguousarray(uv_triangles, dtype=np.int32)
        return cls(
            triangles=triangles,
            uv_triangles=uv_triangles,
            uv=uv32,
            part=part,
            skin=_pyramid(looks.skin),
            normal=_pyramid(flat if looks.normal is None else looks.normal),
            roughness=_pyramid(middling if looks.roughness is None else looks.roughness),
            eye=np.ascontiguousarray(looks.skin if looks.eye is None else looks.eye),
            details=np.ascontiguousarray(no_details if looks.details is None else looks.details),
            thickness_mm=_thickness(mesh.vertices, triangles[part == SKIN], normals),
            eye_fronts={
                code: _front_rows(triangles, uv_triangles, uv32, part == code)
                for code in (EYE, EYE_LEFT)
                if (part == code).any()
            },
        )

    def textures(self, samples_per_mm: float) -> tuple[Picture, Picture, Picture]:
        """Skin, roughness and normals with about a texel a sample on the face."""
        skin, rough, normal = (
            levels[_level(levels, samples_per_mm)]
            for levels in (self.skin, self.roughness, self.normal)
        )
        return skin, rough, normal

    def lash_alpha(self, triangle: NDArray[np.uint32], weights: Floats) -> Floats:
        """How much the lashes hide at places on them, (N,)."""
        corners = self.uv[self.uv_triangles[triangle]]
        b = np.stack([1 - weights.sum(axis=1), weights[:, 0], weights[:, 1]], axis=1)
        uv = np.einsum("nc,ncx->nx", b, corners)
        height, width = self.details.shape[:2]
        column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
        row = np.clip(((1 - uv[:, 1]) * height).astype(int), 0, height - 1)
        return np.asarray(self.details[row, column, 3] / 255, dtype=np.float32)


def _level(levels: list[Picture], samples_per_mm: float) -> int:
    ratio = _TEXELS_PER_MM * levels[0].shape[0] / max(samples_per_mm, 1e-3)
    return int(np.clip(round(np.log2(max(ratio, 1e-3)) - 0.25), 0, len(levels) - 1))


def _pyramid(picture: Picture) -> list[Picture]:
    levels = [np.ascontiguousarray(picture)]
    while min(levels[-1].shape[:2]) > _SMALLEST_LEVEL:
        half = levels[-1].shape[1] // 2, levels[-1].shape[0] // 2
        levels.append(np.asarray(cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA)))
    return levels


def _thickness(vertices: NDArray[np.float64], skin: NDArray[np.int32], normals: Floats) -> Floats:
    """Way through the skin mesh along the normals, (V,) mm; inf where it is long."""
    found = np.full(len(vertices), np.inf, np.float32)
    rows = np.unique(skin)
    scene = RayScene(vertices, skin)
    t, triangle, _ = scene.cast(vertices[rows] - 0.1 * normals[rows], -normals[rows])
    # the far side faces away: else the ray has met the front of something else
    corners = vertices[skin[np.where(triangle == NO_HIT, 0, triangle)]]
    out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    leaves = (out * normals[rows]).sum(axis=1) < 0
    thin = (triangle != NO_HIT) & leaves & (t > 0.5) & (t < _THICKEST_MM)
    found[rows[thin]] = t[thin]
    return found


def _front_rows(
    triangles: NDArray[np.int32],
    uv_triangles: NDArray[np.int32],
    uv: Floats,
    chosen: NDArray[np.bool_],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Vertices of an eyeball, and its 8 nearest to the middle of the iris."""
    rows, first = np.unique(triangles[chosen], return_index=True)
    off = np.linalg.norm(uv[uv_triangles[chosen].ravel()[first]] - 0.5, axis=1)
    return rows, rows[np.argsort(off, kind="stable")[:8]]
