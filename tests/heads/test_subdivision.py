"""Catmull-Clark subdivision: known values and laws."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.heads.subdivision import catmull_clark, triangles_of_quads

Floats = NDArray[np.float64]
CUBE = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
CUBE_QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]],
    dtype=np.int32,
)


def grid(n: int) -> tuple[Floats, NDArray[np.int32]]:
    """A sheet of (n − 1)² quads with a border."""
    x, y = np.meshgrid(np.arange(float(n)), np.arange(float(n)))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
    at = np.arange(n * n).reshape(n, n)
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], axis=-1)
    return points, quads.reshape(-1, 4).astype(np.int32)


def test_a_cube_becomes_what_the_paper_says() -> None:
    """Catmull & Clark 1978: face points at 1, edge points at 3/4, corners at 5/9."""
    fine = catmull_clark(CUBE_QUADS, 8)

    p = fine.matrix @ CUBE

    np.testing.assert_allclose(p[:8], CUBE * 5 / 9, atol=1e-12)
    edges = p[8:20]
    np.testing.assert_allclose(np.sort(np.abs(edges), axis=1), [[0, 0.75, 0.75]] * 12, atol=1e-12)
    assert len(np.unique(np.rint(4 * edges), axis=0)) == 12
    faces = p[20:]
    np.testing.assert_allclose(np.sort(np.abs(faces), axis=1), [[0, 0, 1]] * 6, atol=1e-12)
    assert fine.quads.shape == (24, 4)


def test_a_closed_cube_stays_closed_and_oriented() -> None:
    quads = catmull_clark(CUBE_QUADS, 8).quads

    sides = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)

    assert len(np.unique(sides, axis=0)) == len(sides)  # each directed side once
    both = {tuple(s) for s in sides.tolist()}
    assert all((b, a) in both for a, b in both)


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("mesh", ["cube", "grid"])
def test_rows_sum_to_one_so_that_affine_maps_commute(mesh: str, smooth: bool) -> None:
    points, quads = (CUBE, CUBE_QUADS) if mesh == "cube" else grid(5)
    fine = catmull_clark(quads, len(points), smooth=smooth)
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(3, 3)), rng.normal(size=3)
    bent = points + rng.normal(0, 0.2, size=points.shape)

    np.testing.assert_allclose(np.asarray(fine.matrix.sum(axis=1)).ravel(), 1, atol=1e-12)
    np.testing.assert_allclose(
        fine.matrix @ (bent @ A.T + b), (fine.matrix @ bent) @ A.T + b, atol=1e-12
    )


def test_borders_follow_the_cubic_spline_and_the_inside_of_a_flat_sheet_stays() -> None:
    points, quads = grid(5)
    fine = catmull_clark(quads, 25)
    rng = np.random.default_rng(1)
    height = rng.normal(size=25)

    new = fine.matrix @ height

    def old(x: int, y: int) -> int:
        return 5 * y + x

    expected = (height[old(1, 0)] + 6 * height[old(2, 0)] + height[old(3, 0)]) / 8
    assert new[old(2, 0)] == pytest.approx(expected, abs=1e-12)
    flat = fine.matrix @ points
    inner = [old(x, y) for x in (1, 2, 3) for y in (1, 2, 3)]
    np.testing.assert_allclose(flat[inner], points[inner], atol=1e-12)
    # regular inner vertex: the bicubic B-spline mask, 36 6 1 over 64
    around = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    mask = {0: 36, 1: 6, 2: 1}
    expected = sum(mask[abs(dx) + abs(dy)] * height[old(2 + dx, 2 + dy)] for dx, dy in around) / 64
    assert new[old(2, 2)] == pytest.approx(expected, abs=1e-12)


def test_splitting_without_smoothing_keeps_the_old_points() -> None:
    points, quads = grid(4)
    fine = catmull_clark(quads, 16, smooth=False)

    p = fine.matrix @ points

    np.testing.assert_array_equal(p[:16], points)
    corners = p[fine.quads]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    np.testing.assert_allclose(sides, 0.5, atol=1e-12)


def test_quads_tell_whose_corner_they_are() -> None:
    fine = catmull_clark(CUBE_QUADS, 8)

    for q, quad in enumerate(CUBE_QUADS):
        assert fine.quads[4 * q : 4 * q + 4, 0].tolist() == quad.tolist()


def test_two_triangles_cover_a_quad_in_its_direction() -> None:
    triangles = triangles_of_quads(np.array([[0, 1, 2, 3], [4, 5, 6, 7]], dtype=np.int32))

    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    p = CUBE[CUBE_QUADS]
    outward = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert ((outward * p.mean(axis=1)).sum(axis=1) > 0).all() or (
        (outward * p.mean(axis=1)).sum(axis=1) < 0
    ).all()
