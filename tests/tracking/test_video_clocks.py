"""Numbers of frames from time stamps, against what was dropped, jittered and drifted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.core.audio import Audio
from facewright.core.errors import InputError
from facewright.core.video_writer import VideoWriter, join_videos
from facewright.tracking.video_clocks import Beat, read_clocks

IMAGE = np.zeros((48, 64), np.uint8)


def video(path: Path, stamps_s: list[float] | None, rate_hz: float, n: int = 40) -> Path:
    with VideoWriter(path, (64, 48), rate_hz) as writer:
        for i in range(n if stamps_s is None else len(stamps_s)):
            writer.write(IMAGE, None if stamps_s is None else stamps_s[i])
    return path


@pytest.mark.parametrize("rate_hz", [25.0, 60.0, 60000 / 1001, 120.0])
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_the_rate_is_that_of_the_stamps(tmp_path: Path, rate_hz: float, suffix: str) -> None:
    """Matroska rounds stamps to a millisecond."""
    paths = {n: video(tmp_path / f"{n}{suffix}", None, rate_hz, 200) for n in ("a", "b")}

    clocks = read_clocks(paths)

    assert clocks.rate_hz == pytest.approx(rate_hz, rel=1e-12)
    assert clocks.n_beats == pytest.approx(200, abs=1)
    assert clocks.notes == ()


def test_lost_frames_do_not_lower_the_rate(tmp_path: Path) -> None:
    kept = [i / 60 for i in range(120) if i % 7 not in (3, 4)]
    paths = {"a": video(tmp_path / "a.mp4", None, 60.0), "b": video(tmp_path / "b.mp4", kept, 60.0)}

    assert read_clocks(paths).rate_hz == 60.0


def test_a_file_whose_rate_is_wrong_is_told_from_one_of_another_rate(tmp_path: Path) -> None:
    a = video(tmp_path / "a.mp4", None, 60.0, 60)
    lie = video(tmp_path / "b.mp4", None, 30.0, 60)
    other = video(tmp_path / "c.mp4", None, 30.0, 30)

    with pytest.raises(InputError, match="both have about 60 frames: one file's frame rate is"):
        read_clocks({"a": a, "b": lie})
    with pytest.raises(InputError, match="run at different rates"):
        read_clocks({"a": a, "c": other})
    assert read_clocks({"a": a, "b": lie}, rate_hz=60.0).rate_hz == 60.0


def test_sound_that_is_shorter_than_the_pictures_is_told(tmp_path: Path) -> None:
    """Filmed at 120 frames/s, kept as 30."""
    silent = video(tmp_path / "a.mp4", None, 30.0, 120)
    hum = Audio(np.sin(np.arange(48000) / 20).astype(np.float32) * 0.3, 48000)
    heard = tmp_path / "b.mp4"
    join_videos([silent], heard, starts_s=[0.0], audio=hum)

    (note,) = read_clocks({"a": silent, "b": heard}).notes

    assert note.startswith("b: pictures of 4.0 s beside 1.0 s of sound: if it was filmed at 1")


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_frames_are_numbered_through_drops_jitter_and_drift(jitter: float) -> None:
    """A clock that is 0.05 % fast is 54 frames ahead after half an hour."""
    rng = np.random.default_rng(0)
    n, rate_hz = 108_000, 60.0
    kept = np.flatnonzero(rng.random(n) >= 0.05)
    kept[0] = 0
    stamps = (kept * 1.0005 + jitter * rng.uniform(-1, 1, len(kept))) / rate_hz
    stamps[0] = 0
    beat = Beat("a", 1 / rate_hz)

    found = np.array([beat.number(float(t)) for t in stamps])

    wrong = found != kept
    assert wrong.mean() == 0 if jitter == 0 else wrong.mean() < 1e-3


def test_numbers_grow_whatever_the_stamps_say() -> None:
    beat = Beat("a", 0.02)

    found = [beat.number(t) for t in (0.0, 0.001, 0.021, 0.1, 0.101)]

    assert found == sorted(set(found))


def test_it_goes_on_from_a_stamp_in_the_middle() -> None:
    beat = Beat("a", 1 / 60, (3600, 60.011))

    assert [beat.number(t) for t in (60.011, 60.011 + 2 / 60)] == [3600, 3602]


def test_a_leap_of_minutes_is_an_interrupted_recording() -> None:
    beat = Beat("cam1.mp4", 1 / 60)
    beat.number(0.0)

    with pytest.raises(InputError, match=r"cam1\.mp4: .* leap from 0\.000 to 100\.000"):
        beat.number(100.0)
