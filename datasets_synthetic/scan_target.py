"""What stands before a scanner: a person's surface, its colour, what light comes back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.mesh import Mesh, vertex_normals
from ..core.rigid import Rigid
from ..heads.bust import make_bust
from ..heads.head import Head
from ..heads.raycast import NO_HIT, RayScene
from ..heads.srgb import linear_from_srgb
from ..heads.texture_canvas import sample_bilinear

Floats = NDArray[np.float64]

_LIFT_MM = 0.06  # rays to lamp and camera start this far off: less than creases are wide
_SHIRT = (104, 108, 112)


@dataclass(frozen=True, eq=False)
class Seen:
    """Where rays met the surface.

    Attributes
    ----------
    hit : (N,) bool
        All below is NaN, 0 or False where nothing is.
    places : (N, 3) float64, mm, head frame
    normals : (N, 3) float64
        Smooth, towards the outside.
    colour : (N, 3) float32, linear
        Albedo.
    on_eye, in_hair : (N,) bool
        Eyeballs are wet; hair is what the texture shows as much darker or otherwise coloured than
        skin where hair grows.
    """

    hit: NDArray[np.bool_]
    places: Floats
    normals: Floats
    colour: NDArray[np.float32]
    on_eye: NDArray[np.bool_]
    in_hair: NDArray[np.bool_]


class ScanTarget:
    """A head and shoulders at rest, to be scanned.

    Parameters
    ----------
    head : Head
    seed : int
        Of the shoulders.

    Attributes
    ----------
    mesh : Mesh
        The true surface, head frame: skin, eyes, teeth, tongue, then shoulders.
    """

    def __init__(self, head: Head, seed: int) -> None:
        self.head = head
        solid = np.delete(
            np.arange(len(head.mesh.triangles)), np.asarray(head.mesh.groups.get("lashes", ()), int)
        )
        bust = make_bust(head, shirt=_SHIRT, seed=seed)
        body = bust.at(np.asarray(head.mesh.vertices), Rigid.identity())
        n = len(head.mesh.vertices)
        vertices = np.concatenate([head.mesh.vertices, body])
        triangles = np.concatenate([head.mesh.triangles[solid], bust.triangles + np.int32(n)])
        used, inverse = np.unique(triangles, return_inverse=True)
        self.mesh = Mesh(vertices[used], inverse.reshape(-1, 3).astype(np.int32))
        self._normals = vertex_normals(
            np.asarray(self.mesh.vertices), np.asarray(self.mesh.triangles)
        )
        self._solid = solid  # triangle of the head of each of the first triangles
        self._body_colour = np.asarray(bust.colour, np.float32)[used[used >= n] - n]
        self._n_head_vertices = int((used < n).sum())
        self._part = _parts(head)[solid]
        self._may_have_hair = _hair_regions(head)[solid]
        self._textures = {str(n): _spot_sized(head, str(n)) for n in np.unique(self._part)}
        self._skin_tone = _skin_tone(head)
        self.scene = RayScene(self.mesh.vertices, self.mesh.triangles)

    def look(self, origins: Floats, directions: Floats) -> Seen:
        """Follow rays (N, 3) from places (N, 3), head frame, to the surface."""
        _, triangle, weights = self.scene.cast(origins, directions)
        hit = triangle != NO_HIT
        n = len(hit)
        places = np.full((n, 3), np.nan)
        normals = np.full((n, 3), np.nan)
        colour = np.zeros((n, 3), np.float32)
        on_eye, in_hair = np.zeros(n, bool), np.zeros(n, bool)
        f, w = triangle[hit].astype(np.int64), weights[hit].astype(np.float64)
        b = np.stack([1 - w.sum(axis=1), w[:, 0], w[:, 1]], axis=1)
        corners = np.asarray(self.mesh.triangles)[f]
        # in double precision: what the caster computes is good to 1e-4 mm only
        places[hit] = np.einsum("nc,ncx->nx", b, np.asarray(self.mesh.vertices)[corners])
        smooth = np.einsum("nc,ncx->nx", b, self._normals[corners])
        normals[hit] = smooth / np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
        of_head = f < len(self._solid)
        found = np.empty((len(f), 3), np.float32)
        found[of_head] = self._albedo(f[of_head], b[of_head])
        body = corners[~of_head] - self._n_head_vertices
        found[~of_head] = np.einsum("nc,ncx->nx", b[~of_head], self._body_colour[body])
        colour[hit] = found
        eye, hair = np.zeros(len(f), bool), np.zeros(len(f), bool)
        eye[of_head] = np.isin(self._part[f[of_head]], ("eye_right", "eye_left"))
        hair[of_head] = self._may_have_hair[f[of_head]] & _unlike_skin(
            found[of_head], self._skin_tone
        )
        on_eye[hit], in_hair[hit] = eye, hair
        return Seen(hit, places, normals, colour, on_eye, in_hair)

    def cosine_from(self, seen: Seen, position: Floats) -> Floats:
        """Cosine of incidence of light from places (3,) or (N, 3); 0 where it does not arrive."""
        found = np.zeros(len(seen.hit))
        way = np.broadcast_to(position, seen.places.shape)[seen.hit] - seen.places[seen.hit]
        far = np.linalg.norm(way, axis=1, keepdims=True)
        cosine = (seen.normals[seen.hit] * way).sum(axis=1) / far[:, 0]
        start = seen.places[seen.hit] + _LIFT_MM * seen.normals[seen.hit]
        t, *_ = self.scene.cast(start, way / far)
        found[seen.hit] = np.where(np.isinf(t) | (t >= far[:, 0]), np.clip(cosine, 0, 1), 0)
        return found

    def _albedo(self, f: NDArray[np.int64], b: Floats) -> NDArray[np.float32]:
        """Linear colour at places (N,) of the head's triangles."""
        head = self.head
        looks, mesh = head.appearance, head.mesh
        uv = mesh.uv if looks.uv is None else looks.uv
        if uv is None or mesh.uv_triangles is None:
            mean = linear_from_srgb(np.array(looks.mean_skin()))
            return np.tile(mean.astype(np.float32), (len(f), 1))
        rows = np.asarray(mesh.uv_triangles)[self._solid[f]]
        at = np.einsum("nc,ncx->nx", b, np.asarray(uv)[rows])
        found = np.empty((len(f), 3), np.float32)
        for part in np.unique(self._part[f]):
            of_part = self._part[f] == part
            texture = self._textures[str(part)]
            height, width = texture.shape[:2]
            x = (at[of_part, 0] * width - 0.5).astype(np.float32)
            y = ((1 - at[of_part, 1]) * height - 0.5).astype(np.float32)
            for k in range(3):
                channel = np.ascontiguousarray(texture[..., k])
                found[of_part, k] = sample_bilinear(channel, x, y)
        return found


