"""Frames chosen from a video of a board."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.capture.lens import calibrate_board
from facewright.capture.view_choice import choose_frames
from facewright.core.boards import parse_board
from facewright.core.errors import InputError
from facewright.core.video_writer import VideoWriter
from facewright.datasets_synthetic.boards import (
    BoardLook,
    BoardShots,
    board_truth,
    board_views,
    make_board_shots,
)

BOARD = parse_board("chessboard:9x6:25")
SIZE = (640, 480)
N_FRAMES = 72
#: Of which frames the camera is shaken, and which are still pictures of one pose.
SHAKEN = range(20, 32)
STILL = range(50, 64)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, BoardShots]:
    path = tmp_path_factory.mktemp("video") / "board.mp4"
    made = make_board_shots(
        BOARD,
        4,
        n_views=N_FRAMES,
        moving=True,
        image_size=SIZE,
        look=BoardLook(has_background=False),
    )
    with VideoWriter(path, SIZE, 12.0, crf=10) as writer:
        still: NDArray[np.uint8] | None = None
        for index, picture in enumerate(board_views(made, "cam0")):
            if index in SHAKEN:
                picture = np.asarray(cv2.blur(picture, (13, 1)), np.uint8)
            if index in STILL:
                still = picture if still is None else still
                picture = still
            writer.write(picture)
    return path, made


def numbers(names: list[str]) -> list[int]:
    return [int(name.removeprefix("frame ")) for name in names]


def test_frames_are_sharp_and_unlike_and_calibrate(filmed: tuple[Path, BoardShots]) -> None:
    path, made = filmed
    seen: list[int] = []
    found = choose_frames(path, BOARD, max_views=12, on_frame=seen.append)
    frames = numbers([d.name for d in found])

    assert seen == list(range(N_FRAMES))
    assert 8 <= len(found) <= 12
    assert frames == sorted(frames)
    assert not set(frames) & set(SHAKEN)
    assert len(set(frames) & set(STILL)) <= 1
    truth = board_truth(made)["pixels"][0]
    views = [d.view for d in found if d.view is not None]
    for a, b in pairwise(views):
        n = min(len(a.pixels), len(b.pixels))
        assert np.abs(a.pixels[:n] - b.pixels[:n]).max() > 5
    for frame, view in zip(frames, views, strict=True):
        if frame not in STILL and len(view.pixels) == 54:
            assert np.sqrt(((view.pixels - truth[frame]) ** 2).mean()) < 0.05
    lens = calibrate_board(views, SIZE, model="opencv5")
    assert lens.camera.focal_px == pytest.approx(made.rig["cam0"].focal_px, rel=0.003)


def test_fewer_views_cover_more_than_the_first_frames(filmed: tuple[Path, BoardShots]) -> None:
    path, _ = filmed
    few = choose_frames(path, BOARD, max_views=5)

    middles = np.array([d.view.pixels.mean(axis=0) for d in few if d.view is not None])

    assert len(few) == 5
    assert np.ptp(middles, axis=0).max() > 0.25 * SIZE[0]


def test_a_video_without_the_board_gives_nothing(tmp_path: Path) -> None:
    path = tmp_path / "empty.mp4"
    with VideoWriter(path, (320, 240), 10.0) as writer:
        for level in (40, 80, 120):
            writer.write(np.full((240, 320), level, np.uint8))

    assert choose_frames(path, BOARD) == []
    with pytest.raises(InputError, match="at least one"):
        choose_frames(path, BOARD, max_views=0)
