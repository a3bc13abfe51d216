"""The one solver, against SciPy, OpenCV, finite differences and Monte Carlo."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from facewright.capture.bundle import (
    HUBER_SD,
    Bundle,
    BundleCamera,
    BundleData,
    root_of,
    rotations,
    solve_bundle,
)
from facewright.capture.projection import OPENCV, selection

Floats = NDArray[np.float64]
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
BOARD = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0), [0.0]), axis=-1).reshape(-1, 3) * 30
BOARD -= BOARD.mean(axis=0)


def true_row(fx: float = 1200.0) -> Floats:
    row = np.zeros(16)
    row[:8] = fx, fx + 4, 630, 365, -0.2, 0.06, 5e-4, -8e-4
    return row


def truth(n_views: int = 8, n_cameras: int = 1) -> tuple[list[BundleCamera], Floats, Floats]:
    """Cameras side by side and boards before them."""
    rng = np.random.default_rng(11)
    cameras = []
    for i in range(n_cameras):
        R = Rotation.from_euler("y", -0.2 * i).as_matrix()
        free = selection({n: {n: 1.0} for n in NAMES})[1]
        cameras.append(
            BundleCamera(
                true_row(1200 + 50 * i),
                OPENCV,
                free,
                R,
                np.array([-150.0 * i, 4 * i, 9 * i]),
                i > 0,
            )
        )
    turns = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (n_views, 3))).as_matrix()
    return cameras, turns, rng.uniform((-60, -40, 550), (60, 40, 750), (n_views, 3))


def project(
    cameras: list[BundleCamera], R: Floats, t: Floats
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Camera and board of each observation, and OpenCV's pixels of it."""
    camera, board, pixels = [], [], []
    for k in range(len(R)):
        for c, cam in enumerate(cameras):
            world = BOARD @ R[k].T + t[k]
            K = np.array(
                [
                    [cam.intrinsics[0], 0, cam.intrinsics[2]],
                    [0, cam.intrinsics[1], cam.intrinsics[3]],
                    [0, 0, 1],
                ]
            )
            turn = cv2.Rodrigues(cam.rotation)[0]
            uv, _ = cv2.projectPoints(world, turn, cam.translation, K, cam.intrinsics[4:])
            pixels.append(uv[:, 0])
            camera += [c] * len(BOARD)
            board += [k] * len(BOARD)
    return np.array(camera, np.int64), np.array(board, np.int64), np.concatenate(pixels)


