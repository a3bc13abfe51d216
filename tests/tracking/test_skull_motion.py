"""Head motion from markers that wobble, against exact motion."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from facewright.core.head_motion import HeadMotion
from facewright.tracking.rigid_fit import fit_rigid
from facewright.tracking.skull_motion import estimate_skull_motion

Floats = NDArray[np.float64]
RATE_HZ = 60.0
SKULL = np.array([[63.0, 26, -42], [-63.0, 26, -42], [0.0, 82, -6], [20.0, 75, 5]])
FACE = np.array(
    [[12.0, -5, 22], [-12.0, -5, 22], [25.0, -60, 15], [-25.0, -60, 15], [0, -90, 20], [0, -20, 35]]
)
NEUTRAL = np.concatenate([SKULL, FACE])
IS_RIGID = np.arange(len(NEUTRAL)) < len(SKULL)


def curves(rng: np.random.Generator, shape: tuple[int, ...], frames: float, sd: float) -> Floats:
    """Smooth random courses of a standard deviation, 0 in the first frame."""
    v = gaussian_filter1d(rng.normal(size=shape), frames, axis=0)
    v *= sd / v.std()
    return np.asarray(v - v[0])


def take(
    seed: int,
    *,
    n: int = 600,
    noise_mm: float = 0.03,
    wobble_mm: tuple[float, ...] = (0.0,) * 4,
    face_mm: float = 2.0,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Times, positions, true rotations and translations."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(curves(rng, (n, 3), 15, 0.15)).as_matrix()
    t = curves(rng, (n, 3), 20, 15.0) + (10.0, 20, 500)
    moving = np.array([*wobble_mm, *(face_mm,) * len(FACE)])
    d = curves(rng, (n, len(NEUTRAL), 3), 8, 1.0) * moving[:, None]
    p = np.einsum("tij,tmj->tmi", R, NEUTRAL + d) + t[:, None]
    return np.arange(n) / RATE_HZ, p + rng.normal(0, noise_mm, size=p.shape), R, t


def angles_deg(found: Floats, true: Floats) -> Floats:
    turn = Rotation.from_matrix(np.swapaxes(true, 1, 2) @ found)
    return np.asarray(np.rad2deg(turn.magnitude()))


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def covariance_of(noise_mm: float, p: Floats) -> Floats:
    return np.broadcast_to(noise_mm**2 * np.eye(3), (*p.shape, 3))


@pytest.mark.parametrize("noise_mm", [0.02, 0.3])
@pytest.mark.parametrize("told", [True, False])
def test_errors_are_small_and_as_stated(noise_mm: float, told: bool) -> None:
    off, stated, standardised, raw = [], [], [], []
    for seed in range(4):
        time_s, p, R, t = take(seed, noise_mm=noise_mm)
        C = covariance_of(noise_mm, p) if told else None

        found = estimate_skull_motion(time_s, p, NEUTRAL, IS_RIGID, C)

        motion = found.motion
        assert motion.covariance is not None
        turn = Rotation.from_matrix(R @ np.swapaxes(motion.rotation, 1, 2)).as_rotvec()
        error = np.concatenate([turn, t - motion.translation], axis=1)
        off.append(turn)
        stated.append(np.trace(motion.covariance[:, :3, :3], axis1=1, axis2=2))
        solved = np.linalg.solve(motion.covariance, error[..., None])[..., 0]
        standardised.append((error * solved).sum(axis=1))
        raw.append(angles_deg(found.unsmoothed.rotation, R))
    total = np.rad2deg(np.sqrt((np.concatenate(off) ** 2).sum(axis=1).mean()))
    assert total <= 1.02 * rms(np.concatenate(raw))
    promised = np.rad2deg(np.sqrt(np.mean(stated)))
    if told:
        assert promised == pytest.approx(total, rel=0.3)
        assert np.mean(standardised) == pytest.approx(6, rel=0.5)  # degrees of freedom
    else:  # noise that cannot be told from wobble is taken to last
        assert 0.8 < promised / total < 2


def test_noise_of_slow_heads_is_smoothed_away() -> None:
    rng = np.random.default_rng(1)
    n = 600
    R = Rotation.from_rotvec(curves(rng, (n, 3), 60, 0.1)).as_matrix()
    p = np.einsum("tij,mj->tmi", R, NEUTRAL) + rng.normal(0, 0.3, size=(n, len(NEUTRAL), 3))
    time_s = np.arange(n) / RATE_HZ

    found = estimate_skull_motion(time_s, p, NEUTRAL, IS_RIGID, covariance_of(0.3, p))

    before = rms(angles_deg(found.unsmoothed.rotation, R))
    assert rms(angles_deg(found.motion.rotation, R)) < 0.5 * before


def test_a_marker_that_wobbles_counts_less() -> None:
    """One of four moves with the forehead: alike weights follow it, ours do not."""
    off, plain = [], []
    for seed in range(4):
        time_s, p, R, _ = take(seed, wobble_mm=(0.05, 0.05, 0.05, 2.0))

        found = estimate_skull_motion(time_s, p, NEUTRAL, IS_RIGID)

        alike, _ = fit_rigid(SKULL, p[:, IS_RIGID])
        off.append(rms(angles_deg(found.motion.rotation, R)))
        plain.append(rms(angles_deg(alike, R)))
        assert found.wobble_mm[3] > 5 * found.wobble_mm[:3].max()
    assert np.mean(off) < 0.25 * np.mean(plain)


def test_quiet_markers_of_the_face_help_restless_skulls() -> None:
    """Every marker meant to be rigid wobbles; nose and brow hardly move."""
    off, plain = [], []
    for seed in range(4):
        time_s, p, R, _ = take(seed, wobble_mm=(0.6,) * 4, face_mm=0.2)

        found = estimate_skull_motion(time_s, p, NEUTRAL, IS_RIGID)

        alike, _ = fit_rigid(SKULL, p[:, IS_RIGID])
        off.append(rms(angles_deg(found.motion.rotation, R)))
        plain.append(rms(angles_deg(alike, R)))
        assert found.used[~IS_RIGID].sum() >= 3
    assert np.mean(off) < 0.75 * np.mean(plain)


def test_a_face_that_moves_is_not_used() -> None:
    time_s, p, R, t = take(0, face_mm=3.0, noise_mm=0.0)

    found = estimate_skull_motion(time_s, p, NEUTRAL, IS_RIGID)

    np.testing.assert_array_equal(found.used, IS_RIGID)
    np.testing.assert_allclose(found.motion.rotation, R, atol=1e-9)
    np.testing.assert_allclose(found.motion.translation, t, atol=1e-7)


def test_frames_with_two_markers_have_no_motion() -> None:
    time_s, p, R, _ = take(0)
    p[100, 2:] = np.nan
    p[200] = np.nan

    found = estimate_skull_motion(time_s, p, NEUTRAL, IS_RIGID)

    lost = np.isnan(found.motion.quaternion[:, 0])
    assert np.flatnonzero(lost).tolist() == [100, 200]
    assert found.motion.covariance is not None
    assert np.isnan(found.motion.covariance[lost]).all()
    assert rms(angles_deg(found.motion.rotation[~lost], R[~lost])) < 0.1


def test_the_result_moves_with_the_world() -> None:
    time_s, p, _, _ = take(2, wobble_mm=(0.1, 0.1, 0.1, 0.5))
    Q = Rotation.from_rotvec([0.5, 2.0, -1.0]).as_matrix()
    shift = np.array([300.0, -20, 90])

    here = estimate_skull_motion(time_s, p, NEUTRAL, IS_RIGID, smooth=False)
    there = estimate_skull_motion(time_s, p @ Q.T + shift, NEUTRAL, IS_RIGID, smooth=False)

    np.testing.assert_allclose(there.motion.rotation, Q @ here.motion.rotation, atol=1e-8)
    np.testing.assert_allclose(
        there.motion.translation, here.motion.translation @ Q.T + shift, atol=1e-6
    )
    both = np.kron(np.eye(2), Q)
    assert here.motion.covariance is not None
    assert there.motion.covariance is not None
    np.testing.assert_allclose(
        there.motion.covariance, both @ here.motion.covariance @ both.T, atol=1e-9
    )


def test_a_head_motions_covariance_is_checked() -> None:
    with pytest.raises(ValueError, match="covariance must have shape"):
        HeadMotion(np.arange(2.0), np.ones((2, 4)), np.zeros((2, 3)), np.zeros((2, 3, 3)))
