"""Shoulders below heads: they join, follow, breathe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from facewright.core.errors import InputError
from facewright.core.mesh import Mesh, vertex_normals
from facewright.core.rigid import Rigid
from facewright.heads.bust import Bust, breath_at, make_bust, neck_edge
from facewright.heads.hair_strands import loose_strands
from facewright.heads.head import Head
from facewright.heads.mesh_cut import boundary_loops, cut_surface
from facewright.heads.raycast import RayScene

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def bust(average_head: Head) -> Bust:
    return make_bust(average_head, sleeves="short")


def turned(head: Head, yaw_deg: float, pitch_deg: float) -> Rigid:
    R = Rotation.from_euler("yx", [yaw_deg, pitch_deg], degrees=True).as_matrix()
    return Rigid.from_rotation(R, head.neck_pivot - R @ head.neck_pivot)


def vertices(head: Head) -> Floats:
    return np.array(head.mesh.vertices)


@pytest.mark.parametrize(("yaw_deg", "pitch_deg"), [(0, 0), (35, 0), (-20, 15), (0, -20)])
def test_the_neck_goes_on_where_the_head_ends(
    average_head: Head, bust: Bust, yaw_deg: float, pitch_deg: float
) -> None:
    motion = turned(average_head, yaw_deg, pitch_deg)
    edge = motion.apply(vertices(average_head)[neck_edge(average_head)])

    found = bust.at(vertices(average_head), motion)

    at, _, _ = RayScene(found, bust.triangles).closest(edge)
    assert np.linalg.norm(at - edge, axis=1).max() < 0.1


def test_the_neck_joins_every_head(people: tuple[Head, ...]) -> None:
    for seed, head in enumerate(people):
        found = make_bust(head, broadness=seed / len(people), seed=seed)
        v = found.at(vertices(head), Rigid.identity())
        edge = vertices(head)[neck_edge(head)]
        off = np.linalg.norm(RayScene(v, found.triangles).closest(edge)[0] - edge, axis=1)
        assert np.isfinite(v).all()
        assert off.max() < 0.1, f"{head.name}: {off.max():.2f} mm"
        shoulders = np.ptp(v[np.abs(v[:, 1] - v[:, 1].max()) < 150, 0])
        assert 330 < shoulders < 560  # adults' bideltoid breadth, with a shirt


def test_the_neck_joins_a_head_of_another_mesh(average_head: Head) -> None:
    """Every second vertex of the edge is dropped: its triangles are cut off."""
    loop = neck_edge(average_head)
    on_edge = np.isin(np.asarray(average_head.mesh.triangles), loop[::2])
    gone = np.asarray(on_edge.any(axis=1), dtype=bool).reshape(-1)
    keep = np.flatnonzero(~gone)
    new = np.full(len(gone), -1)
    new[keep] = np.arange(len(keep))
    groups = {
        name: new[rows][new[rows] >= 0].astype(np.int32)
        for name, rows in average_head.mesh.groups.items()
    }
    mesh = Mesh(vertices(average_head), average_head.mesh.triangles[keep], groups=groups)
    head = replace(average_head, mesh=mesh)

    found = make_bust(head)

    edge = vertices(head)[neck_edge(head)]
    off = RayScene(found.vertices, found.triangles).closest(edge)[0] - edge
    assert np.median(np.linalg.norm(off, axis=1)) < 1.5


def test_the_collar_hides_where_the_skin_ends(average_head: Head, bust: Bust) -> None:
    """No ray from around and above goes in between neck and shirt and out below."""
    v, head = bust.at(vertices(average_head), Rigid.identity()), vertices(average_head)
    triangles = np.concatenate([average_head.mesh.triangles, bust.triangles + len(head)])
    scene = RayScene(np.concatenate([head, v]), triangles)
    edge = head[neck_edge(average_head)]
    middle = edge.mean(axis=0)
    for height in (-100.0, 100.0, 400.0):
        for yaw in np.linspace(-np.pi, np.pi, 13):
            eye = middle + (900 * np.sin(yaw), height, 900 * np.cos(yaw))
            goal = middle + 0.98 * (edge - middle) - (0, 8.0, 0)
            t, _, _ = scene.cast(eye, goal - eye)
            assert (t < 1.2).all()


def test_the_waist_stays_where_the_person_sits(average_head: Head, bust: Bust) -> None:
    motion = turned(average_head, 30, 10)
    moved = Rigid.from_rotation(motion.rotation, motion.translation + (25, -10, 15))

    rest = bust.at(vertices(average_head), Rigid.identity())
    found = bust.at(vertices(average_head), moved)

    way = np.linalg.norm(found - rest, axis=1)
    assert way[rest[:, 1] < rest[:, 1].min() + 20].max() < 0.5
    shoulder = (np.abs(rest[:, 0]) > 150) & (rest[:, 1] > -230)
    assert 3 < np.median(way[shoulder]) < 32


def test_a_seat_moves_all(average_head: Head, bust: Bust) -> None:
    seat = turned(average_head, 50, 0)
    motion = turned(average_head, 12, 4)

    found = bust.at(vertices(average_head), seat @ motion, breath=0.4, world_from_bust=seat)

    here = bust.at(vertices(average_head), motion, breath=0.4)
    np.testing.assert_allclose(found, seat.apply(here), atol=1e-9)


def test_breath_swells_the_chest_and_leaves_the_head(average_head: Head, bust: Bust) -> None:
    out = bust.at(vertices(average_head), Rigid.identity(), breath=0.0)
    full = bust.at(vertices(average_head), Rigid.identity(), breath=1.0)

    way = np.linalg.norm(full - out, axis=1)
    edge = cKDTree(vertices(average_head)[neck_edge(average_head)]).query(out)[0]
    assert 2 < way.max() < 8
    assert way[edge < 3].max() < 0.3
    moved = full - out
    assert moved[way.argmax(), 2] > 0


def test_breathing_is_a_cycle() -> None:
    t = np.linspace(0, 12, 2401)
    breath = np.array([breath_at(float(s), 0.3) for s in t])

    assert breath.min() < 0.01 and breath.max() > 0.99
    peaks = np.flatnonzero((breath[1:-1] > breath[:-2]) & (breath[1:-1] >= breath[2:]))
    rate_per_minute = 60 / np.diff(t[peaks]).mean()
    assert 12 < rate_per_minute < 20  # adults at rest


def test_skin_has_the_colour_of_the_neck(average_head: Head) -> None:
    """The unpainted head is one grey: so must be neck and arms, and not the shirt."""
    grey = ((128 / 255 + 0.055) / 1.055) ** 2.4

    found = make_bust(average_head, shirt=(200, 30, 30), sleeves="short")

    is_grey = np.abs(found.colour - grey).max(axis=1) < 1e-3
    assert 0.05 < is_grey.mean() < 0.6
    arms = found.vertices[:, 1] < found.vertices[:, 1].max() - 320
    assert is_grey[arms & (np.abs(found.vertices[:, 0]) > 150)].any()
    long = make_bust(average_head, shirt=(200, 30, 30), sleeves="long")
    low = long.vertices[:, 1] < long.vertices[:, 1].max() - 200
    assert (long.colour[low, 0] > 3 * long.colour[low, 1]).all()


def test_surfaces_face_outwards(average_head: Head, bust: Bust) -> None:
    """Rays from the front meet triangles whose normals look back."""
    x, y = np.meshgrid(np.linspace(-150, 150, 31), np.linspace(-420, -230, 21))
    start = np.stack([x.ravel(), y.ravel(), np.full(x.size, 600.0)], axis=1)
    scene = RayScene(bust.vertices, bust.triangles)

    t, triangle, _ = scene.cast(start, np.tile([0.0, 0.0, -1.0], (len(start), 1)))

    assert np.isfinite(t).all()
    a, b, c = (bust.vertices[bust.triangles[triangle, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).mean() > 0.995


def test_a_closed_head_is_refused(average_head: Head) -> None:
    loop = neck_edge(average_head)
    v = np.concatenate(
        [average_head.mesh.vertices, vertices(average_head)[loop].mean(axis=0)[None]]
    )
    fan = np.stack([np.roll(loop, -1), loop, np.full(len(loop), len(v) - 1)], axis=1)
    triangles = np.concatenate([average_head.mesh.triangles, fan]).astype(np.int32)
    groups = dict(average_head.mesh.groups)
    new = np.arange(len(average_head.mesh.triangles), len(triangles), dtype=np.int32)
    groups["skin"] = np.concatenate([groups["skin"], new])
    closed = replace(
        average_head, mesh=Mesh(v, triangles, groups=groups), shapes=None, shape_names=()
    )

    with pytest.raises(InputError, match="no open edge below the chin"):
        make_bust(closed)


def test_sleeves_are_long_or_short(average_head: Head) -> None:
    with pytest.raises(ValueError, match="sleeves"):
        make_bust(average_head, sleeves="none")


def test_boundary_loops_of_a_plate_with_a_hole() -> None:
    n = 6
    rows, columns = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    keep = ~((rows == 2) & (columns == 3))
    a = (rows * (n + 1) + columns)[keep]
    quads = np.stack([a, a + 1, a + n + 2, a + n + 1], axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)

    loops = sorted(boundary_loops(triangles), key=lambda r: len(r))

    assert [len(loop) for loop in loops] == [4, 4 * n]
    hole = {2 * 7 + 3, 2 * 7 + 4, 3 * 7 + 3, 3 * 7 + 4}
    assert set(loops[0].tolist()) == hole


def test_a_cut_goes_through_triangles() -> None:
    """A plate cut by a circle keeps the circle's area; the cut lies on the level."""
    n = 60
    y, x = np.mgrid[0 : n + 1, 0 : n + 1] * (2.4 / n) - 1.2
    v = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    rows, columns = np.mgrid[0:n, 0:n]
    a = (rows * (n + 1) + columns).ravel()
    quads = np.stack([a, a + 1, a + n + 2, a + n + 1], axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)

    cut = cut_surface(v, triangles, 1 - np.hypot(v[:, 0], v[:, 1]), v[:, 0])

    a, b, c = (cut.vertices[cut.triangles[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > -1e-12).all()
    assert areas.sum() == pytest.approx(np.pi, rel=2e-3)
    (loop,) = cut.loops
    np.testing.assert_allclose(np.linalg.norm(cut.vertices[loop], axis=1), 1, atol=2e-3)
    np.testing.assert_allclose(cut.values, cut.vertices[:, 0], atol=1e-12)
    edge = boundary_loops(cut.triangles)
    assert {len(loop)} == {len(r) for r in edge}


def test_strands_lie_before_the_face_and_hide_some_of_it(people: tuple[Head, ...]) -> None:
    hidden = 0
    for seed, head in enumerate(people[:6]):
        hair = loose_strands(np.random.default_rng(seed), head)
        v = hair.at(vertices(head))
        np.testing.assert_allclose(v, hair.vertices, atol=1e-12)
        skin = np.asarray(head.mesh.triangles)[np.asarray(head.mesh.groups["skin"])]
        scene = RayScene(vertices(head), skin)
        at, triangle, b = scene.closest(v)
        normals = np.einsum("nc,ncx->nx", b, vertex_normals(vertices(head), skin)[skin[triangle]])
        height = ((v - at) * normals).sum(axis=1)
        # roots grow out of the scalp; below, nothing is in the skin
        assert np.quantile(height.reshape(-1, 28)[:, 6:], 0.01) > -0.5
        t, _, _ = RayScene(v, hair.triangles).cast(
            np.array(head.feature_points.at(vertices(head))) + (0, 0, 300.0),
            np.tile([0.0, 0.0, -1.0], (len(head.feature_points), 1)),
        )
        hidden += int(np.isfinite(t).any() or np.ptp(v[:, 1]) > 60)
    assert hidden == 6