def data_of(
    cameras: list[BundleCamera], R: Floats, t: Floats, noise: float, seed: int = 0, sd: float = 1.0
) -> BundleData:
    camera, board, exact = project(cameras, R, t)
    rng = np.random.default_rng(seed)
    pixels = exact + rng.normal(0, noise, exact.shape)
    X = np.tile(BOARD, (len(pixels) // len(BOARD), 1))
    return BundleData(camera, board, X, pixels, np.full(len(pixels), sd))


def disturbed(
    cameras: list[BundleCamera], R: Floats, t: Floats
) -> tuple[list[BundleCamera], Floats, Floats]:
    """A start some way off."""
    rng = np.random.default_rng(2)
    off = []
    for c in cameras:
        row = c.intrinsics.copy()
        row[:4] += rng.normal(0, 15, 4)
        row[4:8] = 0
        turn = rotations(rng.normal(0, 0.02, 3)) if c.pose_is_free else np.eye(3)
        shift = rng.normal(0, 5, 3) * c.pose_is_free
        off.append(
            BundleCamera(
                row, c.model, c.free, turn @ c.rotation, c.translation + shift, c.pose_is_free
            )
        )
    return off, rotations(rng.normal(0, 0.02, t.shape)) @ R, t + rng.normal(0, 5, t.shape)


@pytest.mark.parametrize("n_cameras", [1, 3])
def test_without_noise_the_truth_is_found(n_cameras: int) -> None:
    cameras, R, t = truth(n_cameras=n_cameras)

    found = solve_bundle(*disturbed(cameras, R, t), data_of(cameras, R, t, 0.0))

    assert found.converged
    assert found.rms_px < 1e-7
    for true, camera in zip(cameras, found.cameras, strict=True):
        np.testing.assert_allclose(camera.intrinsics, true.intrinsics, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(camera.translation, true.translation, atol=1e-5)
    np.testing.assert_allclose(found.target_translation, t, atol=1e-4)


def test_the_solution_is_that_of_calibrate_camera() -> None:
    cameras, R, t = truth(10)
    data = data_of(cameras, R, t, 0.3)

    found = solve_bundle(*disturbed(cameras, R, t), data)

    n = len(BOARD)
    seen = [uv.astype(np.float32) for uv in np.split(data.pixels, len(R))]
    exactly = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-15)
    rms, K, k, _, _, sd, *_ = cv2.calibrateCameraExtended(
        [BOARD.astype(np.float32)] * len(R),
        seen,
        (1280, 720),
        np.zeros((3, 3)),
        np.zeros(5),
        flags=cv2.CALIB_FIX_K3,
        criteria=exactly,
    )
    row = found.cameras[0].intrinsics
    assert found.rms_px == pytest.approx(rms, rel=1e-4)
    np.testing.assert_allclose(row[:4], [K[0, 0], K[1, 1], K[0, 2], K[1, 2]], atol=0.02)
    np.testing.assert_allclose(row[4:8], np.ravel(k)[:4], atol=2e-4)
    # its deviations count each point once, ours each coordinate less the parameters
    ours = np.sqrt(np.diag(np.linalg.inv(found.information)) * found.variance_factor)
    freedom = 2 * n * len(R) - found.n_parameters
    ratio = ours / np.ravel(sd)[:8]
    np.testing.assert_allclose(ratio, ratio[0], rtol=0.02)
    assert 0.65 < ratio[0] < 1.05, f"deviations are {ratio[0]:.3f} of OpenCV's, {freedom} free"


def test_the_least_squares_are_scipys() -> None:
    cameras, R, t = truth(4, n_cameras=2)
    data = data_of(cameras, R, t, 0.4)
    n_lens = len(NAMES)

    def residuals(p: Floats, at: Bundle | None = None) -> Floats:
        start = (cameras, R, t)
        if at is not None:
            start = list(at.cameras), at.target_rotation, at.target_translation
        moved: list[BundleCamera] = []
        for c in start[0]:
            row = c.intrinsics.copy()
            row[:8] += p[:n_lens]
            p = p[n_lens:]
            turn, shift = c.rotation, c.translation
            if c.pose_is_free:
                turn, shift, p = rotations(p[:3]) @ turn, shift + p[3:6], p[6:]
            moved.append(BundleCamera(row, c.model, c.free, turn, shift, c.pose_is_free))
        poses = p.reshape(-1, 6)
        _, _, uv = project(moved, rotations(poses[:, :3]) @ start[1], start[2] + poses[:, 3:])
        return (data.pixels - uv).ravel()

    found = solve_bundle(cameras, R, t, data)

    n = 2 * n_lens + 6 + 6 * len(R)
    peer = least_squares(residuals, np.zeros(n), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.cost == pytest.approx(2 * peer.cost, rel=1e-9)
    # the same information, targets eliminated, from SciPy's numerical derivatives at its solution
    there = least_squares(
        residuals, np.zeros(n), jac="3-point", x_scale="jac", max_nfev=1, args=(found,)
    )
    full = there.jac.T @ there.jac
    k = 2 * n_lens + 6
    schur = full[:k, :k] - full[:k, k:] @ np.linalg.solve(full[k:, k:], full[k:, :k])
    scale = np.sqrt(np.diag(schur))
    np.testing.assert_allclose(
        found.information / np.outer(scale, scale), schur / np.outer(scale, scale), atol=2e-4
    )


def test_moving_the_world_moves_the_answer_and_nothing_else() -> None:
    cameras, R, t = truth(5)
    data = data_of(cameras, R, t, 0.3)
    still = solve_bundle(*disturbed(cameras, R, t), data)
    Q, q = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix(), np.array([100.0, -50.0, 30.0])
    # the camera stands elsewhere, and so do the boards
    moved_camera = [
        BundleCamera(
            c.intrinsics,
            c.model,
            c.free,
            c.rotation @ Q.T,
            c.translation - c.rotation @ Q.T @ q,
            False,
        )
        for c in cameras
    ]

    moved = solve_bundle(moved_camera, Q @ R, t @ Q.T + q, data)

    assert moved.cost == pytest.approx(still.cost, rel=1e-9)
    np.testing.assert_allclose(
        moved.cameras[0].intrinsics, still.cameras[0].intrinsics, rtol=1e-5, atol=1e-7
    )
    np.testing.assert_allclose(
        moved.target_translation, still.target_translation @ Q.T + q, atol=1e-3
    )


def test_the_stated_covariance_is_that_of_repetition() -> None:
    cameras, R, t = truth(6)
    noise, n = 0.3, 300
    bound = solve_bundle(cameras, R, t, data_of(cameras, R, t, 0.0, sd=noise), max_steps=0)
    C = np.linalg.inv(bound.information)

    found = np.array(
        [
            solve_bundle(cameras, R, t, data_of(cameras, R, t, noise, seed)).cameras[0].intrinsics
            for seed in range(n)
        ]
    )[:, :8]

    ratio = found.std(axis=0) / np.sqrt(np.diag(C))
    np.testing.assert_allclose(ratio, 1, atol=4 / np.sqrt(2 * n))
    d = found - true_row()[:8]
    z2 = np.einsum("ni,ij,nj->n", d, np.linalg.inv(C), d)
    assert stats.kstest(z2, stats.chi2(8).cdf).pvalue > 1e-3


def test_full_information_holds_the_eliminated_one() -> None:
    cameras, R, t = truth(3)
    found = solve_bundle(cameras, R, t, data_of(cameras, R, t, 0.2))

    whole = np.linalg.inv(found.full_information)[:8, :8]

    np.testing.assert_allclose(whole, np.linalg.inv(found.information), rtol=1e-5, atol=1e-12)


def test_hubers_loss_is_scipys() -> None:
    cameras, R, t = truth(3)
    data = data_of(cameras, R, t, 0.5)
    pixels = data.pixels.copy()
    pixels[::17] += 30.0
    spoilt = BundleData(data.camera, data.target, data.points, pixels, data.sd_px)

    found = solve_bundle(cameras, R, t, spoilt, robust=True)

    z = np.linalg.norm(found.residuals, axis=1)
    far = z > HUBER_SD
    cost = (z[~far] ** 2).sum() + (2 * HUBER_SD * z[far] - HUBER_SD**2).sum()
    assert found.cost == pytest.approx(cost, rel=1e-12)
    np.testing.assert_allclose(found.weights, np.where(far, HUBER_SD / z, 1.0))
    plain = solve_bundle(cameras, R, t, spoilt)
    off = [np.abs(f.cameras[0].intrinsics[:4] - true_row()[:4]).max() for f in (found, plain)]
    assert off[0] < 0.5 * off[1], f"robust {off[0]:.2f} px off, plain {off[1]:.2f} px"


def test_a_free_translation_alone_triangulates_points() -> None:
    cameras, _, _ = truth(1, n_cameras=3)
    fixed = [
        BundleCamera(c.intrinsics, c.model, np.zeros((16, 0)), c.rotation, c.translation, False)
        for c in cameras
    ]
    place = np.array([[20.0, -30.0, 640.0], [-50.0, 10.0, 600.0]])
    pixels = []
    for p in place:
        for c in fixed:
            K = np.array(
                [
                    [c.intrinsics[0], 0, c.intrinsics[2]],
                    [0, c.intrinsics[1], c.intrinsics[3]],
                    [0, 0, 1],
                ]
            )
            uv, _ = cv2.projectPoints(
                p[None], cv2.Rodrigues(c.rotation)[0], c.translation, K, c.intrinsics[4:]
            )
            pixels.append(uv.ravel())
    data = BundleData(
        np.tile(np.arange(3), 2),
        np.repeat([0, 1], 3),
        np.zeros((6, 3)),
        np.array(pixels),
        np.ones(6),
    )

    found = solve_bundle(
        fixed,
        np.stack([np.eye(3)] * 2),
        place + 15.0,
        data,
        target_free=(False, False, False, True, True, True),
    )

    np.testing.assert_allclose(found.target_translation, place, atol=1e-6)
    assert found.n_parameters == 6


def test_observations_may_come_in_any_order() -> None:
    cameras, R, t = truth(3)
    data = data_of(cameras, R, t, 0.3)
    order = np.random.default_rng(0).permutation(len(data.pixels))
    shuffled = BundleData(
        data.camera[order], data.target[order], data.points[order], data.pixels[order], data.sd_px
    )

    a, b = (solve_bundle(cameras, R, t, d) for d in (data, shuffled))

    assert a.cost == pytest.approx(b.cost, rel=1e-10)


def test_a_start_behind_the_camera_does_not_pass_for_a_solution() -> None:
    cameras, R, t = truth(3)
    found = solve_bundle(cameras, R, t * (1, 1, -1), data_of(cameras, R, t, 0.3), max_steps=50)

    assert isinstance(found, Bundle)
    assert not found.converged


def test_wrong_shapes_are_named() -> None:
    with pytest.raises(ValueError, match=r"pixels must have shape \(2, 2\)"):
        BundleData(
            np.zeros(2, np.int64),
            np.zeros(2, np.int64),
            np.zeros((2, 3)),
            np.zeros((3, 2)),
            np.ones(2),
        )


def test_a_root_gives_back_its_covariance_at_any_scale() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    size = 10.0 ** np.array([6, 3, 0, -4, -7, -9])
    C = (A @ A.T) * np.outer(size, size)
    C[2], C[:, 2] = 0.0, 0.0  # held

    root = root_of(C)

    sd = np.where(np.diag(C) > 0, np.sqrt(np.diag(C)), 1.0)
    np.testing.assert_allclose(root @ root.T / np.outer(sd, sd), C / np.outer(sd, sd), atol=1e-12)
    np.testing.assert_array_equal(root[2], 0)
