"""Markers are pictured where closed forms and dense integration put them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.discs import Course, Discs, pictured_course
from facewright.datasets_synthetic.lens_light import apply_lens_light
from facewright.datasets_synthetic.marker_painting import Shining, paint_shining
from facewright.datasets_synthetic.optics import NOISELESS, Optics
from facewright.datasets_synthetic.sensor import develop
from facewright.datasets_synthetic.shots import Scene, Shot, half_time_s

Floats = NDArray[np.float64]

PINHOLE = Camera((640, 480), np.array([[1500.0, 0, 330], [0, 1498, 232], [0, 0, 1]]))
LENS = replace(
    PINHOLE, distortion_model="opencv", distortion=np.array([-0.12, 0.1, 4e-4, -3e-4, 0.02])
)
TSAI = replace(PINHOLE, distortion_model="tsai", distortion=np.array([0.11]))
STRONG = replace(
    PINHOLE,
    matrix=np.array([[420.0, 0, 330], [0, 421, 232], [0, 0, 1]]),
    distortion_model="opencv",
    distortion=np.array([0.3, -0.1, 1e-3, 1e-3, 0.01, 0.5, -0.02, 0.01, 2e-3, 1e-3, -1e-3, 5e-4]),
)
CAMERAS = {"pinhole": PINHOLE, "opencv": LENS, "tsai": TSAI, "strong": STRONG}


def shining(
    centres: Floats, normals: Floats | None, radius_mm: Floats, moves: Course | None = None
) -> Shining:
    n = len(centres)
    is_sphere = np.full(n, normals is None)
    normals = np.ones((n, 3)) if normals is None else normals
    course = Course.still(centres) if moves is None else moves
    discs = Discs(course, Course.still(normals), radius_mm, is_sphere)
    return Shining(discs, np.full(n, 0.8), np.zeros(n))


def filmed(
    camera: Camera, optics: Optics, what: Shining
) -> tuple[NDArray[np.float32], Floats, Floats]:
    """Light in a dark room; outlines; visible shares."""
    width, height = camera.image_size
    bare = np.zeros((height, width), np.float32)
    level = bare.copy()
    shot = Shot(camera, optics, 0.0, (Scene(None, None, None),))
    outlines, visible = paint_shining(level, bare, shot, what, [])
    return apply_lens_light(level, optics, camera, psf=False), outlines, visible


def random_markers(
    rng: np.random.Generator, camera: Camera, n: int, kind: str
) -> tuple[Floats, Floats | None, Floats]:
    """On a grid of places in the picture, 300 to 2000 mm away, at all angles to 75°."""
    width, height = camera.image_size
    columns = int(np.ceil(np.sqrt(n * width / height)))
    x = (np.arange(n) % columns + 0.5) / columns * width
    y = (np.arange(n) // columns + 0.5) / np.ceil(n / columns) * height
    xy = camera.undistort(np.stack([x, y], axis=1) + rng.uniform(-1, 1, (n, 2)))
    depth = np.exp(rng.uniform(np.log(300), np.log(2000), n))
    centres = np.column_stack([xy, np.ones(n)]) * depth[:, None]
    radius = rng.uniform(1.0, 2.0, n)
    if kind == "spheres":
        return centres, None, radius
    ray = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    side = np.cross(ray, rng.normal(size=(n, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    slant = rng.uniform(0, np.deg2rad(75), n)[:, None]
    return centres, -np.cos(slant) * ray + np.sin(slant) * side, radius


def centroids(picture: NDArray[np.generic], outlines: Floats, radius_px: Floats) -> Floats:
    """Intensity centroids in windows around places."""
    found = []
    values = picture.astype(np.float64)
    for (x, y), r in zip(outlines, radius_px, strict=True):
        reach = int(np.ceil(r)) + 6
        x0, y0 = max(round(x) - reach, 0), max(round(y) - reach, 0)
        window = values[y0 : y0 + 2 * reach + 1, x0 : x0 + 2 * reach + 1]
        v, u = np.mgrid[: window.shape[0], : window.shape[1]]
        total = window.sum()
        found.append(((window * u).sum() / total + x0, (window * v).sum() / total + y0))
    return np.array(found)


def rms(difference: Floats) -> float:
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


def ellipse_centre(conic: Floats) -> Floats:
    """Of x' C x = 0 with x = (x, y, 1)."""
    return np.asarray(-np.linalg.solve(conic[:2, :2], conic[:2, 2]))


