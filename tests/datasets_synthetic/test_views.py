"""Pictures of a take: dots where the forward camera model puts them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.mesh import vertex_normals
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.takes import Take, take_truth
from facewright.datasets_synthetic.views import BACKGROUND, TakeRenderer, View
from facewright.heads.raycast import RayScene
from facewright.tracking.blobs import BlobSettings, find_blobs, find_level

Floats = NDArray[np.float64]
FRAME = 26


@pytest.fixture(scope="module")
def renderer(short_take: Take) -> TakeRenderer:
    return TakeRenderer(short_take)


@pytest.fixture(scope="module")
def views(renderer: TakeRenderer) -> dict[str, View]:
    return renderer.frame(FRAME, np.random.default_rng(0), noise=False)


@pytest.fixture(scope="module")
def bare(short_take: Take) -> dict[str, View]:
    """The same pictures without dots."""
    dotless = replace(short_take, dot_radius_mm=np.full(len(short_take.glue), 1e-6))
    return TakeRenderer(dotless).frame(FRAME, np.random.default_rng(0), noise=False)


def world_vertices(take: Take) -> Floats:
    motion = take.head_motion
    pose = Rigid(motion.quaternion[FRAME], motion.translation[FRAME])
    return pose.apply(take.vertices(FRAME))


def test_centres_are_the_projections_of_the_true_markers(
    short_take: Take, views: dict[str, View]
) -> None:
    true = take_truth(short_take).marker_positions[FRAME]

    for name, view in views.items():
        expected = short_take.rig[name].project(true)
        np.testing.assert_allclose(view.centres, expected, atol=1e-9)


def test_dots_cover_the_pixels_around_their_centres(
    views: dict[str, View], bare: dict[str, View]
) -> None:
    """Centre of gravity of what the dot adds to the picture, in shares of coverage."""
    errors, areas = [], []
    for name, view in views.items():
        apart = np.linalg.norm(view.centres[:, None] - view.centres, axis=2) + 1e3 * np.eye(30)
        for m in np.flatnonzero((view.visible > 0.999) & (apart.min(axis=1) > 16)):
            x0, y0 = np.rint(view.centres[m]).astype(int) - 7
            window = np.s_[y0 : y0 + 15, x0 : x0 + 15]
            dotted = view.image[window].astype(np.float64)
            skin = bare[name].image[window].astype(np.float64)
            peak = dotted[6:9, 6:9].max()
            cover = (dotted - skin) / np.maximum(peak - skin, 1)
            y, x = np.mgrid[:15, :15]
            centre = np.array([(cover * x).sum(), (cover * y).sum()]) / cover.sum() + (x0, y0)
            errors.append(centre - view.centres[m])
            areas.append(cover.sum())
    large = np.array(areas) > 40

    assert large.sum() > 20
    rms = np.sqrt((np.array(errors)[large] ** 2).sum(axis=1).mean())
    assert rms < 0.02  # grey levels are rounded: 0.009 to 0.012


def test_the_tracker_finds_the_dots_where_they_are(views: dict[str, View]) -> None:
    """Skin that bends away beside a dot pulls its centre a little; noise and coding are off."""
    errors = []
    for view in views.values():
        found = find_blobs(view.image, BlobSettings(find_level(view.image)))
        for centre in view.centres[view.visible > 0.999]:
            d = np.linalg.norm(found.centres - centre, axis=1)
            if d.min() < 3 and found.areas_px[d.argmin()] > 40:
                errors.append(found.centres[d.argmin()] - centre)

    assert len(errors) > 20
    assert np.sqrt((np.array(errors) ** 2).sum(axis=1).mean()) < 0.06


def test_dots_have_the_area_that_their_slant_leaves(
    short_take: Take, views: dict[str, View]
) -> None:
    """π r² f²/z² times the cosine between the dot's normal and the ray."""
    v = world_vertices(short_take)
    centres, normals = short_take.markers(v, vertex_normals(v, short_take.head.mesh.triangles))
    n = 0
    for name, view in views.items():
        camera = short_take.rig[name]
        ray = centres - camera.position
        depth = camera.camera_from_world.apply(centres)[:, 2]
        cosine = -(normals * ray).sum(axis=1) / np.linalg.norm(ray, axis=1)
        distance = np.linalg.norm(ray, axis=1)
        expected = (
            np.pi
            * short_take.dot_radius_mm**2
            * camera.focal_px**2
            / depth**2
            * cosine
            * distance
            / depth
        )
        found = find_blobs(view.image, BlobSettings(find_level(view.image)))
        for m in np.flatnonzero((view.visible > 0.999) & (cosine > 0.6)):
            d = np.linalg.norm(found.centres - view.centres[m], axis=1)
            if d.min() < 1:
                # pixels above a level that is below half-way: a third of a pixel all around
                rim = 0.35 * 2 * np.sqrt(np.pi * expected[m])
                assert abs(found.areas_px[d.argmin()] - expected[m]) < rim + 2
                n += 1
    assert n > 30


