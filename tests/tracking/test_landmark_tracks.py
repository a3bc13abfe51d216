from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facewright.heads.face_landmarks import N_LANDMARKS
from facewright.tracking.landmark_regions import (
    CLOSED_CONTOURS,
    CONTOURS,
    IS_EYE,
    IS_QUICK,
    STEADY,
)
from facewright.tracking.landmark_tracks import LandmarkSource, LandmarkTracks


def some_tracks(T: int = 4) -> LandmarkTracks:
    points = np.full((T, N_LANDMARKS, 2), 7.0)
    sd, source = np.ones((T, N_LANDMARKS)), np.full(T, LandmarkSource.NETWORK, np.int64)
    points[1], sd[1], source[1] = np.nan, np.nan, LandmarkSource.MISSING
    return LandmarkTracks(np.arange(T) / 30, points, sd, np.full(T, 20.0), source, (64, 48))


def test_shots_are_the_frames_between_cuts() -> None:
    tracks = replace(some_tracks(), cuts=(2, 3))

    assert tracks.shots == (slice(0, 2), slice(2, 3), slice(3, 4))
    np.testing.assert_array_equal(tracks.is_missing, [False, True, False, False])
    assert not tracks.points_px.flags.writeable


def test_half_a_point_is_refused() -> None:
    points = some_tracks().points_px.copy()
    points[2, 5, 0] = np.nan
    with pytest.raises(ValueError, match="NaN in both"):
        replace(some_tracks(), points_px=points)


def test_a_point_without_a_deviation_is_refused() -> None:
    sd = some_tracks().sd_px.copy()
    sd[2, 5] = np.nan
    with pytest.raises(ValueError, match="sd_px must be positive"):
        replace(some_tracks(), sd_px=sd)


def test_a_missing_frame_that_has_points_is_refused() -> None:
    with pytest.raises(ValueError, match="MISSING where no point"):
        replace(some_tracks(), source=np.zeros(4, np.int64))
    with pytest.raises(ValueError, match="values of LandmarkSource"):
        replace(some_tracks(), source=np.array([1, 0, 1, 9]))


@pytest.mark.parametrize("cuts", [(0,), (4,), (2, 2), (3, 2)])
def test_cuts_outside_or_out_of_order_are_refused(cuts: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="cuts must grow"):
        replace(some_tracks(), cuts=cuts)


def test_contours_are_in_order_along_the_canonical_mask(real_data: Path) -> None:
    """On the mask whose vertices the network's first 468 points are, neighbours are near."""
    path = real_data / "heads" / "canonical_face_model.obj"
    lines = path.read_text("utf-8").splitlines()
    v = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=float)
    for name, contour in CONTOURS.items():
        at = v[list(contour)]
        steps = np.linalg.norm(np.diff(at, axis=0), axis=1)
        if name in CLOSED_CONTOURS:
            steps = np.append(steps, np.linalg.norm(at[0] - at[-1]))
        assert steps.max() < 3.0 * np.median(steps), name
        # right is the subject's: x to their left, as in our heads
        side = {"right": -1, "left": 1}.get(name.split("_")[1], 0)
        assert np.sign(at[:, 0].mean().round(1)) == side, name


def test_steady_points_are_none_that_move_by_themselves() -> None:
    steady = np.zeros(N_LANDMARKS, bool)
    steady[list(STEADY)] = True
    corners = np.zeros(N_LANDMARKS, bool)
    corners[[33, 133, 263, 362]] = True  # of the eyes: lids turn about them
    assert not (steady & IS_QUICK & ~corners).any()
    assert IS_EYE[468:].all()