def random_tilt(rng: np.random.Generator, most_rad: float) -> Floats:
    """A small random rotation, (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(rng.uniform(-most_rad, most_rad, 3)).as_matrix())


def _spot_sized(head: Head, part: str) -> NDArray[np.float32]:
    """A part's texture, linear, at half its size: a spot of light is wider than a texel."""
    import cv2

    linear = linear_from_srgb(head.appearance.texture_of(part)[..., :3]).astype(np.float32)
    height, width = linear.shape[:2]
    size = max(width // 2, 1), max(height // 2, 1)
    return np.asarray(cv2.resize(linear, size, interpolation=cv2.INTER_AREA))


def _parts(head: Head) -> NDArray[np.str_]:
    """The part of each triangle."""
    found = np.full(len(head.mesh.triangles), "skin", dtype="U16")
    for name, rows in head.mesh.groups.items():
        found[rows] = name
    return found


def _hair_regions(head: Head) -> NDArray[np.bool_]:
    found = np.zeros(len(head.mesh.triangles), bool)
    for name, rows in head.regions.items():
        if name.startswith(("scalp", "brow", "temple", "neck", "forehead")):
            found[rows] = True
    return found


def _skin_tone(head: Head) -> NDArray[np.float32]:
    """Median linear colour about the cheeks, (3,)."""
    looks, mesh = head.appearance, head.mesh
    uv = mesh.uv if looks.uv is None else looks.uv
    rows = [head.regions[n] for n in ("cheek_l", "cheek_r") if n in head.regions]
    if uv is None or mesh.uv_triangles is None or not rows:
        return np.asarray(linear_from_srgb(np.array(looks.mean_skin())), dtype=np.float32)
    at = np.asarray(uv)[np.asarray(mesh.uv_triangles)[np.concatenate(rows)]].mean(axis=1)
    height, width = looks.skin.shape[:2]
    x = np.clip((at[:, 0] * width).astype(int), 0, width - 1)
    y = np.clip(((1 - at[:, 1]) * height).astype(int), 0, height - 1)
    return readonly(np.median(linear_from_srgb(looks.skin[y, x]), axis=0), (3,), "skin", np.float32)


def _unlike_skin(colour: NDArray[np.float32], tone: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which colours (N, 3) are hair's: less than 0.6 of the skin's light in red or far yellower."""
    ratio = np.maximum(colour, 1e-4) / np.maximum(tone, 1e-4)
    return np.asarray((ratio[:, 0] < 0.6) | (np.ptp(np.log(ratio), axis=1) > 0.7))
