"""Rigid and similarity motions, against SciPy's and the exact truth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.errors import InputError
from facewright.tracking.rigid_fit import fit_rigid, fit_similarity, linear_rotation

Floats = NDArray[np.float64]
TRIANGLE = np.array([[64.0, 28, -41], [-60.0, 30, -44], [2.0, 90, -6]])


def motions(n: int, seed: int = 1) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    return Rotation.random(n, rng=rng).as_matrix(), rng.normal(0, 200, size=(n, 3))


def moved(p: Floats, R: Floats, t: Floats) -> Floats:
    return np.asarray(np.einsum("tij,nj->tni", R, p) + t[:, None])


@pytest.mark.parametrize("n_points", [3, 4, 12])
def test_exact_motions_are_found_exactly(n_points: int) -> None:
    p = np.random.default_rng(0).normal(0, 60, size=(n_points, 3))
    R, t = motions(30)

    found_R, found_t = fit_rigid(p, moved(p, R, t))

    np.testing.assert_allclose(found_R, R, atol=1e-12)
    np.testing.assert_allclose(found_t, t, atol=1e-9)


def test_noisy_motions_are_those_of_scipy() -> None:
    rng = np.random.default_rng(3)
    p = rng.normal(0, 60, size=(8, 3))
    R, t = motions(20)
    target = moved(p, R, t) + rng.normal(0, 3.0, size=(20, 8, 3))

    found, shift = fit_rigid(p, target)

    for i in range(20):
        centred = target[i] - target[i].mean(axis=0)
        peer, _ = Rotation.align_vectors(centred, p - p.mean(axis=0))
        np.testing.assert_allclose(found[i], peer.as_matrix(), atol=1e-9)
        residual = target[i] - p @ found[i].T - shift[i]
        np.testing.assert_allclose(residual.mean(axis=0), 0, atol=1e-9)


def test_a_mirrored_target_still_gives_a_rotation() -> None:
    p = np.random.default_rng(0).normal(0, 60, size=(9, 3))

    R, _ = fit_rigid(p, p * (-1, 1, 1))

    assert np.linalg.det(R) == pytest.approx(1)


def test_unseen_points_are_left_out_and_too_few_give_none() -> None:
    p = np.random.default_rng(0).normal(0, 60, size=(5, 3))
    R, t = motions(4)
    target = moved(p, R, t)
    target[0, 1] = np.nan
    target[1, :3] = np.nan  # two left
    target[2] = np.nan

    found, shift = fit_rigid(p, target)

    np.testing.assert_allclose(found[[0, 3]], R[[0, 3]], atol=1e-12)
    assert np.isnan(found[[1, 2]]).all()
    assert np.isnan(shift[[1, 2]]).all()


def test_points_on_a_line_or_in_one_place_have_no_rotation() -> None:
    line = np.linspace(-50, 50, 6)[:, None] * np.array([[0.3, 0.8, -0.5]])
    R, t = motions(3)

    for p in (line, np.zeros((4, 3))):
        found, _ = fit_rigid(p, moved(p, R, t))
        assert np.isnan(found).all()


def test_leading_axes_are_kept() -> None:
    p = np.random.default_rng(0).normal(0, 60, size=(5, 3))
    R, t = motions(6)

    found, shift = fit_rigid(p, moved(p, R, t).reshape(2, 3, 5, 3))

    assert found.shape == (2, 3, 3, 3)
    assert shift.shape == (2, 3, 3)
    np.testing.assert_allclose(found.reshape(6, 3, 3), R, atol=1e-12)


def test_an_exact_similarity_is_found_exactly() -> None:
    p = np.random.default_rng(0).normal(0, 60, size=(7, 3))
    R, t = motions(1)

    s, found, shift = fit_similarity(p, 1.13 * p @ R[0].T + t[0])

    assert s == pytest.approx(1.13, abs=1e-12)
    np.testing.assert_allclose(found, R[0], atol=1e-12)
    np.testing.assert_allclose(shift, t[0], atol=1e-9)


def test_the_linear_method_gives_the_rotation_of_exact_points() -> None:
    R, t = motions(30)
    target = moved(TRIANGLE, R, t)

    found, shift = linear_rotation(TRIANGLE, target)

    least_squares, _ = fit_rigid(TRIANGLE, target)
    np.testing.assert_allclose(found, R, atol=1e-12)
    np.testing.assert_allclose(found, least_squares, atol=1e-9)
    np.testing.assert_allclose(shift, t, atol=1e-9)


def test_the_linear_method_does_not_feel_a_translation() -> None:
    rng = np.random.default_rng(5)
    R, t = motions(10)
    noisy = moved(TRIANGLE, R, t) + rng.normal(0, 0.5, size=(10, 3, 3))
    far = rng.normal(0, 500, size=(10, 1, 3))

    here, t_here = linear_rotation(TRIANGLE, noisy)
    there, t_there = linear_rotation(TRIANGLE + (10.0, 20, 30), noisy + far)

    np.testing.assert_allclose(there, here, atol=1e-9)
    np.testing.assert_allclose(
        t_there, t_here + far[:, 0] - np.einsum("tij,j->ti", here, (10.0, 20, 30)), atol=1e-8
    )


def test_the_linear_method_is_near_least_squares_under_noise() -> None:
    rng = np.random.default_rng(6)
    R, t = motions(300)
    noisy = moved(TRIANGLE, R, t) + rng.normal(0, 0.1, size=(300, 3, 3))

    linear, _ = linear_rotation(TRIANGLE, noisy)
    best, _ = fit_rigid(TRIANGLE, noisy)

    def rms(found: Floats) -> float:
        return float(np.sqrt(((found - R) ** 2).sum(axis=(1, 2)).mean()))

    assert rms(best) < rms(linear) < 2 * rms(best)


def test_three_head_markers_on_a_line_are_refused() -> None:
    line = np.array([[0.0, 0, 0], [10.0, 20, 30], [20.0, 40, 60.001]])

    with pytest.raises(InputError, match="head markers lie on a line"):
        linear_rotation(line, line[None])


def test_the_linear_method_gives_nan_for_unseen_markers() -> None:
    R, t = motions(3)
    target = moved(TRIANGLE, R, t)
    target[1, 2] = np.nan

    found, shift = linear_rotation(TRIANGLE, target)

    assert np.isnan(found[1]).all()
    assert np.isnan(shift[1]).all()
    np.testing.assert_allclose(found[[0, 2]], R[[0, 2]], atol=1e-12)
