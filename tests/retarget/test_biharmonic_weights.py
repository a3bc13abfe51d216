from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.mesh import SurfacePoints
from facewright.retarget.biharmonic_weights import biharmonic_weights, cotangent_laplacian
from facewright.retarget.deformer import EVERY_AXIS, FeaturePointDeformer


def plane(n: int, step_mm: float = 1.0) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A square of n x n vertices in the plane z = 0, cells cut alternately."""
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    flat = [x.ravel(), y.ravel(), np.zeros(x.size)]
    vertices = step_mm * np.stack(flat, axis=1, dtype=np.float64)
    triangles = []
    for i in range(n - 1):
        for j in range(n - 1):
            a, b, c, d = i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1
            triangles += [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
    return vertices, np.array(triangles, dtype=np.int32)


def at(triangles: NDArray[np.int32], rows: list[int]) -> SurfacePoints:
    found = [np.argwhere(triangles == row)[0] for row in rows]
    corners = np.array([triangles[t] for t, _ in found])
    weights = np.array([np.eye(3)[c] for _, c in found])
    return SurfacePoints(tuple(f"p{i}" for i in range(len(rows))), corners, weights)


def test_the_laplacian_of_a_right_angled_grid_is_the_five_point_stencil() -> None:
    vertices, triangles = plane(7, step_mm=2.0)
    laplacian, area = cotangent_laplacian(vertices, triangles)
    inner = 3 * 7 + 3
    row = laplacian[inner].toarray().ravel()
    # diagonals have a cotangent of 0, which is held at its least value
    assert row[inner] == pytest.approx(4, abs=0.1)
    np.testing.assert_allclose(row[[inner - 1, inner + 1, inner - 7, inner + 7]], -1, atol=0.03)
    np.testing.assert_allclose(laplacian @ np.ones(49), 0, atol=1e-12)
    assert area.sum() == pytest.approx(12.0**2)


def test_a_strip_bends_like_a_beam_under_tension() -> None:
    """Against the beam's equation u'''' = u''/t², clamped at its ends, in closed form."""
    n, tension = 81, 12.0
    vertices, triangles = plane(n)
    middle = [40 * n + j for j in range(n)]  # a line of points across the strip
    held = (vertices[:, 0] < 19.5) | (vertices[:, 0] > 60.5)
    points = at(triangles, middle)
    table = biharmonic_weights(
        vertices, triangles, points, np.ones(n, bool), held=held, tension_mm=tension
    )

    lifted = np.asarray(table.sum(axis=1)).reshape(n, n)

    # u(0) = 1, u'(0) = 0, u = u' = 0 where the held vertices begin
    end = 21.0
    s = np.arange(22) / tension
    L = end / tension
    basis = np.stack([np.ones_like(s), s, np.cosh(s), np.sinh(s)], axis=1)
    c = np.linalg.solve(
        np.array(
            [
                [1, 0, 1, 0],
                [0, 1, 0, 1],
                [1, L, np.cosh(L), np.sinh(L)],
                [0, 1, np.sinh(L), np.cosh(L)],
            ]
        ),
        np.array([1.0, 0, 0, 0]),
    )
    np.testing.assert_allclose(lifted[40:62, 40], basis @ c, atol=0.02)


def test_each_point_moves_by_itself_and_the_rest_smoothly() -> None:
    vertices, triangles = plane(31)
    places = [15 * 31 + 15, 5 * 31 + 5, 25 * 31 + 5, 5 * 31 + 25, 25 * 31 + 25]
    table = biharmonic_weights(vertices, triangles, at(triangles, places), np.ones(5, bool))
    dense = table.toarray()
    np.testing.assert_allclose(dense[places], np.eye(5), atol=1e-3)
    np.testing.assert_allclose(dense.sum(axis=1), 1, atol=1e-3)  # nothing holds the surface
    one = dense[:, 0].reshape(31, 31)
    np.testing.assert_allclose(one, one.T, atol=0.02)
    # smooth at the point itself: no spike, as a membrane's would be
    assert one[15, 16] > 0.97
    assert one.max() < 1.05 and one.min() > -0.2


def test_parts_without_points_and_held_vertices_stay() -> None:
    vertices, triangles = plane(9)
    both = np.concatenate([vertices, vertices + (0, 0, 5)])
    two = np.concatenate([triangles, triangles + 81])
    held = np.zeros(162, bool)
    held[:9] = True
    table = biharmonic_weights(both, two, at(triangles, [40, 44]), np.ones(2, bool), held=held)
    moved = np.asarray(np.abs(table).max(axis=1).todense()).ravel()
    assert moved[81:].max() == 0 and moved[:9].max() == 0 and moved[9:81].max() > 0.9


@pytest.mark.parametrize("still", [(), ("p1",)])
def test_the_deformer_takes_them(still: tuple[str, ...]) -> None:
    vertices, triangles = plane(25)
    points = at(triangles, [12 * 25 + 12, 12 * 25 + 20])
    d = FeaturePointDeformer(
        vertices, triangles, points, dict.fromkeys(points.names, EVERY_AXIS),
        still=still, weights="biharmonic", reach_mm=9.0,
    )  # fmt: skip
    wanted = np.array([[[0.0, 1.0, 2.0], [3.0, 0.0, 0.0]], [[1.0, 0, 0], [0, 0, 0]]])
    moved = d.displace(wanted)
    if still:
        wanted[:, 1] = 0.0
    np.testing.assert_allclose(points.at(moved), wanted, atol=1e-9)
    np.testing.assert_allclose(d.displace(wanted[0]), moved[0], atol=1e-12)
    np.testing.assert_allclose((d.matrix @ wanted[1].ravel()).reshape(-1, 3), moved[1], atol=1e-12)
    assert np.abs(moved.reshape(2, 25, 25, 3)[:, 0, 0]).max() == 0  # beyond the reach


def test_unknown_weights_are_told() -> None:
    vertices, triangles = plane(5)
    points = at(triangles, [12])
    with pytest.raises(ValueError, match="kshirsagar, biharmonic, got 'heat'"):
        FeaturePointDeformer(vertices, triangles, points, {"p0": EVERY_AXIS}, weights="heat")