def closed_form(centre: Floats, normal: Floats | None, radius: float) -> Floats:
    """Centre of a sphere's or a disc's ellipse, normalised coordinates."""
    if normal is None:
        # tangent cone: (c·x)² = (‖c‖² - r²) ‖x‖²
        return ellipse_centre(np.outer(centre, centre) - (centre @ centre - radius**2) * np.eye(3))
    a = np.linalg.svd(normal[None])[2][1:]
    to_disc = np.linalg.inv(np.column_stack([a[0] * radius, a[1] * radius, centre]))
    return ellipse_centre(to_disc.T @ np.diag([1.0, 1, -1]) @ to_disc)


def covered(
    rays: Floats, centre: Floats, normal: Floats | None, radius: float
) -> NDArray[np.bool_]:
    """Whether rays (..., 3) from the camera meet a marker; centre (..., 3)."""
    along = (rays * centre).sum(axis=-1)
    if normal is None:
        gap2 = (centre**2).sum(axis=-1) - along**2 / (rays**2).sum(axis=-1)
        return np.asarray((gap2 < radius**2) & (along > 0))
    t = (centre @ normal) / (rays @ normal)
    return np.asarray((((t[..., None] * rays) - centre) ** 2).sum(axis=-1) < radius**2)


@pytest.mark.parametrize("kind", ["spheres", "dots"])
def test_outlines_are_the_centres_of_projected_ellipses(kind: str) -> None:
    centres, normals, radius = random_markers(np.random.default_rng(1), PINHOLE, 120, kind)

    _, outlines, visible = filmed(PINHOLE, Optics(), shining(centres, normals, radius))

    true = PINHOLE.pixel_from_normalised(
        np.array(
            [
                closed_form(c, None if normals is None else normals[i], radius[i])
                for i, c in enumerate(centres)
            ]
        )
    )
    np.testing.assert_allclose(outlines, true, atol=2e-5)
    np.testing.assert_array_equal(visible, 1)
    # the bias that truth includes is real: the projected centre is somewhere else
    assert np.linalg.norm(outlines - PINHOLE.project(centres), axis=1).max() > 0.005


def test_a_large_ball_near_by_has_the_area_of_its_ellipse() -> None:
    """π sqrt(det) of the conic: its outline is not that of its great circle."""
    centre, radius = np.array([[20.0, -3, 420]]), np.array([50.0])

    light, outlines, _ = filmed(PINHOLE, Optics(), shining(centre, None, radius))

    conic = np.outer(centre, centre) - ((centre**2).sum() - radius**2) * np.eye(3)
    middle = ellipse_centre(conic)
    level = -np.linalg.det(conic) / np.linalg.det(conic[:2, :2])
    area = np.pi * abs(level) / np.sqrt(np.linalg.det(conic[:2, :2])) * 1500 * 1498
    assert light.sum(dtype=np.float64) / 0.8 == pytest.approx(area, rel=1e-4)
    np.testing.assert_allclose(outlines[0], PINHOLE.pixel_from_normalised(middle), atol=1e-3)