def test_what_stands_before_a_dot_hides_it(short_take: Take, views: dict[str, View]) -> None:
    """Rays from the camera to the dots' centres, against the bare face."""
    v = world_vertices(short_take)
    true = take_truth(short_take).marker_positions[FRAME]
    centres, normals = short_take.markers(v, vertex_normals(v, short_take.head.mesh.triangles))
    lashes = np.zeros(len(short_take.head.mesh.triangles), bool)
    lashes[short_take.head.mesh.groups["lashes"]] = True
    scene = RayScene(v, short_take.head.mesh.triangles[~lashes])
    n_hidden = n_seen = 0
    for name, view in views.items():
        eye = short_take.rig[name].position
        t, *_ = scene.cast(eye, true - eye)
        clearance_mm = (1 - t) * np.linalg.norm(true - eye, axis=1)
        facing = -(normals * (centres - eye)).sum(axis=1) / np.linalg.norm(centres - eye, axis=1)
        for m, clearance in enumerate(clearance_mm):
            if facing[m] < 0.05 or clearance > 8:  # turned away, or something well before it
                assert view.visible[m] < 0.5 or facing[m] > 0
                n_hidden += clearance > 8
            elif facing[m] > 0.15 and clearance < 0:
                assert view.visible[m] > 0.5
                n_seen += 1
    assert n_hidden >= 4  # the far cheek and nostril, seen from the side
    assert n_seen + n_hidden > 20


def test_the_back_of_the_head_hides_the_middle_of_the_face(short_take: Take) -> None:
    motion = short_take.head_motion
    q = np.tile([0.0, 0, 1, 0], (len(motion.time_s), 1))  # half a turn about y
    away = replace(
        short_take,
        performance=replace(
            short_take.performance,
            head_motion=type(motion)(motion.time_s, q, np.zeros_like(motion.translation)),
        ),
    )

    views = TakeRenderer(away).frame(0, np.random.default_rng(0), noise=False)

    middle = np.abs(take_truth(short_take).marker_positions[0, :, 0]) < 20
    assert middle.sum() >= 8
    for view in views.values():
        assert view.visible[middle].max() < 0.05


def test_visible_is_a_share(views: dict[str, View]) -> None:
    for view in views.values():
        assert view.visible.min() >= 0
        assert view.visible.max() <= 1 + 1e-9
        assert (view.visible == 0).any()
        assert (view.visible > 0.99).sum() >= 12


def test_the_skin_is_where_the_mesh_is(short_take: Take, bare: dict[str, View]) -> None:
    """The face's outline against rays through the full-resolution pixels."""
    v = world_vertices(short_take)
    lashes = np.zeros(len(short_take.head.mesh.triangles), bool)
    lashes[short_take.head.mesh.groups["lashes"]] = True
    scene = RayScene(v, short_take.head.mesh.triangles[~lashes])
    for name in ("cam0", "cam2"):
        camera = short_take.rig[name]
        rows = np.arange(100, 620, 40)
        x, y = np.meshgrid(np.arange(1280), rows)
        d = camera.ray(np.stack([x, y], axis=-1).reshape(-1, 2))
        t, *_ = scene.cast(camera.position, d)
        solid = np.isfinite(t).reshape(x.shape)
        drawn = bare[name].image[rows] > BACKGROUND + 1
        edge = np.zeros_like(solid)
        for shift in (-3, -2, -1, 1, 2, 3):
            edge |= np.roll(solid, shift, axis=1) != solid
        assert (solid == drawn)[~edge].mean() > 0.999
        assert 0.1 < solid.mean() < 0.9


def test_half_a_pixel_is_not_lost_between_skin_and_dots(
    short_take: Take, bare: dict[str, View]
) -> None:
    """Left and right outlines of the drawn face are off by the same little from the true ones."""
    v = world_vertices(short_take)
    scene = RayScene(v, short_take.head.mesh.triangles)
    camera = short_take.rig["cam1"]
    rows = np.arange(240, 480, 6)
    x, y = np.meshgrid(np.arange(0, 1280, 0.25), rows)
    d = camera.ray(np.stack([x, y], axis=-1).reshape(-1, 2))
    t, *_ = scene.cast(camera.position, d)
    solid = np.isfinite(t).reshape(x.shape)
    true = np.stack([x[0][solid.argmax(axis=1)], x[0][::-1][solid[:, ::-1].argmax(axis=1)]], 1)
    image = bare["cam1"].image[rows].astype(np.float64)
    drawn = []
    for line in image:
        lit = np.flatnonzero(line > BACKGROUND + 2)
        drawn.append((lit[0], lit[-1]))
    off = np.array(drawn) - true

    middle = np.median(off.mean(axis=1))  # a shift would show here, a blur would not
    assert abs(middle) < 0.75


def test_noise_is_shot_and_read_noise_of_the_seed(renderer: TakeRenderer) -> None:
    a, b, c = (
        renderer.frame(FRAME, np.random.default_rng(seed))["cam0"].image for seed in (1, 1, 2)
    )
    clean = renderer.frame(FRAME, np.random.default_rng(1), noise=False)["cam0"].image

    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)
    off = a.astype(np.float64) - clean
    # levels: sqrt(0.6² + 0.15² · level), and what rounding adds (1/12 twice)
    for low, high in ((5, 9), (35, 45), (150, 215)):
        at = (clean >= low) & (clean <= high)
        expected = np.sqrt(0.6**2 + 0.15**2 * clean[at].mean() + 2 / 12)
        assert at.sum() > 300
        assert off[at].std() == pytest.approx(expected, rel=0.1)
        assert abs(off[at].mean()) < 0.15
