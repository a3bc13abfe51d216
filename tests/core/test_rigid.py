"""Rigid motions form a group, and agree with SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.core.rigid import Rigid, quaternion_from_rotation, rotation_from_quaternion

SEEDS = range(5)


def motion(seed: int) -> Rigid:
    rng = np.random.default_rng(seed)
    return Rigid(rng.normal(size=4), rng.normal(scale=100, size=3))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_motion_and_its_inverse_cancel(seed: int) -> None:
    a = motion(seed)
    np.testing.assert_allclose((a @ a.inverse()).matrix, np.eye(4), atol=1e-12)
    np.testing.assert_allclose((a.inverse() @ a).matrix, np.eye(4), atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_composition_is_matrix_multiplication(seed: int) -> None:
    a, b, c = motion(seed), motion(seed + 10), motion(seed + 20)
    points = np.random.default_rng(seed).normal(size=(4, 5, 3))
    np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-11)
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-11)
    np.testing.assert_allclose(((a @ b) @ c).matrix, (a @ (b @ c)).matrix, atol=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_motion_keeps_distances_and_handedness(seed: int) -> None:
    a = motion(seed)
    p, q = np.random.default_rng(seed).normal(size=(2, 3))
    before, after = np.linalg.norm(p - q), np.linalg.norm(a.apply(p) - a.apply(q))
    assert after == pytest.approx(before, abs=1e-13)
    assert np.linalg.det(a.rotation) == pytest.approx(1, abs=1e-13)


def test_quaternions_agree_with_scipy() -> None:
    q = np.random.default_rng(0).normal(size=(50, 4))
    ours = rotation_from_quaternion(q)
    theirs = Rotation.from_quat(q, scalar_first=True).as_matrix()
    np.testing.assert_allclose(ours, theirs, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi])
def test_rotations_become_quaternions_and_back(angle: float) -> None:
    axes = np.random.default_rng(1).normal(size=(20, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rotations = Rotation.from_rotvec(angle * axes).as_matrix()

    q = quaternion_from_rotation(rotations)

    assert (q[:, 0] >= 0).all()
    np.testing.assert_allclose(rotation_from_quaternion(q), rotations, atol=1e-14)


def test_missing_rotations_stay_missing() -> None:
    rotations = np.stack([np.eye(3), np.full((3, 3), np.nan)])
    q = quaternion_from_rotation(rotations)
    np.testing.assert_array_equal(q[0], (1, 0, 0, 0))
    assert np.isnan(q[1]).all()
    assert np.isnan(rotation_from_quaternion(q)[1]).all()


@pytest.mark.parametrize(
    "matrix", [np.diag([1.0, 1, -1]), np.eye(3) * 1.01, np.full((3, 3), np.nan)]
)
def test_what_is_no_rotation_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(ValueError, match="proper rotation"):
        Rigid.from_rotation(matrix)


def test_a_quaternion_of_no_length_is_refused() -> None:
    with pytest.raises(ValueError, match="length above 0"):
        Rigid(np.zeros(4), np.zeros(3))


def test_equal_motions_are_equal() -> None:
    assert motion(1) == motion(1)
    assert motion(1) != motion(2)
    assert motion(1) != "a motion"
