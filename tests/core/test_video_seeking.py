"""Videos from the middle on, and pictures spread over them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.video import read_frames, sample_frames

N, RATE_HZ, GOP = 120, 30, 25


def encode(path: Path, codec: str = "libx264", *, gop: int = GOP, start: int = 0) -> Path:
    """A bar that grows by a pixel a frame; B-frames where the codec has them."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE_HZ)
        stream.width, stream.height, stream.pix_fmt = 192, 64, "yuv420p"
        stream.codec_context.gop_size = gop
        stream.codec_context.max_b_frames = 2
        for i in range(N):
            image = np.full((96, 192), 128, np.uint8)
            image[:64] = 40
            image[:64, : i + 2] = 220
            frame = av.VideoFrame.from_ndarray(image, format="yuv420p")
            frame.pts, frame.time_base = i + start, Fraction(1, RATE_HZ)
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode(None):
            container.mux(packet)
    return path


def number(image: NDArray[np.uint8]) -> int:
    return int((image[32].astype(int) > 130).sum()) - 2


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.mov", "a.avi"])
@pytest.mark.parametrize("first", [1, 24, 25, 26, 77, 119])
def test_reading_from_a_time_gives_the_frames_from_there(
    tmp_path: Path, name: str, first: int
) -> None:
    path = encode(tmp_path / name, "mpeg4" if name.endswith("avi") else "libx264")

    found = list(read_frames(path, gray=True, from_s=first / RATE_HZ))

    assert [number(f.image) for f in found] == list(range(first, N))
    assert [f.index for f in found] == list(range(N - first))
    times = [f.time_s for f in found]
    np.testing.assert_allclose(times, np.arange(first, N) / RATE_HZ, atol=1.1e-3)


def test_times_count_from_the_first_frame_wherever_that_is(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.mkv", start=300)

    found = next(iter(read_frames(path, gray=True, from_s=2.0)))

    assert number(found.image) == 60
    assert found.time_s == pytest.approx(2.0, abs=1.1e-3)


def test_pictures_are_the_same_to_the_bit_whether_sought_or_not(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.mp4")
    whole = [f.image.copy() for f in read_frames(path, gray=True)]

    for first in (30, 90):
        part = [f.image.copy() for f in read_frames(path, gray=True, from_s=first / RATE_HZ)]
        np.testing.assert_array_equal(part, whole[first:])


def test_nothing_lies_behind_the_end(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.mp4")

    assert list(read_frames(path, from_s=100.0)) == []


def test_seeking_skips_what_lies_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 120 frames in groups of 25, few are decoded to see the last two."""
    from facewright.core import video

    counted = []
    decoded = video._decoded

    def counting(*args: object, **more: object) -> object:
        for item in decoded(*args, **more):  # type: ignore[arg-type]
            counted.append(1)
            yield item

    monkeypatch.setattr(video, "_decoded", counting)
    path = encode(tmp_path / "a.mp4")

    found = list(read_frames(path, gray=True, from_s=118 / RATE_HZ))

    assert len(found) == 2
    assert len(counted) < 60


def test_samples_are_spread_over_the_video(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.mp4")

    found = sample_frames(path, 5, gray=True)

    with av.open(str(path)) as container:
        packets = [p for p in container.demux(video=0) if p.is_keyframe and p.pts is not None]
        keys = [round(p.pts * p.time_base * RATE_HZ) for p in packets]
    numbers = [number(f.image) for f in found]
    assert len(numbers) >= 4
    assert numbers == [key for key in keys if key in numbers]
    assert numbers[-1] > 0.6 * N
    assert [f.time_s for f in found] == pytest.approx(
        [number(f.image) / 30 for f in found], abs=2e-3
    )
    assert [f.index for f in found] == list(range(len(found)))


@pytest.mark.parametrize("name", ["a.mp4", "a.avi"])
def test_where_nothing_can_be_sought_samples_are_from_the_start(tmp_path: Path, name: str) -> None:
    path = encode(tmp_path / name, "mpeg4" if name.endswith("avi") else "libx264", gop=N)

    found = sample_frames(path, 6, gray=True)

    assert [number(f.image) for f in found] == [0, 7, 14, 21, 28, 35]
