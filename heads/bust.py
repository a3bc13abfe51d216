"""Shoulders, arms and a shirt below a head, so that it does not float.

The trunk is MakeHuman's (CC0, `data/bust.npz`), fitted to the edge at which the head's neck ends.
`shirt` dresses it.
Where the head goes the neck follows, the shoulders a little, the waist not at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.arrays import readonly
from ..core.errors import InputError
from ..core.mesh import vertex_normals
from ..core.rigid import Rigid
from .head import Head
from .mesh_cut import beyond_edge, boundary_loops, without_unused
from .shirt import (
    COLLAR_FRONT_MM,
    COLLAR_MM,
    SLEEVE_MM,
    cloth_colour,
    make_shirt,
    smooth_step,
)
from .srgb import linear_from_srgb
from .subdivision import catmull_clark, triangles_of_quads

Floats = NDArray[np.float64]

_FALLOFF_MM = 150.0  # of the neck's pull on skin and shirt
_WAIST_MM = 420.0  # below the neck: what does not lean with the head
_LEAN = 0.85  # share of the head's shift that the base of the neck takes
_TUCK_MM, _TUCK_DEEP_MM = 5.0, 2.0  # the neck's skin goes on a little below the head's
_BREATH_PERIOD_S, _BREATH_MM = 3.9, 3.2


@dataclass(frozen=True, eq=False)
class Bust:
    """What is seen of a person below the head.

    Attributes
    ----------
    vertices : (V, 3) float64, mm, head frame
        At rest, the head looking straight on.
    triangles : (F, 3) int32
    colour : (V, 3) float64, linear
        Albedo of skin and shirt.
    edge : (L, V_head) sparse
        The places on the head's mesh that the bust hangs on.
    edge_rest : (L, 3) float64, mm, head frame
    pull : (V, L) sparse
        How much each vertex follows each of them.
    lean : (V,) float64
        How much it follows the shift of the head's pivot.
    breath : (V, 3) float64, mm
        From breathed out to breathed in.
    neck_pivot : (3,) float64, mm, head frame
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    colour: Floats
    edge: sparse.csr_matrix
    edge_rest: Floats
    pull: sparse.csr_matrix
    lean: Floats
    breath: Floats
    neck_pivot: Floats

    def at(
        self,
        head_vertices: Floats,
        world_from_head: Rigid,
        *,
        breath: float = 0.0,
        world_from_bust: Rigid | None = None,
    ) -> Floats:
        """The bust under a moved head.

        Parameters
        ----------
        head_vertices : (V_head, 3) float, mm, head frame
        world_from_head : Rigid
        breath : float
            0 breathed out to 1 breathed in.
        world_from_bust : Rigid, optional
            Where the person sits: `world_from_head` of the head at rest.

        Returns
        -------
        (V, 3) float64, mm, world frame
        """
        seat = Rigid.identity() if world_from_bust is None else world_from_bust
        bust_from_head = seat.inverse() @ world_from_head
        shift = bust_from_head.apply(self.neck_pivot) - self.neck_pivot
        v = self.vertices + breath * self.breath + self.lean[:, None] * shift
        edge = bust_from_head.apply(self.edge @ head_vertices)
        v += self.pull @ (edge - (self.edge_rest + _LEAN * shift))
        return seat.apply(v)


def breath_at(time_s: float, phase: float = 0.0) -> float:
    """How far someone at rest has breathed in, 0 to 1: in faster than out.

    Parameters
    ----------
    time_s : float
    phase : float
        Of the cycle, 0 to 1.
    """
    place = 2 * np.pi * (time_s / _BREATH_PERIOD_S + phase)
    return float(0.5 - 0.5 * np.cos(place + 0.35 * np.sin(place)))


def make_bust(
    head: Head,
    *,
    shirt: tuple[float, float, float] = (92, 108, 128),
    sleeves: str = "long",
    broadness: float = 0.5,
    seed: int = 0,
) -> Bust:
    """Build the bust below a head.

    Parameters
    ----------
    head : Head
        Its skin must end in an edge around the neck.
    shirt : sRGB triple 0 to 255
    sleeves : ``"long"`` (a jumper) or ``"short"`` (a T-shirt)
    broadness : float
        Of the shoulders: 0 slight to 1 broad.
    seed : int
        Of the shirt's creases.

    Raises
    ------
    InputError
        If the head's skin has no edge below the chin.
    """
    if sleeves not in ("long", "short"):
        raise ValueError(f'sleeves must be "long" or "short", not {sleeves!r}')
    loop = neck_edge(head)
    trunk = _trunk()
    body, rows, edge = _fitted(trunk, head, loop, broadness)
    edge_rest = edge @ np.asarray(head.mesh.vertices)
    below = _distance_to(edge_rest, body)
    cloth = make_shirt(
        body,
        trunk.triangles,
        trunk.neighbours,
        below_mm=below,
        arm_mm=trunk.arm_mm,
        neck=edge_rest,
        short=sleeves == "short",
        seed=seed,
    )
    skin = _skin(trunk, body, below, rows, sleeves)
    parts = [skin, cloth]
    vertices = np.concatenate([p[0] for p in parts])
    triangles = np.concatenate([skin[1], cloth[1] + len(skin[0])]).astype(np.int32)
    pull = _pull(vertices, edge_rest)
    y0 = float(edge_rest[:, 1].mean())
    colour = np.concatenate(
        [
            _skin_colour(head, edge, pull[: len(skin[0])]),
            cloth_colour(cloth[0], shirt, seed),
        ]
    )
    lean = _LEAN * smooth_step((vertices[:, 1] - (y0 - _WAIST_MM)) / _WAIST_MM)
    return Bust(
        readonly(vertices, (None, 3), "vertices"),
        readonly(triangles, (None, 3), "triangles", np.int32),
        readonly(colour, (None, 3), "colour"),
        edge,
        readonly(edge_rest, (None, 3), "edge_rest"),
        pull,
        readonly(lean, (None,), "lean"),
        readonly(_breath(vertices, triangles, y0, pull), (None, 3), "breath"),
        readonly(head.neck_pivot, (3,), "neck_pivot"),
    )


