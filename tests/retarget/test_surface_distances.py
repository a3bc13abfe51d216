from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from facewright.core.mesh import SurfacePoints
from facewright.heads.head import Head
from facewright.retarget.surface_distances import (
    SurfaceDistances,
    mesh_edges,
    surface_distances,
)


@pytest.fixture(scope="module")
def found(head: Head) -> SurfaceDistances:
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    return surface_distances(head.mesh.vertices, skin, head.feature_points)


@pytest.fixture(scope="module")
def truth(found: SurfaceDistances) -> NDArray[np.float64]:
    """(N, V + N) by SciPy."""
    rows = found.n_vertices + np.arange(found.n_points)
    return np.asarray(csgraph.dijkstra(found.ways, indices=rows))


def test_ways_are_those_that_scipy_finds(
    found: SurfaceDistances, truth: NDArray[np.float64]
) -> None:
    np.testing.assert_allclose(found.to_vertices, truth[:, : found.n_vertices], rtol=1e-12)
    np.testing.assert_allclose(found.between, truth[:, found.n_vertices :], rtol=1e-12)
    assert np.isinf(found.to_vertices).any(), "eyes and teeth are other parts"


def test_the_nearest_is_the_first_of_the_least(
    found: SurfaceDistances, truth: NDArray[np.float64]
) -> None:
    rows = np.arange(1, found.n_points, 3)
    mm, which = found.nearest(rows)
    wanted = truth[rows][:, : found.n_vertices]
    np.testing.assert_allclose(mm, wanted.min(axis=0), rtol=1e-12)
    reached = np.isfinite(mm)
    np.testing.assert_array_equal(which[reached], wanted.argmin(axis=0)[reached])
    assert (which[~reached] == -1).all() and reached.any() and not reached.all()
    np.testing.assert_array_equal(found.nearest()[0], truth[:, : found.n_vertices].min(axis=0))


def test_around_finds_all_up_to_the_furthest_and_little_more(
    found: SurfaceDistances, truth: NDArray[np.float64]
) -> None:
    names = [i for i in range(found.n_points) if np.isfinite(truth[0, found.n_vertices + i])]
    others = np.array(names[1:4])
    vertices, mm, between = found.around(0, others)
    np.testing.assert_allclose(between, truth[0, found.n_vertices + others], rtol=1e-12)
    wanted = np.flatnonzero(truth[0, : found.n_vertices] <= between.max())
    assert set(wanted) == set(vertices.tolist())
    np.testing.assert_allclose(mm, truth[0, vertices], rtol=1e-12)
    alone, _, _ = found.around(0, np.zeros(0, np.int64))
    assert set(alone) == set(np.flatnonzero(truth[0, : found.n_vertices] < 1e-6))


@pytest.mark.parametrize("seed", range(5))
def test_equal_ways_go_to_the_first_point(seed: int) -> None:
    """Whole numbers tie everywhere."""
    rng = np.random.default_rng(seed)
    n, k = 60, 6
    place = rng.integers(0, n + k, (2, 260))
    place = place[:, place[0] != place[1]]
    lengths = rng.integers(1, 4, place.shape[1]).astype(float)
    one_way = sparse.csr_matrix((lengths, place), (n + k, n + k))
    ways = one_way.maximum(one_way.T).tocsr()
    found = SurfaceDistances(ways, n, np.zeros((0, 2), np.int32))
    wanted = np.asarray(csgraph.dijkstra(ways, indices=n + np.arange(k)))[:, :n]
    mm, which = found.nearest()
    np.testing.assert_array_equal(mm, wanted.min(axis=0))
    np.testing.assert_array_equal(which, np.where(np.isfinite(mm), wanted.argmin(axis=0), -1))
    assert (np.sort(wanted, axis=0)[0] == np.sort(wanted, axis=0)[1]).any()


def test_edges_are_told_once(head: Head) -> None:
    triangles = head.mesh.triangles
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    wanted = sorted({tuple(sorted(side)) for side in sides.tolist()})
    assert mesh_edges(triangles).tolist() == [list(edge) for edge in wanted]
    assert mesh_edges(np.zeros((0, 3), np.int32)).shape == (0, 2)


def test_points_in_one_triangle_are_joined_straight() -> None:
    vertices = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0.0]])
    bary = np.array([[0.8, 0.1, 0.1], [0.6, 0.2, 0.2]])
    points = SurfacePoints(("a", "b"), np.array([[0, 1, 2]] * 2, np.int32), bary)
    found = surface_distances(vertices, np.array([[0, 1, 2]], np.int32), points)
    a, b = bary @ vertices
    assert found.between[0, 1] == pytest.approx(np.linalg.norm(a - b))
    assert found.to_vertices[1, 0] == pytest.approx(np.linalg.norm(b))
