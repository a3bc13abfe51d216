"""A simple skull and mandible inside a head, from its skin and the thickness of soft tissue.

After Kähler, Haber & Seidel 2001, section 3.1: regions of the skin that cover no bone near by are
cut away, what is left is simplified and moved inwards by the thickness of the tissue. Here the
simplification is a resampling along rays from inside, so that both bones come out closed.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from ..core.arrays import readonly
from ..core.errors import InputError
from ..core.mesh import Mesh
from .head import Head
from .raycast import NO_HIT, RayScene
from .subdivision import icosphere

Floats = NDArray[np.float64]

#: Half of the distance between the condyles' centres, of an adult whose mandible measures
#: `MANDIBLE_MM` from the hinge to the edges of the lower incisors.
CONDYLE_HALF_DISTANCE_MM, MANDIBLE_MM = 50.0, 85.0
#: Skin that is no image of the bone below.
_NO_BONE = ("inner_mouth", "socket_l", "socket_r", "ear_l", "ear_r")
_BRIDGED = ("nose",)
_FAR_MM = 400.0
_SPHERE_STEPS = 4  # of subdivision of an icosahedron: 2562 directions
_SLANT = 0.5  # least cosine between ray and skin normal when a thickness is laid along the ray
_ORBIT_MM = 3.5  # between eyeball and bone
_ORBIT_RADII = np.array([21.5, 18.5])  # of the opening, across and up
_LEAST_TISSUE_MM = 2.0
_BLUR_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class Bones:
    """Skull and mandible of a head at rest, head frame.

    Attributes
    ----------
    skull, mandible : Mesh
        Closed, mm. Groups ``bone`` and, where the head has them, ``teeth``.
    hinge : (2, 3) float64, mm
        Centres of the right and the left condyle; the head's jaw pivot is their middle.
    """

    skull: Mesh
    mandible: Mesh
    hinge: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "hinge", readonly(self.hinge, (2, 3), "hinge"))


def make_bones(head: Head) -> Bones:
    """Make a head's skull and mandible (about 0.3 s).

    Parameters
    ----------
    head : Head
        With landmarks, regions, both eyes and upper and lower teeth, as built-in heads have them.

    Raises
    ------
    InputError
        If the head lacks one of these.

    References
    ----------
    Kähler, Haber, Seidel 2001, section 3.1.
    """
    _check(head)
    skin = _Skin(head)
    half = CONDYLE_HALF_DISTANCE_MM * skin.size
    hinge = head.jaw_pivot + np.array([[-half, 0, 0], [half, 0, 0]])
    return Bones(
        skull=_with_teeth(head, *_skull(head, skin), "teeth_upper"),
        mandible=_with_teeth(head, *_mandible(head, skin), "teeth_lower"),
        hinge=hinge,
    )


def _check(head: Head) -> None:
    wanted = [f"a region {name}" for name in (*_NO_BONE, *_BRIDGED) if name not in head.regions]
    for part in ("teeth_upper", "teeth_lower", "eye_right", "eye_left"):
        if part not in head.mesh.groups:
            wanted.append(f"a part {part}")
    if head.mesh.landmarks is None:
        wanted.append("landmarks")
    if wanted:
        raise InputError(
            f"head {head.name} has no {wanted[0].removeprefix('a ')}: bones are made for heads "
            "with the built-in topology, before they are decimated"
        )


class _Skin:
    """Where the skin that covers bone lies, and how thick the tissue below it is."""

    def __init__(self, head: Head) -> None:
        mesh = head.mesh
        keep = np.ones(len(mesh.triangles), dtype=bool)
        for name in _NO_BONE:
            keep[head.regions[name]] = False
        rows = mesh.groups["skin"][keep[mesh.groups["skin"]]]
        self._triangles = mesh.triangles[rows]
        self._bridged = np.isin(rows, np.concatenate([head.regions[n] for n in _BRIDGED]))
        self._scene = RayScene(mesh.vertices, self._triangles)
        corners = mesh.vertices[self._triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        self.places = _places(head)
        self.size = float(np.linalg.norm((self.places["9.11"] - head.jaw_pivot)[1:])) / MANDIBLE_MM
        self._at, self._thickness = _thickness_points(self.places)

    def thickness(self, at: Floats) -> Floats:
        """Of the tissue below skin at (N, 3), (N,) mm: between the table's landmarks."""
        d = np.linalg.norm(at[:, None] - self._at[None], axis=2) + 1.0
        weight = d**-3.0  # Shepard's interpolation
        return np.asarray((weight @ self._thickness) / weight.sum(axis=1))

    def below(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Along rays outwards from inside: where the skin is and where the bone below may be.

        Returns
        -------
        two (N,) float64, mm from the origins
            NaN where no skin that images bone is met.
        """
        start = origins + _FAR_MM * directions
        t, triangle, _ = self._scene.cast(start, -directions)
        hit = triangle != NO_HIT
        found = np.where(hit, _FAR_MM - t.astype(np.float64), np.nan)
        hit &= found > 0
        row = np.where(hit, triangle, 0).astype(np.int64)
        slant = np.maximum((self._normal[row] * directions).sum(axis=1), _SLANT)
        tissue = self.thickness(origins + np.nan_to_num(found)[:, None] * directions) / slant
        skin = np.where(hit, found, np.nan)
        return skin, np.where(self._bridged[row], np.nan, skin - tissue)


def _places(head: Head) -> dict[str, Floats]:
    """Feature points and landmarks by name; they share no names."""
    assert head.mesh.landmarks is not None
    at = head.mesh.landmarks.at(head.mesh.vertices)
    return {**head.points, **dict(zip(head.mesh.landmarks.names, at, strict=True))}


@cache
def _thickness_table() -> tuple[tuple[str, float], ...]:
    """(names of points whose middle it is, mean mm) of each landmark and side."""
    text = files(__package__).joinpath("data", "tissue_thickness.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(text.splitlines())
    return tuple(
        (row[side], float(row["mean_mm"]))
        for row in rows
        for side in ("left", "right")
        if row[side]
    )


def _thickness_points(places: dict[str, Floats]) -> tuple[Floats, Floats]:
    table = _thickness_table()
    at = [np.mean([places[n] for n in names.split()], axis=0) for names, _ in table]
    return np.array(at), np.array([mm for _, mm in table])


@cache
def _averaging() -> sparse.csr_matrix:
    """Means over neighbours on the sphere."""
    points, t = icosphere(_SPHERE_STEPS)
    n = len(points)
    links = sparse.csr_matrix((np.ones(len(t)), (t[:, 0], t[:, 1])), (n, n))
    links = links + sparse.csr_matrix((np.ones(len(t)), (t[:, 1], t[:, 2])), (n, n))
    links = links + sparse.csr_matrix((np.ones(len(t)), (t[:, 2], t[:, 0])), (n, n))
    links = ((links + links.T) > 0).astype(np.float64)
    return (sparse.diags(1 / np.asarray(links.sum(axis=1)).ravel()) @ links).tocsr()


def _bridged(values: Floats) -> Floats:
    """Fill NaN harmonically from what is known around."""
    missing = np.flatnonzero(np.isnan(values))
    if not len(missing):
        return values
    mean = _averaging()
    known = np.flatnonzero(~np.isnan(values))
    system = sparse.identity(len(missing)) - mean[missing][:, missing]
    found = values.copy()
    found[missing] = spsolve(system.tocsc(), mean[missing][:, known] @ values[known])
    return found


def _skull(head: Head, skin: _Skin) -> tuple[Floats, NDArray[np.int32]]:
    """Cranium and upper jaw, seen from a point inside: nose and ears bridged, orbits hollow."""
    directions, triangles = icosphere(_SPHERE_STEPS)
    s = skin.size
    ears = (skin.places["po_l"] + skin.places["po_r"]) / 2
    centre = np.array([0.0, ears[1] + 22 * s, ears[2] + 36 * s])
    surface, bone = skin.below(np.broadcast_to(centre, directions.shape), directions)
    r = _bridged(bone)
    seen = centre + _bridged(surface)[:, None] * directions
    for eye in head.eyes.values():
        off = (seen - eye.centre)[:, :2] / (_ORBIT_RADII * s)
        hollow = _sphere_distance(centre - eye.centre, directions, eye.radius + _ORBIT_MM)
        in_front = (np.linalg.norm(off, axis=1) < 1) & (seen[:, 2] > eye.centre[2] - eye.radius)
        r = np.where(in_front, np.minimum(r, hollow), r)
    r = np.minimum(r, _base_distance(head, skin, centre, directions, r))
    for _ in range(_BLUR_ROUNDS):
        r = 0.5 * r + 0.5 * (_averaging() @ r)
    limit = surface - _LEAST_TISSUE_MM
    r = np.where(np.isnan(limit), r, np.minimum(r, limit))
    return centre + r[:, None] * directions, triangles


def _sphere_distance(origin: Floats, directions: Floats, radius: float) -> Floats:
    """Where rays from a point outside first meet a sphere about 0; inf where they miss."""
    b = directions @ origin
    disc = b**2 - (origin @ origin - radius**2)
    return np.where((disc > 0) & (b < 0), -b - np.sqrt(np.maximum(disc, 0)), np.inf)


def _base_distance(
    head: Head, skin: _Skin, centre: Floats, directions: Floats, r: Floats
) -> Floats:
    """Where rays first come below the skull's base: palate in front, joint, nape behind."""
    s, joint = skin.size, head.jaw_pivot
    gum = skin.places["9.10"][1] + 9 * s
    joint_y = joint[1] + 9 * s
    depths = np.array([joint[2] - 40 * s, joint[2] - 15 * s, joint[2] + 14 * s, joint[2] + 20 * s])
    heights = np.array([skin.places["po_l"][1] - 15 * s, joint_y, joint_y, gum])
    zygoma = (skin.places["zy_l"][1] + skin.places["zy_r"][1]) / 2 - 7 * s
    steps = np.linspace(0, 1, 121)
    p = centre + (steps[:, None] * r)[..., None] * directions
    low = np.interp(p[..., 2], depths, heights)
    wide = np.clip((np.abs(p[..., 0]) - 30 * s) / (4 * s), 0, 1)
    in_front = p[..., 2] > depths[2]
    low = np.where(in_front, np.maximum(low, zygoma * wide + (1 - wide) * low), low)
    below = p[..., 1] < low
    first = np.where(below.any(axis=0), below.argmax(axis=0), len(steps) - 1)
    return np.asarray(steps[first] * r)


_JAW_COLUMNS, _JAW_ROWS = 81, 13


def _mandible(head: Head, skin: _Skin) -> tuple[Floats, NDArray[np.int32]]:
    """A closed band about an upright axis: body, angles, rami and condyles.

    Columns run from the right condyle round the chin to the left one, rows upwards; the outer
    wall lies below the skin, the inner one a bone's thickness behind.
    """
    s, hinge = skin.size, head.jaw_pivot
    x_condyle = CONDYLE_HALF_DISTANCE_MM * s
    axis_z = hinge[2] + 40 * s
    back = float(np.arctan2(x_condyle, hinge[2] - 4 * s - axis_z))
    phi = np.linspace(-back, back, _JAW_COLUMNS)
    low, high = _jaw_borders(skin, hinge, axis_z, back, np.abs(phi))
    t = np.linspace(0, 1, _JAW_ROWS)
    y = low + t[:, None] * (high - low)
    d = np.stack([np.sin(phi), np.zeros_like(phi), np.cos(phi)], axis=1)
    directions = np.broadcast_to(d, (*y.shape, 3)).reshape(-1, 3)
    origins = np.stack([np.zeros(y.size), y.ravel(), np.full(y.size, axis_z)], axis=1)
    surface, bone = skin.below(origins, directions)
    outer = bone.reshape(y.shape)
    # beside the joint the skin is the ear's: the condyle's own place holds there
    side = (x_condyle + 5 * s) / np.maximum(np.abs(np.sin(phi)), 0.3)
    near = np.clip((np.abs(phi) / back - 0.68) / 0.3, 0, 1)
    near = near**2 * (3 - 2 * near)
    outer = np.where(np.isnan(outer), side, outer)
    outer = _blurred_rows(outer + near * (side - outer))
    outer = np.minimum(outer, _under_ears(surface.reshape(y.shape), phi) - _LEAST_TISSUE_MM)
    ramus = np.clip((np.abs(phi) - 0.45 * back) / (0.25 * back), 0, 1)
    inner = outer - s * (11 - 3 * ramus)
    walls = [
        np.stack([r * np.sin(phi), y, axis_z + r * np.cos(phi)], axis=2) for r in (outer, inner)
    ]
    return _closed_band(*walls)


def _jaw_borders(
    skin: _Skin, hinge: Floats, axis_z: float, back: float, phi: Floats
) -> tuple[Floats, Floats]:
    """Heights of the lower and the upper border of the mandible at angles from the front."""
    s = skin.size
    gonion = (skin.places["go_l"] + skin.places["go_r"] * (-1, 1, 1)) / 2
    at_gonion = float(np.arctan2(gonion[0], gonion[2] - axis_z))
    at_gonion = float(np.clip(at_gonion, 0.55 * back, 0.85 * back))
    chin = skin.places["gn"][1] + 8 * s
    gum = skin.places["9.11"][1] - 10 * s
    low = np.interp(
        phi,
        [0, 0.3 * back, at_gonion, 0.5 * (at_gonion + back), back],
        [chin, chin + 2 * s, gonion[1] + 4 * s, gonion[1] + 16 * s, hinge[1] - 12 * s],
    )
    high = np.interp(
        phi,
        [0, 0.52 * back, 0.64 * back, 0.72 * back, 0.84 * back, 0.93 * back, back],
        [
            gum,
            gum + 2 * s,
            hinge[1],
            hinge[1] + 2 * s,
            hinge[1] - 9 * s,
            hinge[1],
            hinge[1] + 5 * s,
        ],
    )
    return low, np.maximum(high, low + 6 * s)


def _under_ears(surface: Floats, phi: Floats) -> Floats:
    """Distances of the skin, (rows, columns), with gaps bridged along the rows."""
    found = surface.copy()
    for row in found:
        missing = np.isnan(row)
        row[missing] = np.interp(phi[missing], phi[~missing], row[~missing])
    return found


def _blurred_rows(r: Floats) -> Floats:
    """Smooth distances over the band, borders kept."""
    for _ in range(3):
        padded = np.pad(r, 1, mode="edge")
        around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        r = np.minimum(r, 0.5 * r + 0.125 * around)
    return r


def _closed_band(outer: Floats, inner: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """A closed surface from two walls of (rows, columns, 3) points."""
    n_rows, n_columns = outer.shape[:2]
    index = np.arange(n_rows * n_columns).reshape(n_rows, n_columns)
    far = index + index.size

    def quads(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
        q = np.stack([a[:-1], a[1:], b[1:], b[:-1]], axis=-1)
        return q.reshape(-1, 4)

    sides = [quads(index[:, i], index[:, i + 1]) for i in range(n_columns - 1)]
    sides += [quads(far[:, i + 1], far[:, i]) for i in range(n_columns - 1)]
    sides += [quads(index[-1], far[-1])[:, ::-1], quads(far[0], index[0])[:, ::-1]]
    sides += [quads(far[:, 0], index[:, 0]), quads(index[:, -1], far[:, -1])]
    q = np.concatenate(sides)
    triangles = np.concatenate([q[:, [0, 2, 1]], q[:, [0, 3, 2]]])
    return np.concatenate([outer.reshape(-1, 3), inner.reshape(-1, 3)]), triangles.astype(np.int32)


def _with_teeth(head: Head, vertices: Floats, triangles: NDArray[np.int32], part: str) -> Mesh:
    used, rows = np.unique(head.mesh.triangles[head.mesh.groups[part]], return_inverse=True)
    teeth = rows.reshape(-1, 3).astype(np.int32) + len(vertices)
    n = len(triangles)
    return Mesh(
        np.concatenate([vertices, head.mesh.vertices[used]]),
        np.concatenate([triangles, teeth]),
        groups={
            "bone": np.arange(n, dtype=np.int32),
            "teeth": np.arange(n, n + len(teeth), dtype=np.int32),
        },
    )
