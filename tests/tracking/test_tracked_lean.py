"""Samples of stills made as tracked ones: what stays of the network's errors, exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.errors import FileFormatError
from facewright.heads.place_face_landmarks import template_face_landmarks
from facewright.tracking.face_fit import landmark_shapes
from facewright.tracking.learn_landmark_noise import Samples, equations
from facewright.tracking.tracked_lean import (
    TrackedLean,
    as_tracked,
    measure_lean,
    read_tracked_lean,
    write_tracked_lean,
)

Floats = NDArray[np.float64]
NUMBERS = np.array([int(n) for n in template_face_landmarks().names])


def samples(rng: np.random.Generator, n: int = 12) -> tuple[Samples, Floats]:
    """A person at any turn whose landmarks are off by known errors (n, 397, 2) mm."""
    rest = np.broadcast_to(landmark_shapes()[0], (n, len(NUMBERS), 3))
    moved = rng.normal(0, 2, rest.shape)
    flip = np.diag([1.0, -1.0, -1.0])
    R = flip @ Rotation.from_rotvec(rng.normal(0, 0.2, (n, 3))).as_matrix()
    t = rng.normal((0, 0, 800), 10, (n, 3))
    error = rng.normal(0, 1, (n, len(NUMBERS), 2))
    P = np.einsum("tij,tnj->tni", R, rest + moved) + t[:, None]
    angle = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    c, s = np.cos(angle), np.sin(angle)
    back = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    xy = (np.einsum("tab,tnb->tna", back, error) + P[..., :2]) / P[..., 2:]
    nothing = np.zeros((n, 1))
    is_neutral = np.arange(n) < 4
    person = np.zeros(n, np.int64)
    return Samples(person, is_neutral, R, t, xy, rest, moved, nothing, nothing, nothing, nothing), (
        error
    )


def errors(s: Samples) -> Floats:
    return equations(s.rotation, s.translation, s.xy, s.rest + s.moved)[1]


def test_of_a_changing_error_the_share_stays_and_of_a_lasting_one_all() -> None:
    rng = np.random.default_rng(0)
    still, error = samples(rng)
    share = rng.uniform(0.1, 1.0, len(NUMBERS))

    tracked = as_tracked(still, TrackedLean(NUMBERS, share, np.zeros(len(NUMBERS))), rng)

    at_rest = error[:4].mean(axis=0)
    expected = at_rest + share[:, None] * (error - at_rest)
    assert np.allclose(errors(tracked), expected, atol=1e-9)


def test_drift_is_as_large_as_stated_and_shared_by_neighbours() -> None:
    rng = np.random.default_rng(1)
    still, _ = samples(rng, 400)
    n = len(NUMBERS)

    tracked = as_tracked(still, TrackedLean(NUMBERS, np.full(n, 1.0), np.full(n, 0.7)), rng)

    drift = (errors(tracked) - errors(still))[4:]
    assert drift.std(axis=(0, 2)).mean() == pytest.approx(0.7, rel=0.02)
    near, far = (np.flatnonzero(k == NUMBERS)[0] for k in (4, 10))  # by the nose tip; forehead
    tip = int(np.flatnonzero(NUMBERS == 1)[0])
    together = [np.corrcoef(drift[:, tip].ravel(), drift[:, k].ravel())[0, 1] for k in (near, far)]
    assert together[0] > 0.5
    assert abs(together[1]) < 0.15


def test_the_share_is_measured() -> None:
    rng = np.random.default_rng(2)
    network = [rng.normal(0, 1, (60, len(NUMBERS), 2)) for _ in range(6)]
    tracked = [0.4 * e + rng.normal(0, 0.3, e.shape) for e in network]

    lean = measure_lean(NUMBERS, landmark_shapes()[0], network, tracked)

    assert np.allclose(lean.share, 0.4, atol=0.06)
    assert np.allclose(lean.drift_mm, 0.3, atol=0.05)


def test_a_table_is_read_back(tmp_path: Path) -> None:
    lean = TrackedLean(np.array([3, 7]), np.array([0.25, 1.0]), np.array([0.5, 0.125]))
    write_tracked_lean(tmp_path / "lean.csv", lean)

    found = read_tracked_lean(tmp_path / "lean.csv")

    assert found.numbers.tolist() == [3, 7]
    assert found.share.tolist() == [0.25, 1.0]
    assert found.drift_mm.tolist() == [0.5, 0.125]


@pytest.mark.parametrize(
    ("text", "where"),
    [("", "line 1"), ("a,b\n", "line 1"), ("number,share,drift_mm\n1,x,2\n", "line 2")],
)
def test_another_table_is_refused(tmp_path: Path, text: str, where: str) -> None:
    path = tmp_path / "lean.csv"
    path.write_text(text, encoding="utf-8")

    with pytest.raises(FileFormatError, match=where):
        read_tracked_lean(path)
