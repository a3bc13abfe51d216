"""Boards flat before a camera do not tell its focal length, and no number may pretend they do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.capture import BoardView, calibrate_board
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.errors import InputError

FOCAL_PX = 1500.0
CAMERA = Camera((1280, 720), np.array([[FOCAL_PX, 0, 640.0], [0, FOCAL_PX, 360.0], [0, 0, 1]]))
CORNERS = parse_board("chessboard:9x6:25").object_points()


def view(rng: np.random.Generator, tilt_deg: float, aside_mm: float = 0.0) -> BoardView:
    """A board tilted about some axis of its plane, its corners seen to 0.05 px."""
    way = rng.uniform(0, 2 * np.pi)
    turn = Rotation.from_rotvec(np.deg2rad(tilt_deg) * np.array([np.cos(way), np.sin(way), 0]))
    where = np.array([*rng.uniform(-aside_mm, aside_mm, 2), rng.uniform(700, 1200)])
    pixels = CAMERA.project(turn.apply(CORNERS - CORNERS.mean(axis=0)) + where)
    return BoardView("a view", CORNERS, pixels + rng.normal(0, 0.05, pixels.shape))


@pytest.mark.parametrize("count", [1, 2, 5])
@pytest.mark.parametrize("seed", range(5))
def test_flat_views_are_refused(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    views = [view(rng, 0.0, 150.0 * (count > 1)) for _ in range(count)]

    with pytest.raises(InputError, match=r"do not tell focal length from distance.*tilt it by 30"):
        calibrate_board(views, (1280, 720))


@pytest.mark.parametrize("tilt_deg", [0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 30.0])
def test_one_view_is_refused_or_states_how_sure_it_is(tilt_deg: float) -> None:
    z = []
    for seed in range(12):
        try:
            f = calibrate_board([view(np.random.default_rng(seed), tilt_deg)], (1280, 720))["f"]
        except InputError as error:
            assert "do not tell focal length from distance" in str(error)
            continue
        assert f.sd < 0.25 * f.value
        z.append((f.value - FOCAL_PX) / f.sd)

    assert len(z) == 12 or tilt_deg < 3
    if tilt_deg >= 3:  # the uncertainty is symmetric only where it is small
        assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.6
