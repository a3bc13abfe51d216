"""Which frames belong together. Truth: the decoder's own times, and simulated clocks."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from facewright.capture.frame_stamps import match_frames, read_frame_stamps
from facewright.core.errors import FileFormatError, InputError
from facewright.core.video import read_frames
from facewright.core.video_writer import VideoWriter
from facewright.datasets_synthetic.clocks import CameraClock, frame_times

RATE_HZ = 30.0


def stamps_of(seed: int, *, dropped: float = 0.0, jitter: float = 0.0) -> tuple:  # type: ignore[type-arg]
    """Beats and stamps of a camera's file, the latter rounded as MP4 rounds."""
    rng = np.random.default_rng(seed)
    found = frame_times(
        rng, CameraClock(), seconds=20, rate_hz=RATE_HZ, dropped=dropped, jitter=jitter
    )
    return found.frame, np.rint(found.stamp_s * 90_000) / 90_000


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".webm"])
def test_stamps_are_those_of_the_decoder(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    picture = np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8)
    with VideoWriter(path, (64, 64), 30, time_base=Fraction(1, 90_000)) as video:
        for k in [0, 1, 2, 4, 5, 9, 10, 11, 12, 13]:
            video.write(np.roll(picture, k, axis=0), time_s=k / 30)

    found = read_frame_stamps(path)

    np.testing.assert_allclose(found, [f.time_s for f in read_frames(path)], atol=1e-9)
    assert len(found) == 10


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(b"no video at all")

    with pytest.raises(FileFormatError, match=r"a\.mp4"):
        read_frame_stamps(tmp_path / "a.mp4")


def test_video_that_is_cut_off_is_told_with_its_frame(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.mp4", tmp_path / "cut.mp4"
    noise = np.random.default_rng(1).integers(0, 255, (20, 64, 64, 3), np.uint8)
    with VideoWriter(whole, (64, 64), 30) as video:
        for picture in noise:
            video.write(picture)
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])

    with pytest.raises(FileFormatError, match=r"cut\.mp4, frame \d+: expected 20 frames"):
        read_frame_stamps(cut)


def test_gaps_tell_which_frames_are_missing() -> None:
    frame, stamps = stamps_of(3, dropped=0.1)
    whole = stamps_of(4)[1]

    match = match_frames({"a": whole, "b": stamps})

    assert match.beat_s is not None
    np.testing.assert_array_equal(np.rint(stamps / match.beat_s["b"]), frame)
    assert f"b {int(frame[-1]) + 1 - len(frame)} of {int(frame[-1]) + 1}" in match.note
    assert not match.warning


def test_whole_videos_are_matched_without_a_word() -> None:
    match = match_frames({"a": stamps_of(0)[1], "b": stamps_of(1)[1]})

    assert match.beat_s is not None
    assert match.beat_s["b"] == pytest.approx(1 / RATE_HZ, rel=1e-5)
    assert (match.note, match.warning) == ("", "")


def test_uneven_frames_have_no_beat() -> None:
    match = match_frames({"a": stamps_of(0, jitter=0.3)[1], "b": stamps_of(1)[1]})

    assert match.beat_s is None
    assert "frames of a come at uneven times" in match.note


def test_fewer_frames_without_a_gap_are_warned_about() -> None:
    stamps = np.arange(600) / RATE_HZ

    match = match_frames({"a": stamps, "b": stamps[:580]})
    nearly = match_frames({"a": stamps, "b": stamps[:599]})

    assert "a 600, b 580" in match.warning
    assert not nearly.warning


def test_videos_that_cannot_be_matched_are_refused() -> None:
    slow, fast = np.arange(100) / 30, np.arange(100) / 50

    with pytest.raises(InputError, match=r"b has 50\.00 frames a second, a 30\.00"):
        match_frames({"a": slow, "b": fast})
    with pytest.raises(InputError, match="b has 1 frame"):
        match_frames({"a": slow, "b": fast[:1]})
