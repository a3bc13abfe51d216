"""Points from several views, against the exact truth, other solvers and the Cramér-Rao bound."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from facewright.core.camera import Camera
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.rigs import face_rig, look_at
from facewright.tracking.triangulation import Views, triangulate

Floats = NDArray[np.float64]


def cameras(n: int, seed: int = 1) -> list[Camera]:
    """Cameras with lens distortion around a face."""
    return list(face_rig(np.random.default_rng(seed), n_cameras=n).cameras.values())


def face_points(rng: np.random.Generator, n: int) -> Floats:
    return rng.uniform((-70, -90, -60), (70, 90, 40), size=(n, 3))


def pixels_of(views: list[Camera], points: Floats) -> Floats:
    """(N, C, 2) px."""
    return np.stack([c.project(points) for c in views], axis=1)


def normalised_of(views: list[Camera], pixels: Floats) -> Floats:
    return np.stack([c.undistort(pixels[:, i]) for i, c in enumerate(views)], axis=1)


@pytest.mark.parametrize("n_views", [2, 3, 4, 6, 8])
def test_points_are_exact_without_noise_through_distorted_lenses(n_views: int) -> None:
    views = cameras(n_views)
    truth = face_points(np.random.default_rng(7), 200)

    found = triangulate(Views.of(views), normalised_of(views, pixels_of(views, truth)))

    np.testing.assert_allclose(found.positions, truth, rtol=0, atol=1e-9)
    assert found.used.all()
    assert found.residual_px.max() < 1e-9


def test_two_exact_views_give_what_opencv_gives() -> None:
    views = cameras(2)
    truth = face_points(np.random.default_rng(3), 50)
    xy = normalised_of(views, pixels_of(views, truth))

    found = triangulate(Views.of(views), xy)

    P = [c.camera_from_world.matrix[:3] for c in views]
    h = cv2.triangulatePoints(P[0], P[1], xy[:, 0].T.copy(), xy[:, 1].T.copy())
    np.testing.assert_allclose(found.positions, (h[:3] / h[3]).T, atol=1e-6)


@pytest.mark.parametrize("n_views", [2, 4])
def test_noisy_views_give_the_minimum_that_scipy_finds(n_views: int) -> None:
    rng = np.random.default_rng(11)
    views = cameras(n_views)
    truth = face_points(rng, 8)
    sd = rng.uniform(0.5, 4.0, size=(8, n_views))
    pixels = pixels_of(views, truth) + rng.normal(size=(8, n_views, 2)) * sd[..., None]
    xy = normalised_of(views, pixels)

    found = triangulate(Views.of(views), xy, sd, tolerance_px=100)

    for n in range(len(truth)):

        def misfit(p: Floats, n: int = n) -> Floats:
            off = []
            for c, camera in enumerate(views):
                q = camera.camera_from_world.apply(p)
                off.append((q[:2] / q[2] - xy[n, c]) * camera.focal_px / sd[n, c])
            return np.concatenate(off)

        best = least_squares(misfit, truth[n], xtol=1e-12, ftol=1e-14, gtol=1e-12)
        np.testing.assert_allclose(found.positions[n], best.x, atol=1e-6)
        np.testing.assert_allclose(found.misfit[n], 2 * best.cost, rtol=1e-6)


@pytest.mark.parametrize("n_views", [2, 4])
def test_the_covariance_is_that_of_many_draws(n_views: int) -> None:
    rng = np.random.default_rng(5)
    views = cameras(n_views)
    truth = np.array([20.0, -40.0, 25.0])
    sd = np.array([0.2, 0.3, 0.25, 0.4])[:n_views]
    pixels = pixels_of(views, truth[None]) + rng.normal(size=(4000, n_views, 2)) * sd[:, None]

    found = triangulate(
        Views.of(views),
        normalised_of(views, pixels),
        np.tile(sd, (4000, 1)),
        tolerance_px=10,
    )

    sample = np.cov(found.positions.T)
    told = np.linalg.inv(found.information.mean(axis=0))
    # in the axes in which the sample is the unit matrix, so that small directions count too
    L = np.linalg.inv(np.linalg.cholesky(sample))
    np.testing.assert_allclose(L @ told @ L.T, np.eye(3), atol=0.1)


@pytest.mark.parametrize("n_views", [2, 3, 4])
def test_the_error_reaches_the_cramer_rao_bound(n_views: int) -> None:
    rng = np.random.default_rng(2)
    views = cameras(n_views)
    truth = face_points(rng, 100)
    sd_px, n_draws, h = 0.2, 40, 1e-4
    jacobian = np.stack(
        [
            (pixels_of(views, truth + h * axis) - pixels_of(views, truth - h * axis)) / (2 * h)
            for axis in np.eye(3)
        ],
        axis=-1,
    )
    fisher = np.einsum("ncia,ncib->nab", jacobian, jacobian) / sd_px**2
    bound = np.sqrt(np.trace(np.linalg.inv(fisher), axis1=1, axis2=2).mean())

    many = np.repeat(truth, n_draws, axis=0)
    noisy = pixels_of(views, many) + rng.normal(0, sd_px, size=(len(many), n_views, 2))
    found = triangulate(Views.of(views), normalised_of(views, noisy), tolerance_px=10)

    rms = np.sqrt(((found.positions - many) ** 2).sum(axis=1).mean())
    assert 0.95 < rms / bound < 1.05


def test_sure_views_count_for_more() -> None:
    rng = np.random.default_rng(4)
    views = cameras(4)
    truth = face_points(rng, 500)
    sd = np.array([0.05, 0.05, 1.0, 1.0])
    pixels = pixels_of(views, truth) + rng.normal(size=(500, 4, 2)) * sd[:, None]
    xy = normalised_of(views, pixels)

    def rms(sd_px: Floats | None) -> float:
        found = triangulate(Views.of(views), xy, sd_px, tolerance_px=20)
        return float(np.sqrt(((found.positions - truth) ** 2).sum(axis=1).mean()))

    assert rms(np.tile(sd, (500, 1))) < 0.4 * rms(None)


@pytest.mark.parametrize("n_views", [4, 6])
def test_one_gross_outlier_is_left_out(n_views: int) -> None:
    rng = np.random.default_rng(9)
    views = cameras(n_views)
    truth = face_points(rng, 300)
    pixels = pixels_of(views, truth)
    bad = rng.integers(n_views, size=300)
    way = rng.uniform(0, 2 * np.pi, size=300)
    pixels[np.arange(300), bad] += 20 * np.stack([np.cos(way), np.sin(way)], axis=1)

    found = triangulate(Views.of(views), normalised_of(views, pixels))

    right = ~found.used[np.arange(300), bad]
    assert right.mean() > 0.98
    np.testing.assert_allclose(found.positions[right], truth[right], atol=1e-8)


def test_of_three_views_an_outlier_across_its_epipolar_lines_is_left_out() -> None:
    """Along an epipolar line an outlier agrees with that view: two views cannot tell."""
    rng = np.random.default_rng(9)
    views = cameras(3)
    truth = face_points(rng, 100)
    pixels = pixels_of(views, truth)
    pixels[:, 1, 1] += 15  # the cameras stand side by side: epipolar lines are nearly horizontal

    found = triangulate(Views.of(views), normalised_of(views, pixels))

    kept = ~np.isnan(found.positions[:, 0])
    assert kept.mean() > 0.9
    np.testing.assert_allclose(found.positions[kept], truth[kept], atol=1e-8)
    assert not found.used[kept, 1].any()


def test_two_views_that_disagree_give_no_point() -> None:
    views = cameras(2)
    pixels = pixels_of(views, face_points(np.random.default_rng(0), 10))
    pixels[:, 1, 1] += 8

    found = triangulate(Views.of(views), normalised_of(views, pixels))

    assert np.isnan(found.positions).all()
    assert not found.used.any()
    assert np.isnan(found.residual_px).all()


def test_parallel_rays_give_no_point() -> None:
    K = np.array([[1500.0, 0, 640], [0, 1500, 360], [0, 0, 1]])
    views = [
        Camera((1280, 720), K, Rigid.from_rotation(np.eye(3), (-100.0 * i, 0, 0))) for i in range(2)
    ]
    xy = np.tile(np.array([[[0.01, 0.02]]]), (1, 2, 1))

    found = triangulate(Views.of(views), xy)

    assert np.isnan(found.positions).all()


def test_a_point_behind_the_cameras_is_none() -> None:
    K = np.array([[1500.0, 0, 640], [0, 1500, 360], [0, 0, 1]])
    views = [
        Camera((1280, 720), K, Rigid.from_rotation(np.eye(3), (-100.0 * i, 0, 0))) for i in range(2)
    ]
    behind = np.array([50.0, 0, -700])
    xy = np.array([[(c.camera_from_world.apply(behind) / -700)[:2] * -1 for c in views]])

    found = triangulate(Views.of(views), -xy)

    assert np.isnan(found.positions).all()


def test_unseen_views_are_not_used_and_one_view_is_no_point() -> None:
    views = cameras(4)
    truth = face_points(np.random.default_rng(0), 3)
    xy = normalised_of(views, pixels_of(views, truth))
    xy[0, 1:] = np.nan
    xy[1, 2] = np.nan
    sd = np.ones((3, 4))
    sd[2, 0] = np.nan

    found = triangulate(Views.of(views), xy, sd)

    assert np.isnan(found.positions[0]).all()
    assert found.used.tolist() == [
        [False] * 4,
        [True, True, False, True],
        [False, True, True, True],
    ]
    np.testing.assert_allclose(found.positions[1:], truth[1:], atol=1e-9)


def test_moving_the_world_moves_the_points() -> None:
    rng = np.random.default_rng(1)
    views = cameras(3)
    truth = face_points(rng, 30)
    pixels = pixels_of(views, truth) + rng.normal(0, 0.2, size=(30, 3, 2))
    move = Rigid(np.array([0.9, 0.1, -0.3, 0.2]), np.array([100.0, -200, 300]))
    moved = [
        Camera(
            c.image_size,
            c.matrix,
            c.camera_from_world @ move.inverse(),
            c.distortion_model,
            c.distortion,
        )
        for c in views
    ]
    xy = normalised_of(views, pixels)

    here = triangulate(Views.of(views), xy, tolerance_px=5)
    there = triangulate(Views.of(moved), xy, tolerance_px=5)

    np.testing.assert_allclose(there.positions, move.apply(here.positions), atol=1e-7)
    np.testing.assert_allclose(there.residual_px, here.residual_px, atol=1e-9)


def test_look_at_looks_at_its_target() -> None:
    pose = look_at((300.0, 100, 700), (10.0, -20, 5))

    at = pose.apply((10.0, -20, 5))

    np.testing.assert_allclose(at[:2], 0, atol=1e-9)
    assert at[2] > 0
    assert pose.apply((10.0, 80, 5))[1] < 0  # up in the world is up in the picture
