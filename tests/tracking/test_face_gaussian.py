"""The Gaussian of a face against textbook algebra on whole covariance matrices."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from facewright.core.person import Person
from facewright.tracking.face_gaussian import FaceGaussian, distance2, gaussian_cost
from facewright.tracking.face_variation import low_rank
from facewright.tracking.person_model import learn
from facewright.tracking.weighted_fit import fit_frames, to_head

Floats = NDArray[np.float64]
M = 7


def person(rng: np.random.Generator, n_modes: int = 4, *, log_scale_sd: float = 0.05) -> Person:
    return Person(
        "set",
        tuple("abcdefg"),
        rng.normal(0, 50, (M, 3)),
        rng.normal(0, 3, (n_modes, M, 3)),
        rng.uniform(1, 2, M),
        np.ones(M, bool),
        log_scale_sd,
    )


def whole_covariance(gaussian: FaceGaussian) -> Floats:
    B = gaussian.modes.reshape(len(gaussian.modes), -1)
    return np.asarray(B.T @ B + np.diag(np.repeat(gaussian.person.noise_mm**2, 3)))


def coordinates(markers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.repeat(markers, 3)


@pytest.mark.parametrize("seed", range(3))
def test_predictions_are_conditional_gaussians(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gaussian = FaceGaussian(person(rng, log_scale_sd=0.05 * (seed % 2)))
    mean, S = gaussian.person.neutral.ravel(), whole_covariance(gaussian)
    q = gaussian.person.neutral + rng.normal(0, 4, (5, M, 3))
    q[1, 2] = q[2, :4] = q[4] = np.nan
    used = rng.random((5, M)) < 0.8

    found = gaussian.predict(q, used)

    for t in range(len(q)):
        there = used[t] & ~np.isnan(q[t, :, 0])
        for m in range(M):
            a, b = coordinates(np.arange(M) == m), coordinates(there & (np.arange(M) != m))
            gain = S[np.ix_(a, b)] @ np.linalg.inv(S[np.ix_(b, b)])
            expected = mean[a] + gain @ (q[t].ravel()[b] - mean[b])
            np.testing.assert_allclose(found.mean[t, m], expected, atol=1e-6)
            rest = S[np.ix_(a, a)] - gain @ S[np.ix_(b, a)]
            np.testing.assert_allclose(found.covariance[t, m], rest, atol=1e-6)
        b = coordinates(there)
        cost = 0.0
        if b.any():
            cost = -multivariate_normal(mean[b], S[np.ix_(b, b)]).logpdf(q[t].ravel()[b])
        assert found.cost[t] == pytest.approx(cost, abs=1e-6)


def test_costs_and_distances_are_scipys() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(3, 3))
    C = A @ A.T + np.eye(3)
    off = rng.normal(size=3)

    assert gaussian_cost(off, C) == pytest.approx(-multivariate_normal(cov=C).logpdf(off))
    assert distance2(off, C) == pytest.approx(off @ np.linalg.inv(C) @ off)


def test_the_pose_of_a_deformed_face_is_found() -> None:
    """Its modes explain the deformation, so that it does not turn the head."""
    rng = np.random.default_rng(4)
    face = person(rng, n_modes=2, log_scale_sd=0.0)
    T = 40
    deformed = face.neutral + np.einsum("tk,kmx->tmx", rng.normal(0, 1, (T, 2)), face.modes)
    R = Rotation.random(T, rng=rng).as_matrix()
    t = rng.normal(0, 300, (T, 3))
    x = np.einsum("tij,tmj->tmi", R, deformed) + t[:, None]

    found_R, _ = FaceGaussian(face).pose(x, rounds=30)
    rigid_R, _ = fit_frames(face.neutral, x)

    def off(A: Floats) -> float:
        trace = np.einsum("tij,tij->t", A, R)
        return float(np.sqrt(np.mean(np.arccos(np.clip((trace - 1) / 2, -1, 1)) ** 2)))

    assert off(found_R) < 0.5 * off(rigid_R)


def test_frames_are_fitted_as_one_by_one() -> None:
    rng = np.random.default_rng(5)
    source = rng.normal(0, 50, (M, 3))
    R = Rotation.random(6, rng=rng).as_matrix()
    t = rng.normal(0, 100, (6, 3))
    x = np.einsum("tij,mj->tmi", R, source) + t[:, None]
    x[0, 3] = x[1, :5] = np.nan
    weights = rng.uniform(0.5, 2, (6, M))

    found_R, found_t = fit_frames(source, x, weights)

    assert np.isnan(found_R[1]).all()
    keep = [0, 2, 3, 4, 5]
    np.testing.assert_allclose(found_R[keep], R[keep], atol=1e-9)
    np.testing.assert_allclose(found_t[keep], t[keep], atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(found_R[keep]), 1)
    seen = ~np.isnan(x[2:, :, 0])
    np.testing.assert_allclose(
        to_head(x[2:], found_R[2:], found_t[2:])[seen],
        np.broadcast_to(source, (4, M, 3))[seen],
        atol=1e-6,
    )


def test_weights_decide_between_points_that_disagree() -> None:
    rng = np.random.default_rng(6)
    source = rng.normal(0, 50, (M, 3))
    x = source[None].copy()
    x[0, 0] += 30.0
    weights = np.ones((1, M))
    weights[0, 0] = 1e-9

    R, t = fit_frames(source, x, weights)

    np.testing.assert_allclose(R[0], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(t[0], 0, atol=1e-5)


def test_all_modes_of_a_covariance_give_it_back() -> None:
    rng = np.random.default_rng(7)
    A = rng.normal(0, 2, (3 * M, 3 * M))
    C = A @ A.T

    modes, noise = low_rank(C, np.full(M, 0.5), n_modes=3 * M)
    few, more_noise = low_rank(C, np.full(M, 0.5), n_modes=4)

    flat = modes.reshape(len(modes), -1)
    np.testing.assert_allclose(flat.T @ flat, C, atol=1e-8)
    np.testing.assert_allclose(noise, 0.5)
    variance = (few**2).sum(axis=(0, 2)) + 3 * more_noise**2
    np.testing.assert_allclose(variance, np.diag(C).reshape(M, 3).sum(axis=1) + 3 * 0.25)


def test_what_a_face_does_is_learnt() -> None:
    """From many frames, the learnt covariance is the true one, whatever was believed before."""
    rng = np.random.default_rng(8)
    believed = person(rng, log_scale_sd=0.0)
    truth = rng.normal(0, 4, (2, M, 3))
    c = rng.normal(0, 1, (30000, 2))
    q = believed.neutral + np.einsum("tk,kmx->tmx", c, truth) + rng.normal(0, 0.6, (30000, M, 3))
    q[rng.random((30000, M)) < 0.1] = np.nan

    learnt = learn(believed, q, q)

    flat = learnt.modes.reshape(len(learnt.modes), -1)
    found = flat.T @ flat + np.diag(np.repeat(learnt.noise_mm**2, 3))
    wanted = truth.reshape(2, -1).T @ truth.reshape(2, -1) + 0.36 * np.eye(3 * M)
    assert np.abs(found - wanted).max() < 0.12 * np.abs(wanted).max()
    assert learnt.n_frames == 30000


def test_a_marker_not_seen_at_rest_is_put_where_the_others_say() -> None:
    rng = np.random.default_rng(9)
    known = np.ones(M, bool)
    known[2] = False
    base = person(rng, log_scale_sd=0.0)
    stranger = Person("set", base.labels, base.neutral, base.modes, base.noise_mm, known)
    shift = np.array([3.0, -2.0, 1.0])
    expected = np.broadcast_to(base.neutral, (100, M, 3)) + rng.normal(0, 1, (100, 1, 3))
    q = expected.copy()
    q[:, 2] += shift

    learnt = learn(stranger, q, expected)

    np.testing.assert_allclose(learnt.neutral[2], base.neutral[2] + shift, atol=1e-9)
    assert learnt.is_known.all()
    np.testing.assert_array_equal(learnt.neutral[3], base.neutral[3])
