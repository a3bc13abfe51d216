from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import InputError
from facewright.core.mesh import SurfacePoints
from facewright.heads.head import Head
from facewright.retarget.deformer import EVERY_AXIS, FeaturePointDeformer

OPTIONS: list[dict[str, Any]] = [{}, {"fade": True}, {"fade": True, "smoothing": 0.5}]


def grid(n: int, *, mirrored: bool = False) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """n x n vertices 1 mm apart; cells are cut from lower left to upper right, with `mirrored`
    the other way round left of the middle."""
    x, y = np.meshgrid(np.arange(n) - (n - 1) / 2 * mirrored, np.arange(n), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(float)
    triangles = []
    for i in range(n - 1):
        for j in range(n - 1):
            a, b, c, d = i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1
            if mirrored and i < (n - 1) / 2:
                triangles += [(a, b, d), (b, c, d)]
            else:
                triangles += [(a, b, c), (a, c, d)]
    return vertices, np.array(triangles, dtype=np.int32)


def at_vertices(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    places: dict[str, tuple[float, float]],
) -> SurfacePoints:
    corners, weights = [], []
    for place in places.values():
        vertex = int(np.argmin(np.linalg.norm(vertices[:, :2] - place, axis=1)))
        row, corner = np.argwhere(triangles == vertex)[0]
        corners.append(triangles[row])
        weights.append(np.eye(3)[corner])
    return SurfacePoints(tuple(places), np.array(corners), np.array(weights))


def three_points() -> tuple[NDArray[np.float64], NDArray[np.int32], SurfacePoints]:
    vertices, triangles = grid(5)
    places = {"one": (0.0, 0.0), "two": (4.0, 0.0), "three": (0.0, 4.0)}
    return vertices, triangles, at_vertices(vertices, triangles, places)


def test_weights_are_those_computed_by_hand_from_equations_2_to_5() -> None:
    vertices, triangles, points = three_points()
    d = FeaturePointDeformer(vertices, triangles, points, dict.fromkeys(points.names, EVERY_AXIS))
    p = 1 * 5 + 1  # the vertex (1, 1)

    # ways along edges; cells have no edge from lower right to upper left
    d1, d2, d3 = np.sqrt(2), 4.0, 4.0
    d12, d13, d23 = 4.0, 4.0, 8.0
    reach_1 = (d12 * np.sqrt(0.5) + d13 * np.sqrt(0.5)) / (2 * np.sqrt(0.5))
    cos_1, cos_3 = 3 / np.sqrt(10), (3 * 4 + 1 * 4) / (np.sqrt(10) * np.sqrt(32))
    reach_2 = (d12 * cos_1 + d23 * cos_3) / (cos_1 + cos_3)
    w = [np.sin(np.pi / 2 * (1 - a / b)) for a, b in ((d1, reach_1), (d2, reach_2), (d3, reach_2))]
    by_hand = np.array(w) / np.array([d1, d2, d3]) ** 2
    by_hand /= by_hand.sum()

    found = [d.displace(np.eye(3)[i][:, None] * np.ones(3))[p] for i in range(3)]

    np.testing.assert_allclose(found, np.outer(by_hand, np.ones(3)), atol=1e-12)


def test_a_single_neighbour_reaches_to_its_distance_over_the_cosine() -> None:
    vertices, triangles = grid(9)
    points = at_vertices(vertices, triangles, {"one": (0.0, 0.0), "two": (4.0, 0.0)})
    d = FeaturePointDeformer(vertices, triangles, points, dict.fromkeys(points.names, EVERY_AXIS))
    moved = d.displace(np.array([[0, 0, 1.0], [0, 0, 0]]))[:, 2].reshape(9, 9)

    # above "one", at (1, j): cos = 1/sqrt(1+j²), way = sqrt(2) + (j - 1), reach = 4 sqrt(1+j²);
    # "two" reaches it too while its own way 3 + j is below 4 sqrt(9 + j²)/3
    for j in (1, 2, 5):
        w1 = np.sin(np.pi / 2 * (1 - (np.sqrt(2) + j - 1) / (4 * np.sqrt(1 + j * j))))
        way_2, reach_2 = 3.0 + j, 4 * np.sqrt(9 + j * j) / 3
        w2 = np.sin(np.pi / 2 * (1 - way_2 / reach_2)) if way_2 < reach_2 else 0.0
        a, b = w1 / (np.sqrt(2) + j - 1) ** 2, w2 / way_2**2
        assert moved[1, j] == pytest.approx(a / (a + b), abs=1e-12)
    # behind "two", seen from "one" beyond a right angle nowhere: but "two" has none ahead there
    assert moved[8, 0] == 0


@pytest.mark.parametrize("options", OPTIONS)
def test_points_move_by_their_own_displacements(head: Head, options: dict[str, Any]) -> None:
    points, triangles = skin_points(head)
    d = FeaturePointDeformer(
        head.mesh.vertices, triangles, points, dict.fromkeys(points.names, EVERY_AXIS), **options
    )
    wanted = np.random.default_rng(3).normal(size=(4, len(points), 3))

    moved = d.displace(wanted)

    np.testing.assert_allclose(points.at(moved), wanted, atol=1e-9)
    assert np.abs(d.displace(np.zeros((len(points), 3)))).max() == 0
    np.testing.assert_allclose(
        d.displace(2 * wanted[0] - 3 * wanted[1]), 2 * moved[0] - 3 * moved[1]
    )
    np.testing.assert_array_equal(d.displace(wanted[2]), moved[2])


def skin_points(head: Head) -> tuple[SurfacePoints, NDArray[np.int32]]:
    skin = set(head.part_vertices("skin").tolist())
    fps = head.feature_points
    names = tuple(n for n, c in zip(fps.names, fps.corners, strict=True) if int(c[0]) in skin)
    return fps.select(names), head.mesh.triangles[head.mesh.groups["skin"]]


def test_moving_all_points_alike_moves_whatever_they_reach_alike() -> None:
    vertices, triangles, points = three_points()
    d = FeaturePointDeformer(vertices, triangles, points, dict.fromkeys(points.names, EVERY_AXIS))

    moved = d.displace(np.tile([1.0, -2.0, 3.0], (3, 1)))

    reached = np.abs(moved).max(axis=1) > 0
    assert reached.sum() > 12
    np.testing.assert_allclose(moved[reached], [[1.0, -2.0, 3.0]] * int(reached.sum()))


def test_fading_leaves_no_step_at_the_edge_of_influence() -> None:
    vertices, triangles = grid(41)
    places = {"a": (20.0, 20.0), "b": (28.0, 20.0), "c": (12.0, 20.0), "d": (20.0, 28.0)}
    points = at_vertices(vertices, triangles, {**places, "e": (20.0, 12.0)})
    constraints = dict.fromkeys(points.names, EVERY_AXIS)
    steps = {}
    for fade in (False, True):
        d = FeaturePointDeformer(vertices, triangles, points, constraints, fade=fade)
        lift = np.zeros((5, 3))
        lift[:, 2] = 1.0
        z = d.displace(lift)[:, 2].reshape(41, 41)
        # along a line through the points, out to where nothing reaches
        steps[fade] = np.abs(np.diff(z[20:, 20])).max()

    assert steps[False] == pytest.approx(1.0), "eq. 5 as printed lets go all at once"
    assert steps[True] < 0.45


@pytest.mark.parametrize("options", OPTIONS)
def test_mirrored_points_move_a_symmetric_mesh_symmetrically(options: dict[str, Any]) -> None:
    vertices, triangles = grid(21, mirrored=True)
    places = {"l": (5.0, 10.0), "r": (-5.0, 10.0), "t": (0.0, 17.0), "b": (0.0, 3.0)}
    points = at_vertices(vertices, triangles, places)
    d = FeaturePointDeformer(
        vertices, triangles, points, dict.fromkeys(points.names, EVERY_AXIS), **options
    )
    moves = np.array([[1.0, 2, 3], [-1.0, 2, 3], [0, 1.0, -1], [0, -0.5, 2]])

    moved = d.displace(moves).reshape(21, 21, 3)

    np.testing.assert_allclose(moved[::-1] * (-1, 1, 1), moved, atol=1e-9)
    assert np.abs(moved).max() > 1


def test_an_axis_without_constraint_follows_the_neighbours() -> None:
    vertices, triangles, points = three_points()
    free_in_z = {"one": (True, True, False), "two": EVERY_AXIS, "three": EVERY_AXIS}
    d = FeaturePointDeformer(vertices, triangles, points, free_in_z)

    moved = d.displace(np.array([[5.0, 5, 5], [0, 0, 2], [0, 0, 2]]))

    at_one = moved[0]
    np.testing.assert_allclose(at_one, [5, 5, 2])  # z comes from the two others, alike


def test_the_other_lip_and_other_parts_stay(head: Head) -> None:
    points, triangles = skin_points(head)
    d = FeaturePointDeformer(
        head.mesh.vertices, triangles, points, dict.fromkeys(points.names, EVERY_AXIS)
    )
    up = np.zeros((len(points), 3))
    for name in ("2.2", "2.6", "2.7", "8.1"):
        up[points.index(name), 1] = 5.0

    moved = d.displace(up)

    lower = head.feature_points.select(("2.3", "2.8", "2.9", "8.2"))
    assert np.abs(moved[lower.corners]).max() < 0.05
    upper = head.feature_points.select(("2.2", "2.6", "2.7", "8.1"))
    np.testing.assert_allclose(upper.at(moved)[:, 1], 5.0)
    for part in ("eye_left", "teeth_lower", "tongue", "lashes"):
        assert np.abs(moved[head.part_vertices(part)]).max() == 0


def test_a_part_without_points_stays() -> None:
    vertices, triangles, points = three_points()
    far = vertices + (0, 0, 1.0)
    d = FeaturePointDeformer(
        np.concatenate([vertices, far]),
        np.concatenate([triangles, triangles + len(vertices)]),
        points,
        dict.fromkeys(points.names, EVERY_AXIS),
    )
    moved = d.displace(np.ones((3, 3)))
    assert np.abs(moved[: len(vertices)]).max() == pytest.approx(1)
    assert np.abs(moved[len(vertices) :]).max() == 0


def test_a_head_is_ready_within_three_seconds(head: Head) -> None:
    points, triangles = skin_points(head)
    constraints = dict.fromkeys(points.names, EVERY_AXIS)
    start = time.process_time()
    FeaturePointDeformer(head.mesh.vertices, triangles, points, constraints)
    assert time.process_time() - start < 3.0


def quartered(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The surface with four triangles for each."""
    a, b, c = triangles.T
    sides = np.sort(np.stack([[a, b], [b, c], [c, a]]).transpose(0, 2, 1).reshape(-1, 2), axis=1)
    edges, which = np.unique(sides, axis=0, return_inverse=True)
    ab, bc, ca = len(vertices) + which.reshape(3, -1)
    four = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    middles = vertices[edges].mean(axis=1)
    return np.concatenate([vertices, middles]), np.concatenate(four).astype(np.int32)


def test_a_head_of_seventy_thousand_vertices_takes_seconds(head: Head) -> None:
    """Its factors once filled up, and took minutes."""
    points, skin = skin_points(head)
    vertices, triangles = quartered(head.mesh.vertices, skin)
    nearest = points.corners[np.arange(len(points)), points.barycentric.argmax(axis=1)]
    used, first = np.unique(triangles, return_index=True)
    at = first[np.searchsorted(used, nearest)]
    fine = SurfacePoints(points.names, triangles[at // 3], np.eye(3)[at % 3])
    constraints = dict.fromkeys(fine.names, EVERY_AXIS)
    start = time.process_time()
    d = FeaturePointDeformer(vertices, triangles, fine, constraints, fade=True, smoothing=0.5)
    assert time.process_time() - start < 12.0
    assert d.n_vertices > 70000


def test_an_array_that_is_handed_in_is_filled(head: Head) -> None:
    points, triangles = skin_points(head)
    alike = dict.fromkeys(points.names, EVERY_AXIS)
    for constraints in (alike, {**alike, points.names[0]: (True, False, True)}):
        d = FeaturePointDeformer(head.mesh.vertices, triangles, points, constraints)
        moves = np.random.default_rng(7).normal(size=(2, len(points), 3))
        out = np.full((2, d.n_vertices, 3), np.nan)

        assert d.displace(moves, out=out) is out

        np.testing.assert_array_equal(out, d.displace(moves))
        with pytest.raises(ValueError, match=r"out must be contiguous float64 of shape"):
            d.displace(moves[0], out=out)
        with pytest.raises(ValueError, match="out must be"):
            d.displace(moves, out=out.astype(np.float32))


def test_wrong_calls_are_told() -> None:
    vertices, triangles, points = three_points()
    with pytest.raises(InputError, match=r"no points 9\.9"):
        FeaturePointDeformer(vertices, triangles, points, {"9.9": EVERY_AXIS})
    d = FeaturePointDeformer(vertices, triangles, points, {"one": EVERY_AXIS})
    with pytest.raises(ValueError, match=r"\(3, 3\) or \(T, 3, 3\), got \(4, 3\)"):
        d.displace(np.zeros((4, 3)))