@pytest.mark.parametrize("name", list(CAMERAS))
@pytest.mark.parametrize("kind", ["spheres", "dots"])
def test_outlines_agree_with_rays_through_the_inverse_lens(kind: str, name: str) -> None:
    """Dense integration: 700 × 700 rays over a marker, by the inverse of the projection."""
    camera = CAMERAS[name]
    centres, normals, radius = random_markers(np.random.default_rng(2), camera, 6, kind)

    _, outlines, _ = filmed(camera, Optics(), shining(centres, normals, radius))

    for i in range(len(centres)):
        reach = 1.6 * camera.focal_px * radius[i] / centres[i, 2] + 2
        offset = np.linspace(-reach, reach, 700)
        x, y = np.meshgrid(outlines[i, 0] + offset, outlines[i, 1] + offset)
        xy = camera.undistort(np.stack([x, y], axis=-1))
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        inside = covered(rays, centres[i], None if normals is None else normals[i], radius[i])
        true = np.array([x[inside].mean(), y[inside].mean()])
        assert inside.sum() > 50
        assert np.linalg.norm(outlines[i] - true) < 5e-4, f"{kind} {i}, depth {centres[i, 2]:.0f}"


@pytest.mark.parametrize("name", ["pinhole", "opencv"])
@pytest.mark.parametrize("kind", ["spheres", "dots"])
@pytest.mark.parametrize(
    ("optics", "allowed_px"),
    [
        (Optics(psf_px=0.5), 0.002),
        (Optics(psf_px=0.8), 0.002),
        (Optics(psf_px=0.5, pupil_mm=3.0, focus_mm=700.0), 0.002),
        (Optics(psf_px=0.6, vignetting=0.5), 0.002),
    ],
)
def test_the_light_has_its_centre_where_truth_says(
    optics: Optics, allowed_px: float, kind: str, name: str
) -> None:
    camera = CAMERAS[name]
    errors_float, errors_8bit = [], []
    for seed in range(4):
        markers = random_markers(np.random.default_rng(seed), camera, 30, kind)
        light, outlines, _ = filmed(camera, optics, shining(*markers))
        depth = markers[0][:, 2]
        reach = camera.focal_px * markers[2] / depth + [
            optics.blur_diameter_px(z, camera.focal_px) / 2 for z in depth
        ]
        errors_float.append(centroids(light, outlines, reach) - outlines)
        image = develop(light, NOISELESS, np.random.default_rng(0))
        errors_8bit.append(centroids(image, outlines, reach) - outlines)

    assert rms(np.concatenate(errors_float)) < allowed_px
    assert rms(np.concatenate(errors_8bit)) < 0.005


def test_without_any_blur_only_what_pixels_do_to_small_discs_is_left() -> None:
    """Square pixels alias: 0.032 r^-1.5 px at worst in each direction for a disc of radius r."""
    for radius_px in (1.5, 3.0, 6.0, 9.0):
        rng = np.random.default_rng(5)
        depth = 1000.0
        xy = PINHOLE.undistort(
            np.stack(np.meshgrid(np.arange(60, 600, 60), np.arange(60, 440, 60)), axis=-1)
            + rng.uniform(0, 1, (7, 9, 2))
        ).reshape(-1, 2)
        centres = np.column_stack([xy, np.ones(len(xy))]) * depth
        normals = np.tile([0.0, 0, -1], (len(xy), 1))
        radius = np.full(len(xy), radius_px / PINHOLE.focal_px * depth)
        light, outlines, _ = filmed(PINHOLE, Optics(), shining(centres, normals, radius))
        error = centroids(light, outlines, np.full(len(xy), radius_px)) - outlines

        assert np.abs(error).max() < 0.036 * radius_px**-1.5
        # the area is exact in any case
        np.testing.assert_allclose(
            light.sum(), 0.8 * np.pi * radius_px**2 * len(xy) * 1498 / PINHOLE.focal_px * (
                1500 / PINHOLE.focal_px
            ), rtol=1e-4,
        )  # fmt: skip


