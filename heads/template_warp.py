"""Our template laid onto another head: similarity, then the shapes of people, then a smooth warp.

Three steps, from what is known best to what is free. A *similarity* takes a few known points to
theirs. The *model* of people, the template under MakeHuman's targets reduced to their principal
components, then moves to the surface: closest points, distances along normals, components held to
their spread (a Gaussian prior), in rounds that believe the surface more and more. What is left is
taken up by a *smooth warp* of the skin: displacements along the normals, whose second differences
over the mesh are penalised.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from ..core.mesh import SurfacePoints, vertex_normals
from .face_model import FaceModel, face_model
from .similarity import Similarity
from .skin_surface import Surface

Floats = NDArray[np.float64]

_N_FITTED = 3500
#: Rounds of the model: how far a closest point may lie, and its standard deviation, mm; and that
#: of landmarks that a network gave.
_ROUNDS = (
    *((25.0, 4.0, 3.0),) * 4, *((15.0, 2.0, 3.0),) * 4, *((8.0, 1.0, 4.0),) * 5,
    *((5.0, 0.6, 6.0),) * 4,
)  # fmt: skip
#: Surface points are not independent: this many of them count as one.
_POINTS_PER_FACT = 6.0
_LEAST_ALIKE = 0.55  # cosine between the normals of template and surface
#: Rounds of the smooth warp: stiffness, and how far a closest point may lie, mm.
_WARP_ROUNDS = ((300.0, 6.0), (60.0, 4.0), (12.0, 3.0))
_ANCHOR_WEIGHT = 400.0
_ANCHOR_SD_MM = 0.4


@dataclass(frozen=True, eq=False)
class LaidTemplate:
    """The template on another head.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
        All of the template's vertices, in the frame of the surface; those of the outer skin lie
        on it where it has any, the others follow the model.
    placed : Similarity
        From the model of people to the surface's frame: how the head is turned against ours.
    rms_mm : float
        Of the distances of the face (nose, lips, cheeks, brows) from the surface before the
        smooth warp; large for what is no human head.
    covered : float
        Share of the face that has a surface beside it.
    unusual : float
        The largest of the model's components, in standard deviations among people.
    """

    vertices: Floats
    placed: Similarity
    rms_mm: float
    covered: float
    unusual: float

    def at(self, points: SurfacePoints) -> dict[str, Floats]:
        """Points of the template, (3,) mm each, on the other head."""
        return dict(zip(points.names, points.at(self.vertices), strict=True))


def lay_template(
    surface: Surface,
    *,
    landmarks: tuple[SurfacePoints, Floats] | None = None,
    anchors: tuple[SurfacePoints, Floats] | None = None,
) -> LaidTemplate:
    """Lay the template onto a head that a similarity has already brought near.

    Parameters
    ----------
    surface : Surface
        About where the template is, in its axes and size.
    landmarks : (points of the template, (n, 3) their places mm), optional
        Roughly known: a network's.
    anchors : likewise, optional
        Well known: given by a person.
    """
    model = face_model()
    amounts, placed, facts = _fit_model(model, surface, landmarks, anchors)
    whole = placed.apply(model.whole(amounts))
    whole[model.rows] = _warped(model, surface, whole[model.rows], anchors)
    return LaidTemplate(whole, placed, *facts)


def _fit_model(
    model: FaceModel,
    surface: Surface,
    landmarks: tuple[SurfacePoints, Floats] | None,
    anchors: tuple[SurfacePoints, Floats] | None,
) -> tuple[Floats, Similarity, tuple[float, float, float]]:
    chosen = np.linspace(0, len(model.rows) - 1, min(_N_FITTED, len(model.rows))).astype(int)
    mean, basis, weight = model.mean[chosen], model.basis[:, chosen], model.weight[chosen]
    k = len(basis)
    amounts = np.zeros(k)
    placed = Similarity(1.0, np.eye(3), np.zeros(3))
    for reach_mm, sd_mm, landmark_sd_mm in _ROUNDS:
        here, moves = _placed_moves(mean, basis, amounts, placed)
        to, normals, on_border = surface.closest(here)
        off = to - here
        own = vertex_normals(_all_placed(model, amounts, placed), model.triangles)[chosen]
        length = np.linalg.norm(off, axis=1)
        good = (length < reach_mm) & ~on_border & ((own * normals).sum(axis=1) > _LEAST_ALIKE)
        r = (off * normals).sum(axis=1)[good]
        J = np.einsum("kni,ni->nk", moves[:, good], normals[good])
        w = weight[good] / (_POINTS_PER_FACT * (sd_mm**2 + r**2 / 4))  # Cauchy's weights
        A, g = (J.T * w) @ J, (J.T * w) @ r
        for pins, sd in ((landmarks, landmark_sd_mm), (anchors, _ANCHOR_SD_MM)):
            if pins is not None and len(pins[0]):
                dA, dg = _pin_terms(model, pins, amounts, placed, sd, robust=pins is landmarks)
                A, g = A + dA, g + dg
        A[:k, :k] += np.eye(k)
        g[:k] -= amounts
        A[k:, k:] += 1e-9 * np.eye(7)
        step = np.linalg.solve(A, g)
        amounts = amounts + step[:k]
        placed = _stepped(placed, step[k:], here.mean(axis=0))
    face = weight >= 1.0
    rms = float(np.sqrt((r[face[good]] ** 2).mean())) if (face & good).any() else np.inf
    covered = float((face & good).sum() / face.sum())
    return amounts, placed, (rms, covered, float(np.abs(amounts).max()))


def _all_placed(model: FaceModel, amounts: Floats, placed: Similarity) -> Floats:
    return placed.apply(model.mean + np.tensordot(amounts, model.basis, axes=1))


def _placed_moves(
    mean: Floats, basis: Floats, amounts: Floats, placed: Similarity
) -> tuple[Floats, Floats]:
    """Places (n, 3), and how they move (K + 7, n, 3): by components, turns, shifts and size.

    Turns and size are about the mean place.
    """
    here = placed.apply(mean + np.tensordot(amounts, basis, axes=1))
    arm = here - here.mean(axis=0)
    turns = [np.cross(axis, arm) for axis in np.eye(3)]
    shifts = [np.broadcast_to(axis, here.shape) for axis in np.eye(3)]
    components = placed.scale * basis @ placed.rotation.T
    return here, np.concatenate([components, np.stack([*turns, *shifts, arm])])


def _pin_terms(
    model: FaceModel,
    pins: tuple[SurfacePoints, Floats],
    amounts: Floats,
    placed: Similarity,
    sd_mm: float,
    *,
    robust: bool,
) -> tuple[Floats, Floats]:
    """Normal equations of points that should be at places."""
    local, places = _on_model(model, pins)
    mean = local.at(model.mean)
    basis = local.at(model.basis)
    _, moves = _placed_moves(mean, basis, amounts, placed)
    here = placed.apply(mean + np.tensordot(amounts, basis, axes=1))
    centre = _all_placed(model, amounts, placed).mean(axis=0)
    arm = here - centre  # turns as those of the surface's points
    k = len(amounts)
    moves = np.concatenate([moves[:k], [np.cross(a, arm) for a in np.eye(3)], moves[k + 3 : k + 6]])
    moves = np.concatenate([moves, arm[None]])
    off = places - here
    w = np.full(len(off), 1 / sd_mm**2)
    if robust:
        w = 1 / (4 * (sd_mm**2 + (off**2).sum(axis=1) / 4))  # neighbours err alike
    J = moves.reshape(len(moves), -1).T
    rows = np.repeat(w, 3)
    return (J.T * rows) @ J, (J.T * rows) @ off.ravel()


def _on_model(model: FaceModel, pins: tuple[SurfacePoints, Floats]) -> tuple[SurfacePoints, Floats]:
    """Points of the template as points of the model; those elsewhere (eyes, teeth) are left out."""
    row = np.full(int(model.rows.max()) + 1, -1)
    row[model.rows] = np.arange(len(model.rows))
    corners = pins[0].corners
    inside = np.asarray((corners < len(row)).all(axis=1))
    local = np.where(inside[:, None], row[np.minimum(corners, len(row) - 1)], -1)
    known = inside & np.asarray((local >= 0).all(axis=1))
    names = tuple(n for n, keep in zip(pins[0].names, known, strict=True) if keep)
    return SurfacePoints(names, local[known], pins[0].barycentric[known]), pins[1][known]


def _stepped(placed: Similarity, step: Floats, centre: Floats) -> Similarity:
    """A similarity after a small turn (3), shift (3) and relative change of size about a point."""
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    size = float(np.exp(step[6]))
    return Similarity(
        placed.scale * size,
        turn @ placed.rotation,
        size * turn @ (placed.translation - centre) + centre + step[3:6],
    )


def _warped(
    model: FaceModel,
    surface: Surface,
    start: Floats,
    anchors: tuple[SurfacePoints, Floats] | None,
) -> Floats:
    """The model's vertices taken onto the surface by a smooth warp."""
    here, n = start.copy(), len(start)
    stiff = _second_differences(model.triangles, n)
    pins = None if anchors is None else _on_model(model, anchors)
    for stiffness, reach_mm in _WARP_ROUNDS:
        to, normals, on_border = surface.closest(here)
        own = vertex_normals(here, model.triangles)
        off = to - here
        good = np.linalg.norm(off, axis=1) < reach_mm
        good &= ~on_border & ((own * normals).sum(axis=1) > _LEAST_ALIKE)
        wanted = (off * normals).sum(axis=1, keepdims=True) * normals
        w = np.where(good, 1.0, 0.0)
        A = sparse.diags(w + 1e-6) + stiffness * stiff
        b = w[:, None] * wanted
        if pins is not None and len(pins[0]):
            P = _rows_of(pins[0], n)
            A = A + _ANCHOR_WEIGHT * P.T @ P
            b = b + _ANCHOR_WEIGHT * P.T @ (pins[1] - P @ here)
        here = here + splu(A.tocsc()).solve(b)
    return here


def _second_differences(triangles: NDArray[np.int32], n: int) -> sparse.csr_matrix:
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    links = sparse.csr_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (n, n))
    links = (links + links.T).astype(bool).astype(np.float64)
    degree = np.asarray(links.sum(axis=1)).ravel()
    L = sparse.identity(n) - sparse.diags(1 / np.maximum(degree, 1)) @ links
    return (L.T @ L).tocsr()


def _rows_of(points: SurfacePoints, n: int) -> sparse.csr_matrix:
    place = np.repeat(np.arange(len(points)), 3), points.corners.ravel()
    return sparse.csr_matrix((points.barycentric.ravel(), place), (len(points), n))


def known_points(named: Mapping[str, Floats], known: SurfacePoints) -> tuple[SurfacePoints, Floats]:
    """Those of some named places that are points of the template, and the places (n, 3)."""
    names = tuple(n for n in known.names if n in named)
    return known.select(names), np.array([named[n] for n in names]).reshape(-1, 3)
