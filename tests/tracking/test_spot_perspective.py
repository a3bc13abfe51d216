"""The middles of markers' pictures, against outlines cut into thousands of corners."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.core.rigid import Rigid
from facewright.tracking.spot_perspective import disc_centre, disc_spot, sphere_centre, sphere_spot

Floats = NDArray[np.float64]

MATRIX = np.array([[1500.0, 0.0, 640.0], [0.0, 1480.0, 360.0], [0.0, 0.0, 1.0]])
TURNED = Rigid(np.array([0.9, 0.1, -0.3, 0.2]) / np.sqrt(0.95), np.array([20.0, -30.0, 50.0]))
CAMERAS = {
    "pinhole": Camera((1280, 720), MATRIX, TURNED),
    "distorted": Camera(
        (1280, 720), MATRIX, TURNED, "opencv", np.array([-0.2, 0.1, 0.001, -0.002, 0.03])
    ),
    "tsai": Camera((1280, 720), MATRIX, TURNED, "tsai", np.array([0.15])),
}
RADIUS_MM = 5.0
AROUND = np.linspace(0, 2 * np.pi, 4001)[:-1]


def places(count: int, seed: int) -> Floats:
    """Points in the view of the cameras, 400 to 600 mm away, world frame."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(400, 600, count)
    x, y = rng.uniform(-0.38, 0.38, count) * z, rng.uniform(-0.2, 0.2, count) * z
    return TURNED.inverse().apply(np.stack([x, y, z], axis=1))


def ring(axis: Floats) -> Floats:
    """(4000, 3): a unit circle about an axis."""
    a = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    a /= np.linalg.norm(a)
    return np.asarray(np.cos(AROUND)[:, None] * a + np.sin(AROUND)[:, None] * np.cross(axis, a))


def centroid(corners: Floats) -> Floats:
    """Of a polygon's area."""
    x, y = corners.T
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    cross = x * y2 - x2 * y
    whole = np.array([((x + x2) * cross).sum(), ((y + y2) * cross).sum()])
    return np.asarray(whole / (3 * cross.sum()))


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_a_spheres_picture_is_bounded_by_the_rays_that_touch_it(camera: Camera) -> None:
    centres = places(12, 1)

    found = sphere_spot(camera, centres, RADIUS_MM)

    for centre, middle in zip(centres, found, strict=True):
        ray = centre - camera.position
        distance = np.linalg.norm(ray)
        half_angle = np.arcsin(RADIUS_MM / distance)
        ray /= distance
        touching = np.cos(half_angle) * ray + np.sin(half_angle) * ring(ray)
        outline = camera.project(camera.position + 300 * touching)
        np.testing.assert_allclose(middle, centroid(outline), atol=1e-5)
    assert np.abs(found - camera.project(centres)).max() > 0.02  # there is something to find


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_a_discs_picture_is_bounded_by_its_rim(camera: Camera) -> None:
    centres = places(12, 2)
    normals = np.random.default_rng(3).normal(size=centres.shape)

    found = disc_spot(camera, centres, RADIUS_MM, normals)

    for centre, normal, middle in zip(centres, normals, found, strict=True):
        rim = centre + RADIUS_MM * ring(normal / np.linalg.norm(normal))
        np.testing.assert_allclose(middle, centroid(camera.project(rim)), atol=1e-5)
    assert np.abs(found - camera.project(centres)).max() > 0.05


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_corrected_spot_is_the_centres_projection(camera: Camera) -> None:
    centres = places(40, 4)
    normals = np.random.default_rng(5).normal(size=centres.shape)
    distance = np.linalg.norm(centres - camera.position, axis=1)
    expected = camera.project(centres)

    sphere = sphere_centre(camera, sphere_spot(camera, centres, RADIUS_MM), RADIUS_MM, distance)
    disc = disc_centre(
        camera, disc_spot(camera, centres, RADIUS_MM, normals), RADIUS_MM, distance, normals
    )

    np.testing.assert_allclose(sphere, expected, atol=1e-8)
    np.testing.assert_allclose(disc, expected, atol=1e-8)


def test_a_distance_that_is_a_little_off_hardly_matters() -> None:
    camera, centres = CAMERAS["pinhole"], places(40, 6)
    spots = sphere_spot(camera, centres, RADIUS_MM)
    distance = np.linalg.norm(centres - camera.position, axis=1)

    found = sphere_centre(camera, spots, RADIUS_MM, 1.05 * distance)

    expected = camera.project(centres)
    assert np.abs(found - expected).max() < 0.12 * np.abs(spots - expected).max()


def test_what_is_missing_or_cannot_be_seen_stays_missing() -> None:
    camera = CAMERAS["pinhole"]
    spots = np.array([[np.nan, np.nan], [600.0, 300.0]])

    found = sphere_centre(camera, spots, RADIUS_MM, np.array([500.0, 4.0]))

    assert np.isnan(found).all()
    behind = camera.position - 100 * camera.camera_from_world.rotation[2]
    assert np.isnan(sphere_spot(camera, behind, RADIUS_MM)).all()


def test_either_side_and_any_length_of_a_normal_is_the_same() -> None:
    camera, centres = CAMERAS["distorted"], places(5, 7)
    normals = np.random.default_rng(8).normal(size=centres.shape)

    found = disc_spot(camera, centres, RADIUS_MM, normals)

    np.testing.assert_allclose(disc_spot(camera, centres, RADIUS_MM, -3 * normals), found)