def moving(centres: Floats, optics: Optics, rng: np.random.Generator, speed: float) -> Course:
    """Parabolas: `speed` mm/s and 20 m/s² in random directions."""
    half_s = half_time_s(optics)
    slope = speed * half_s * rng.normal(size=centres.shape)
    bend = 2e4 / 2 * half_s**2 * rng.normal(size=centres.shape)
    return Course(centres, slope, bend, half_s)


@pytest.mark.parametrize("kind", ["spheres", "dots"])
@pytest.mark.parametrize(("exposure_s", "readout_s"), [(0.008, 0.0), (0.0, 0.012), (0.006, 0.01)])
def test_moving_markers_agree_with_rays_at_the_times_of_their_rows(
    exposure_s: float, readout_s: float, kind: str
) -> None:
    """Dense integration over rays and instants, each row at its own time, by the inverse lens."""
    rng = np.random.default_rng(3)
    camera = LENS
    optics = Optics(exposure_s=exposure_s, readout_s=readout_s, psf_px=0.5)
    centres, normals, radius = random_markers(rng, camera, 3, kind)
    course = moving(centres, optics, rng, 400.0)

    light, outlines, _ = filmed(camera, optics, shining(centres, normals, radius, course))

    instants = (np.arange(24) + 0.5) / 24 - 0.5 if exposure_s else np.zeros(1)
    reaches = []
    for i in range(len(centres)):
        way_px = 1500 * exposure_s * camera.focal_px / centres[i, 2]
        reach = 1.4 * camera.focal_px * radius[i] / centres[i, 2] + way_px / 2 + 2
        reaches.append(reach)
        offset = np.linspace(-reach, reach, 450 if exposure_s else 700)
        x, y = np.meshgrid(outlines[i, 0] + offset, outlines[i, 1] + offset)
        xy = camera.undistort(np.stack([x, y], axis=-1))
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        weight = np.zeros(x.shape)
        for late in instants * exposure_s:
            at = course.rows(np.array([i])).at(late + readout_s * (y / 479 - 0.5))
            weight += covered(rays, at, None if normals is None else normals[i], radius[i])
        true = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
        assert not weight[0].any() and not weight[:, 0].any() and not weight[-1].any()
        assert np.linalg.norm(outlines[i] - true) < (2e-3 if exposure_s else 5e-4)
    drawn = centroids(light, outlines, np.array(reaches))
    assert rms(drawn - outlines) < 0.004


def test_centres_are_projections_at_the_time_of_their_row() -> None:
    rng = np.random.default_rng(4)
    optics = Optics(readout_s=0.02, exposure_s=0.004)
    centres, _, _ = random_markers(rng, LENS, 40, "spheres")
    course = moving(centres, optics, rng, 800.0)

    found = pictured_course(LENS, optics, course)

    for i in range(len(centres)):
        late = 0.02 * (found[i, 1] / 479 - 0.5)
        np.testing.assert_allclose(LENS.project(course.at(late)[i]), found[i], atol=1e-6)
    still = pictured_course(LENS, Optics(), Course.still(centres))
    np.testing.assert_allclose(still, LENS.project(centres), atol=1e-9, rtol=0)
    assert np.linalg.norm(found - still, axis=1).max() > 1


def test_a_moved_camera_and_moved_markers_give_the_same_outlines() -> None:
    rng = np.random.default_rng(6)
    pose = Rigid(rng.normal(size=4), np.array([30.0, -20, 100]))
    centres, normals, _ = random_markers(rng, LENS, 20, "dots")
    assert normals is not None
    moved = replace(LENS, camera_from_world=pose)
    world = pose.inverse().apply(centres)
    here = Shot(moved, Optics(), 0.0, (Scene(None, None, None),))

    course = here.course([world])
    tips = here.course([world + pose.inverse().apply(normals) - pose.inverse().translation])

    np.testing.assert_allclose(course.middle, centres, atol=1e-9)
    np.testing.assert_allclose(tips.minus(course).middle, normals, atol=1e-9)