def neck_edge(head: Head) -> NDArray[np.int64]:
    """Vertices around the open end of the neck, (L,), in order.

    Raises
    ------
    InputError
        If the skin has no open edge below the eyes.
    """
    mesh = head.mesh
    loops = boundary_loops(np.asarray(mesh.triangles)[np.asarray(mesh.groups["skin"])])
    below = [r for r in loops if mesh.vertices[r, 1].max() < head.points["2.1"][1]]
    if not below:
        raise InputError(
            f"head {head.name}: its skin has no open edge below the chin, so that no bust fits it"
        )
    return min(below, key=lambda r: float(mesh.vertices[r, 1].mean()))


@dataclass(frozen=True, eq=False)
class _Trunk:
    """The stored bust after one Catmull-Clark step."""

    male: Floats
    female: Floats
    arm_mm: Floats
    triangles: NDArray[np.int32]
    neck: NDArray[np.int64]
    neighbours: sparse.csr_matrix


@cache
def _trunk() -> _Trunk:
    with (
        as_file(files(__package__).joinpath("data", "bust.npz")) as path,
        np.load(path, allow_pickle=False) as z,
    ):
        data = {name: z[name] for name in z.files}
    fine = catmull_clark(data["quads"], len(data["male"]))
    triangles = triangles_of_quads(fine.quads)
    male, female = (fine.matrix @ data[s].astype(np.float64) for s in ("male", "female"))
    neck = max(boundary_loops(triangles), key=lambda r: float(male[r, 1].mean()))
    n = len(male)
    q = fine.quads
    i, j = q.ravel(), np.roll(q, -1, axis=1).ravel()
    near = sparse.coo_matrix((np.ones(len(i)), (i, j)), (n, n)).tocsr()
    near = ((near + near.T) > 0).astype(np.float64)
    near = sparse.diags(1 / np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)) @ near
    return _Trunk(
        male, female, fine.matrix @ data["arm_mm"].astype(np.float64), triangles, neck, near.tocsr()
    )


def _fitted(
    trunk: _Trunk, head: Head, loop: NDArray[np.int64], broadness: float
) -> tuple[Floats, NDArray[np.int64], sparse.csr_matrix]:
    """The trunk under the head: vertices, its neck's rows, and where those hang on the head."""
    b = float(np.clip(broadness, 0, 1))
    v = trunk.female + (0.25 + 0.75 * b) * (trunk.male - trunk.female)
    goal = np.asarray(head.mesh.vertices)[loop]
    own = v[trunk.neck]
    # children and giants: as wide as the neck asks, within reason
    size = float(np.clip(_girth(goal) / _girth(own), 0.7, 1.15)) ** 0.7
    v = (v - own.mean(axis=0)) * size + goal.mean(axis=0)
    edge = _edge_places(v[trunk.neck], goal, loop, len(head.mesh.vertices))
    rest = edge @ np.asarray(head.mesh.vertices)
    v = v + _pull(v, v[trunk.neck]) @ (rest - v[trunk.neck])
    return v, trunk.neck, edge


def _girth(ring: Floats) -> float:
    return float(np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).sum())


