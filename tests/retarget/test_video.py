from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.core.video import probe_video
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head
from facewright.retarget.drive import HeadDrive
from facewright.retarget.video import write_head_video


def test_the_video_has_the_animations_length_and_moves(
    tmp_path: Path, head: Head, drive: HeadDrive
) -> None:
    t = np.linspace(0, 0.4, 25)
    clip = Clip(t, ("head_yaw",), 60000 * t[:, None])
    pictures: list[NDArray[np.uint8]] = []
    path = tmp_path / "head.mp4"

    n = write_head_video(
        path,
        head,
        drive.animate(clip),
        size=(160, 160),
        rate_hz=10,
        on_frame=lambda _, picture: pictures.append(picture),
    )

    info = probe_video(path)
    assert (info.width, info.height, info.rate_hz) == (160, 160, 10)
    assert n == len(pictures) == 5
    difference = np.abs(pictures[0].astype(int) - pictures[-1]).mean()
    assert difference > 1


def test_the_last_pose_is_held_for_sound_that_goes_on(
    tmp_path: Path, head: Head, drive: HeadDrive
) -> None:
    t = np.linspace(0, 0.25, 12)
    animation = drive.animate(Clip(t, ("head_yaw",), 60000 * t[:, None]))
    pictures: list[NDArray[np.uint8]] = []

    n = write_head_video(
        tmp_path / "head.mp4", head, animation, size=(96, 96), rate_hz=10, hold_s=0.3,
        on_frame=lambda _, picture: pictures.append(picture),
    )  # fmt: skip

    assert n == 6
    moved = [np.abs(b.astype(int) - a).mean() for a, b in pairwise(pictures)]
    assert min(moved[:3]) > 0.5 and max(moved[3:]) == 0
    # what is held is the end, not the last frame before it
    end = write_head_video(
        tmp_path / "end.mp4", head, animation.resampled([0.25]), size=(96, 96), rate_hz=10,
        on_frame=lambda _, picture: pictures.append(picture),
    )  # fmt: skip
    assert end == 1 and (pictures[-1] == pictures[3]).all()


def test_another_heads_animation_is_refused(tmp_path: Path, head: Head, drive: HeadDrive) -> None:
    animation = drive.animate(Clip(np.zeros(1), ("open_jaw",), np.zeros((1, 1))))
    with pytest.raises(InputError, match="of head average, not of other"):
        write_head_video(tmp_path / "x.mp4", make_head(Identity("other")), animation)
    assert not list(tmp_path.iterdir())