def _edge_places(
    own: Floats, goal: Floats, loop: NDArray[np.int64], n_vertices: int
) -> sparse.csr_matrix:
    """For each vertex of the bust's neck, its place on the head's edge.

    The built-in heads' edge has the same vertices; of another's, the place in the same direction.
    """
    n = len(own)
    if len(goal) == n:
        # seen from above and from below the cut, the loops run against each other
        rolls = [np.roll(loop[::-1], k) for k in range(n)]
        ends = [np.roll(goal[::-1], k, axis=0) for k in range(n)]
        k = int(np.argmin([((own - end) ** 2).sum() for end in ends]))
        return sparse.csr_matrix((np.ones(n), (np.arange(n), rolls[k])), (n, n_vertices))

    def turn(p: Floats) -> Floats:
        off = p - p.mean(axis=0)
        return np.asarray(np.arctan2(off[:, 0], off[:, 2]))

    there = turn(goal)
    order = np.argsort(there)
    angle = np.concatenate(
        [there[order[-1:]] - 2 * np.pi, there[order], there[order[:1]] + 2 * np.pi]
    )
    rows = loop[np.concatenate([order[-1:], order, order[:1]])]
    at = turn(own)
    i = np.clip(np.searchsorted(angle, at) - 1, 0, len(angle) - 2)
    share = np.clip((at - angle[i]) / np.maximum(angle[i + 1] - angle[i], 1e-9), 0, 1)
    each = np.r_[np.arange(n), np.arange(n)]
    places = each, np.r_[rows[i], rows[i + 1]]
    return sparse.csr_matrix((np.r_[1 - share, share], places), (n, n_vertices))


def _distance_to(ring: Floats, points: Floats) -> Floats:
    """From points to the nearest of a ring's vertices, mm."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(ring).query(points)[0])


def _pull(points: Floats, ring: Floats) -> sparse.csr_matrix:
    """Weights of the ring's shifts at points: exact on the ring, smooth, 0 beyond the falloff."""
    d2 = ((points[:, None] - ring[None]) ** 2).sum(axis=2)
    w = 1 / (d2 + 0.3) ** 2
    w /= w.sum(axis=1, keepdims=True)
    w *= smooth_step(1 - np.sqrt(d2.min(axis=1)) / _FALLOFF_MM)[:, None]
    w[w < 1e-4] = 0
    return sparse.csr_matrix(w)


def _skin(
    trunk: _Trunk, body: Floats, below: Floats, neck: NDArray[np.int64], sleeves: str
) -> tuple[Floats, NDArray[np.int32]]:
    """Neck down to what the collar hides, and bare arms; with a ring tucked into the head."""
    near = below < COLLAR_MM + COLLAR_FRONT_MM + 22
    if sleeves == "short":
        near |= trunk.arm_mm > SLEEVE_MM - 40
    kept = trunk.triangles[near[trunk.triangles].all(axis=1)]
    ring = body[neck]
    out = vertex_normals(body, trunk.triangles)[neck]
    on = beyond_edge(ring, out)
    tucked = ring + _TUCK_MM * on - _TUCK_DEEP_MM * out
    n, m = len(body), len(neck)
    a, b = neck, np.roll(neck, -1)
    c = n + np.arange(m)
    d = np.roll(c, -1)
    # the loop runs along its triangles' sides; the strip runs back along them
    strip = np.concatenate([np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)])
    return without_unused(np.concatenate([body, tucked]), np.concatenate([kept, strip]))


def _skin_colour(head: Head, edge: sparse.csr_matrix, pull: sparse.csr_matrix) -> Floats:
    """The head's own colour at its edge, going over into its mean."""
    at_edge = edge @ vertex_albedo(head)
    ring = at_edge.copy()
    for _ in range(3):
        ring = 0.5 * ring + 0.25 * (np.roll(ring, 1, axis=0) + np.roll(ring, -1, axis=0))
    mean = np.median(ring, axis=0)
    return np.asarray(mean + pull @ (ring - mean))


def vertex_albedo(head: Head) -> Floats:
    """The skin's colour at the mesh's vertices, (V, 3) float64, linear."""
    looks, mesh = head.appearance, head.mesh
    uv = mesh.uv if looks.uv is None else looks.uv
    n = len(mesh.vertices)
    if uv is None or mesh.uv_triangles is None:
        found = linear_from_srgb(looks.skin.reshape(-1, 3)).mean(axis=0)
        return np.tile(found.astype(np.float64), (n, 1))
    at = np.full(n, 0)
    at[np.asarray(mesh.triangles).ravel()] = np.asarray(mesh.uv_triangles).ravel()
    height, width = looks.skin.shape[:2]
    x = np.clip((uv[at, 0] * width).astype(int), 0, width - 1)
    y = np.clip(((1 - uv[at, 1]) * height).astype(int), 0, height - 1)
    return np.asarray(linear_from_srgb(looks.skin[y, x]), dtype=np.float64)


def _breath(v: Floats, triangles: NDArray[np.int32], y0: float, pull: sparse.csr_matrix) -> Floats:
    """Offsets from breathed out to breathed in: the chest swells, the shoulders rise."""
    normals = vertex_normals(v, triangles)
    down = y0 - v[:, 1]
    chest = np.exp(-(((down - 150) / 110) ** 2)) * np.clip(normals[:, 2] + 0.2, 0, 1)
    narrow = np.exp(-((v[:, 0] / 170) ** 4))
    rise = smooth_step(1 - down / 380) * (1 - np.asarray(pull.sum(axis=1)).ravel())
    forward = np.zeros_like(v)
    forward[:, 2] = _BREATH_MM * chest * narrow
    forward[:, 1] = 0.7 * _BREATH_MM * rise
    return np.asarray(forward * (1 - np.asarray(pull.sum(axis=1)).ravel())[:, None])
