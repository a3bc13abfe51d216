"""Video files: what is decoded, what is written, what happens to damaged ones."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from fractions import Fraction
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.audio import Audio, read_audio
from facewright.core.errors import FileFormatError, InputError
from facewright.core.video import probe_video, read_frames
from facewright.core.video_writer import VideoWriter, join_videos

Picture = NDArray[np.uint8]
WIDTH, HEIGHT = 150, 94  # not multiples of a block: lines are padded in the decoder


def picture(index: int, width: int = WIDTH, height: int = HEIGHT) -> Picture:
    """Smooth colours that move, and the frame number as a bright bar."""
    y, x = np.mgrid[:height, :width]
    rgb = np.stack([x * 255 / width, y * 255 / height, (x + 5 * index) % 128 + 60], axis=-1)
    rgb[:8, : 4 * index + 4] = 255
    return rgb.astype(np.uint8)


def make(path: Path, frames: int = 24, **options: object) -> Path:
    with VideoWriter(path, (WIDTH, HEIGHT), 25, **options) as writer:  # type: ignore[arg-type]
        for index in range(frames):
            writer.write(picture(index))
    return path


def encode(
    path: Path,
    codec: str,
    pixel_format: str,
    pictures: list[Picture],
    pts: list[int] | None = None,
    prepare: Callable[[av.VideoStream], None] = lambda stream: None,
    **options: str,
) -> Path:
    """A video straight from FFmpeg; time stamps in ms."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = pixel_format
        stream.codec_context.time_base = Fraction(1, 1000)
        prepare(stream)
        for n, image in enumerate(pictures):
            source = "gray" if image.ndim == 2 else "rgb24"
            frame = av.VideoFrame.from_ndarray(image, source).reformat(format=pixel_format)
            frame.pts, frame.time_base = pts[n] if pts else 40 * n, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def message_of(path: Path, **options: object) -> tuple[int, str]:
    """Frames read before the error, and its words."""
    count = 0
    with pytest.raises(FileFormatError) as caught:
        for _ in read_frames(path, **options):  # type: ignore[arg-type]
            count += 1
    return count, str(caught.value)


# --- Reading ---


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".webm", ".mov"])
def test_what_is_written_is_decoded(tmp_path: Path, suffix: str) -> None:
    path = make(tmp_path / f"a{suffix}", crf=12)

    frames = list(read_frames(path))

    assert [frame.index for frame in frames] == list(range(24))
    # Matroska's clock ticks in milliseconds
    np.testing.assert_allclose([f.time_s for f in frames], np.arange(24) / 25, atol=6e-4)
    for frame in frames:
        assert frame.image.shape == (HEIGHT, WIDTH, 3) and frame.image.dtype == np.uint8
        off = np.abs(frame.image.astype(int) - picture(frame.index)).mean()
        assert off < 4, f"frame {frame.index} is off by {off:.1f} grey levels"


def test_frames_equal_opencvs(real_data: Path) -> None:
    """Another program's decoder, on a clip by yet another's encoder."""
    path = real_data / "faces" / "webcam_clip.mp4"
    peer = cv2.VideoCapture(str(path))
    both = (read_frames(path), read_frames(path, gray=True))
    for frame, gray in islice(zip(*both, strict=True), 40):
        found, expected = peer.read()
        assert found
        off = np.abs(frame.image[..., ::-1].astype(int) - expected)
        # the peer takes its colours from every other pixel, so edges of colour differ
        assert off.mean() < 2 and np.percentile(off, 99) <= 8, (frame.index, off.mean())
        full = (gray.image.astype(float) - 16) * 255 / 219  # luma is of limited range
        brightness = cv2.cvtColor(expected, cv2.COLOR_BGR2GRAY)
        assert np.abs(full - brightness).mean() < 2
    peer.release()


def test_a_real_clip_says_what_it_is(real_data: Path) -> None:
    info = probe_video(real_data / "faces" / "webcam_clip.mp4")
    assert (info.width, info.height, info.rate_hz) == (400, 300, 25)
    assert info.n_frames == 1337 == sum(1 for _ in read_frames(info.path, gray=True))
    assert (info.codec, info.pixel_format) == ("h264", "yuv420p")
    assert info.duration_s == pytest.approx(1337 / 25)
    assert info.bit_rate is not None and 1e5 < info.bit_rate < 2e5


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_decoding_does_not_depend_on_threads(tmp_path: Path, suffix: str) -> None:
    path = make(tmp_path / f"a{suffix}")
    for gray in (False, True):
        one, two, all_ = (list(read_frames(path, gray=gray, threads=n)) for n in (1, 2, 0))
        assert len(one) == len(two) == len(all_) == 24
        for a, b, c in zip(one, two, all_, strict=True):
            assert (a.image == b.image).all() and (a.image == c.image).all()


LUMA_FORMATS = [
    ("ffv1", "yuv420p"),
    ("ffv1", "yuv422p"),
    ("ffv1", "yuv444p"),
    ("ffv1", "gray"),
    ("rawvideo", "nv12"),
    ("rawvideo", "yuyv422"),
    ("rawvideo", "uyvy422"),
    ("ffv1", "yuv420p10le"),
    ("ffv1", "yuv444p12le"),
    ("ffv1", "gray10le"),
    ("ffv1", "gray16le"),
]


@pytest.mark.parametrize(("codec", "pixel_format"), LUMA_FORMATS)
def test_luma_is_as_coded_whatever_the_format(
    tmp_path: Path, codec: str, pixel_format: str
) -> None:
    """Planes are filled by hand, so what is coded is known without any conversion."""
    ramp = np.tile(np.linspace(16, 235, 64).astype(np.uint8), (32, 1))
    flat = av.VideoFrame.from_ndarray(np.full((32, 64, 3), 128, np.uint8), "rgb24")
    frame = flat.reformat(format=pixel_format)
    plane = frame.planes[0]
    bits = frame.format.components[0].bits
    if bits == 8:
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        if pixel_format in ("yuyv422", "uyvy422"):
            rows[:32, pixel_format.index("y") : 128 : 2] = ramp
        else:
            rows[:32, :64] = ramp
    else:
        wide = np.frombuffer(plane, "<u2").reshape(-1, plane.line_size // 2)
        wide[:32, :64] = ramp.astype(np.uint16) << (bits - 8)
    frame.pts, frame.time_base = 0, Fraction(1, 25)
    path = tmp_path / ("a.avi" if codec == "rawvideo" else "a.mkv")
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 32, pixel_format
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))

    (found,) = read_frames(path, gray=True)

    assert found.image.shape == (32, 64) and found.image.dtype == np.uint8
    np.testing.assert_array_equal(found.image, ramp)


def test_luma_of_rgb_video_is_its_brightness(tmp_path: Path) -> None:
    image = picture(3)
    path = encode(tmp_path / "a.mkv", "ffv1", "bgr0", [image])
    (found,) = read_frames(path, gray=True)
    expected = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    assert np.abs(found.image.astype(int) - expected).max() <= 2
    (colour,) = read_frames(path)
    np.testing.assert_array_equal(colour.image, image)


def test_luma_is_a_view_that_outlives_the_decoder_and_cannot_be_written(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mp4")
    kept = list(read_frames(path, gray=True))
    for again, frame in zip(read_frames(path, gray=True), kept, strict=True):
        np.testing.assert_array_equal(again.image, frame.image)
    assert kept[0].image.base is not None
    assert kept[0].image.strides[0] > WIDTH, "lines are padded, so this is the decoder's memory"
    with pytest.raises(ValueError, match="read-only"):
        kept[0].image[0, 0] = 1


def test_variable_rates_keep_their_times(tmp_path: Path) -> None:
    pts = [500, 540, 541, 700, 1900]  # ms; the first is not 0
    path = encode(tmp_path / "a.mkv", "ffv1", "yuv420p", [picture(n) for n in range(5)], pts)
    frames = list(read_frames(path))
    np.testing.assert_allclose([f.time_s for f in frames], (np.array(pts) - 500) / 1000, atol=1e-9)


@pytest.mark.parametrize("rotation", [0, 90, -90, 180])
@pytest.mark.parametrize("gray", [False, True])
def test_rotated_videos_stand_upright(tmp_path: Path, rotation: int, gray: bool) -> None:
    """OpenCV turns them too."""
    if not hasattr(av.VideoStream, "set_display_rotation"):
        pytest.skip("this PyAV cannot write a rotation")

    def prepare(stream: av.VideoStream) -> None:
        if rotation:
            stream.set_display_rotation(rotation)

    image = picture(2)
    path = encode(tmp_path / "a.mp4", "libx264", "yuv420p", [image] * 3, None, prepare, crf="5")

    frame = next(iter(read_frames(path, gray=gray)))

    peer = cv2.VideoCapture(str(path))
    _, expected = peer.read()
    peer.release()
    turned = np.rot90(image, rotation // 90)
    assert frame.image.shape[:2] == expected.shape[:2] == turned.shape[:2]
    off = np.abs(expected[..., ::-1].astype(int) - turned).mean()
    assert off < 4, "the peer agrees on which way is up"
    if gray:
        brightness = cv2.cvtColor(np.ascontiguousarray(turned), cv2.COLOR_RGB2GRAY)
        full = (frame.image.astype(float) - 16) * 255 / 219
        assert np.abs(full - brightness).mean() < 3
    else:
        assert np.abs(frame.image.astype(int) - turned).mean() < 4
    info = probe_video(path)
    assert (info.height, info.width) == turned.shape[:2]


@pytest.mark.parametrize(("hflip", "vflip"), [(True, False), (False, True)])
def test_mirrored_videos_are_mirrored_back(tmp_path: Path, hflip: bool, vflip: bool) -> None:
    if not hasattr(av.VideoStream, "set_display_rotation"):
        pytest.skip("this PyAV cannot write a rotation")

    def prepare(stream: av.VideoStream) -> None:
        stream.set_display_rotation(0, hflip=hflip, vflip=vflip)

    image = picture(2)
    path = encode(tmp_path / "a.mp4", "libx264", "yuv420p", [image], None, prepare, crf="5")
    frame = next(iter(read_frames(path)))
    expected = image[:: -1 if vflip else 1, :: -1 if hflip else 1]
    assert np.abs(frame.image.astype(int) - expected).mean() < 4


def test_avi_with_reordered_frames_has_growing_times(tmp_path: Path) -> None:
    """And frames that were dropped in recording (here 39 of 40) are no damage."""
    pictures = [picture(n) for n in range(20)]
    path = encode(tmp_path / "a.avi", "mpeg4", "yuv420p", pictures, None, bf="2", b="2000000")
    frames = list(read_frames(path))
    np.testing.assert_allclose([f.time_s for f in frames], np.arange(20) * 0.04, atol=1e-3)
    for frame in frames:
        assert np.abs(frame.image.astype(int) - picture(frame.index)).mean() < 6

    path.write_bytes(path.read_bytes()[:-3000])  # the index and some frames
    count, message = message_of(path)
    assert 10 < count < 20
    assert f"frame {count}: expected" in message and "the end of the file" in message


def test_closing_early_closes_the_file(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mp4")
    handles = Path("/proc/self/fd")
    if not handles.is_dir():
        pytest.skip("open files can be counted on Linux only")

    def n_open() -> int:
        return sum(1 for h in handles.iterdir() if h.is_symlink() and h.resolve() == path)

    frames = read_frames(path)
    next(frames)
    assert n_open() == 1
    frames.close()
    assert n_open() == 0


# --- Damage ---


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".webm"])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("keep", [0.98, 0.7, 0.4])
def test_a_video_cut_off_says_at_which_frame(
    tmp_path: Path, suffix: str, threads: int, keep: float
) -> None:
    whole = make(tmp_path / f"whole{suffix}", frames=60)
    data = whole.read_bytes()
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(data[: int(keep * len(data))])

    count, message = message_of(path, threads=threads)

    assert 0 < count < 60
    assert message == f"{path}, frame {count}: expected 60 frames, found the end of the file"
    for cut, frame in zip(read_frames(path), read_frames(whole), strict=False):
        np.testing.assert_array_equal(cut.image, frame.image)
        if cut.index == count - 1:
            break


def test_a_video_without_its_index_cannot_be_opened(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    encode(path, "libx264", "yuv420p", [picture(n) for n in range(10)])  # index at the end
    path.write_bytes(path.read_bytes()[:-400])
    for use in (probe_video, lambda p: next(read_frames(p))):
        with pytest.raises(FileFormatError, match="expected a video, found something else, or a "):
            use(path)


def test_damage_in_the_middle_is_not_passed_over(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mp4", frames=60)
    data = bytearray(path.read_bytes())
    at = int(0.7 * len(data))
    data[at : at + 300] = bytes(300)
    path.write_bytes(data)
    count, message = message_of(path)
    assert count < 60
    assert f"frame {count}: expected 60 frames, found damaged data" in message


def test_a_change_of_size_names_the_frame(tmp_path: Path) -> None:
    """Two streams of different size behind one another, as recorders that are switched make."""
    data = b""
    for size in ((64, 48), (96, 64)):
        part = tmp_path / "part.h264"
        encode(part, "libx264", "yuv420p", [picture(n, *size) for n in range(6)], bf="0")
        data += part.read_bytes()
    path = tmp_path / "a.h264"
    path.write_bytes(data)
    count, message = message_of(path)
    assert count == 6
    assert message == f"{path}, frame 6: expected 64x48, found 96x64"


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.mp4", b""),
        ("a.mp4", b"hello, this is text\n" * 50),
        ("a.txt", b"hello, this is text\n" * 50),
        ("a.mp4", bytes(5000)),
        ("a.m3u8", b"#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n"),
        ("a.ffconcat", b"ffconcat version 1.0\nfile /etc/hostname\n"),
    ],
)
def test_what_is_no_video_is_refused(tmp_path: Path, name: str, data: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    for use in (probe_video, lambda p: next(read_frames(p))):
        with pytest.raises(FileFormatError) as caught:
            use(path)
        assert str(caught.value).startswith(f"{path}, ")


def test_lists_of_other_files_are_not_followed(tmp_path: Path) -> None:
    make(tmp_path / "b.mp4", frames=2)
    path = tmp_path / "a.ffconcat"
    path.write_text("ffconcat version 1.0\nfile b.mp4\n")
    with pytest.raises(FileFormatError, match=r"expected a video, found something else \(concat\)"):
        probe_video(path)


def test_pictures_sounds_and_folders_are_no_videos(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), picture(0))
    with pytest.raises(FileFormatError, match="expected a video, found something else"):
        probe_video(tmp_path / "a.png")
    with av.open(str(tmp_path / "a.mka"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        block = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
        block.sample_rate = 8000
        container.mux(stream.encode(block))
    with pytest.raises(FileFormatError, match="expected a video stream, found none"):
        probe_video(tmp_path / "a.mka")
    with pytest.raises(FileFormatError, match="a folder or a device"):
        probe_video(tmp_path)
    with pytest.raises(FileNotFoundError):
        probe_video(tmp_path / "none.mp4")


# --- Writing ---


def test_the_file_appears_only_when_all_went_well(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.write_text("old")
    for error in (RuntimeError, KeyboardInterrupt):
        with pytest.raises(error), VideoWriter(path, (WIDTH, HEIGHT), 25) as writer:
            writer.write(picture(0))
            raise error
        assert path.read_text() == "old"
        assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError, match="no frame was written"), VideoWriter(path, (64, 64), 25):
        pass
    assert list(tmp_path.iterdir()) == [path]
    make(path, frames=2)
    assert probe_video(path).n_frames == 2
    assert list(tmp_path.iterdir()) == [path]


def test_mp4_files_have_their_index_in_front(tmp_path: Path) -> None:
    data = make(tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")


@pytest.mark.parametrize("rate", [24, 29.97, 30000 / 1001, Fraction(60000, 1001), 50.0])
def test_rates_are_kept(tmp_path: Path, rate: float | Fraction) -> None:
    with VideoWriter(tmp_path / "a.mp4", (WIDTH, HEIGHT), rate) as writer:
        for n in range(30):
            writer.write(picture(n))
    assert probe_video(tmp_path / "a.mp4").rate_hz == pytest.approx(float(rate), rel=1e-6)
    times = [f.time_s for f in read_frames(tmp_path / "a.mp4")]
    np.testing.assert_allclose(times, np.arange(30) / float(rate), atol=2e-5)


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
@pytest.mark.parametrize("level", [0, 60, 128, 255])
def test_gray_levels_survive(tmp_path: Path, suffix: str, level: int) -> None:
    with VideoWriter(tmp_path / f"a{suffix}", (64, 64), 25, crf=8) as writer:
        writer.write(np.full((64, 64), level, np.uint8))
        writer.write(np.full((64, 64, 3), level, np.uint8))
    for colour, gray in zip(
        read_frames(tmp_path / f"a{suffix}"),
        read_frames(tmp_path / f"a{suffix}", gray=True),
        strict=True,
    ):
        assert np.abs(colour.image.astype(int) - level).max() <= 2
        assert np.abs(gray.image - (16 + level * 219 / 255)).max() <= 2


def test_colours_are_tagged_and_keep_their_hue(tmp_path: Path) -> None:
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 150, 120)]
    with VideoWriter(tmp_path / "a.mp4", (64, 64), 25, crf=5) as writer:
        for colour in colours:
            writer.write(np.full((64, 64, 3), colour, np.uint8))
    for frame, colour in zip(read_frames(tmp_path / "a.mp4"), colours, strict=True):
        assert np.abs(frame.image[8:-8, 8:-8].astype(int) - colour).max() <= 4
    with av.open(str(tmp_path / "a.mp4")) as container:
        context = container.streams.video[0].codec_context
        assert (context.colorspace, context.color_range) == (1, 1)


def test_every_frame_can_be_a_key_frame(tmp_path: Path) -> None:
    make(tmp_path / "a.mp4", gop=1)
    with av.open(str(tmp_path / "a.mp4")) as container:
        packets = [p for p in container.demux(video=0) if p.size]
    assert len(packets) == 24 and all(p.is_keyframe for p in packets)


def test_the_bit_rate_is_held(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 256, (240, 320, 3), dtype=np.uint8) for _ in range(100)]
    sizes = {}
    for limit in (None, 500_000):
        path = tmp_path / f"{limit}.mp4"
        with VideoWriter(path, (320, 240), 25, max_bit_rate=limit, preset="ultrafast") as writer:
            for image in noise:
                writer.write(image)
        sizes[limit] = path.stat().st_size * 8 / 4
    assert sizes[500_000] < 900_000 < sizes[None]  # 4 s, of which 2 s of buffer


def test_vp9_stands_in_where_there_is_no_h264(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(av, "codecs_available", av.codecs_available - {"libx264"})
    make(tmp_path / "a.mp4")
    assert probe_video(tmp_path / "a.mp4").codec == "vp9"
    monkeypatch.setattr(av, "codecs_available", set())
    with pytest.raises(InputError, match="none of the encoders libx264, libvpx-vp9"):
        make(tmp_path / "b.mp4")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.parametrize(
    ("name", "size", "message"),
    [
        ("a.mp4", (63, 64), "an even width and height, got 63x64: crop or pad"),
        ("a.mp4", (0, 64), "an even width and height"),
        ("a.gif", (64, 64), "a video is written as one of .mp4"),
    ],
)
def test_videos_that_cannot_be_written_are_refused(
    tmp_path: Path, name: str, size: tuple[int, int], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        VideoWriter(tmp_path / name, size, 25)
    assert list(tmp_path.iterdir()) == []


def test_wrong_calls_are_named(tmp_path: Path) -> None:
    writer = VideoWriter(tmp_path / "a.mp4", (64, 48), 25)
    with pytest.raises(ValueError, match="inside its with block"):
        writer.write(picture(0, 64, 48))
    message = r"\(48, 64\) or \(48, 64, 3\) uint8, got \(64, 48, 3\)"
    with pytest.raises(ValueError, match=message), writer:
        writer.write(picture(0, 48, 64))
    assert list(tmp_path.iterdir()) == []


def test_luma_is_decoded_fast_enough_to_track(tmp_path: Path) -> None:
    """Four cameras of 1280x720 at 60 Hz need 240 frames a second; luma costs next to nothing."""
    rng = np.random.default_rng(0)
    still = np.kron(rng.integers(0, 255, (45, 80, 3)), np.ones((16, 16, 1))).astype(np.uint8)
    path = tmp_path / "a.mp4"
    with VideoWriter(path, (1280, 720), 60, preset="ultrafast") as writer:
        for n in range(90):
            writer.write(np.roll(still, 3 * n, axis=1))

    def seconds(run: Callable[[], object]) -> float:
        start = time.perf_counter()
        run()
        return time.perf_counter() - start

    def bare() -> None:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            for _ in container.decode(stream):
                pass

    def luma() -> None:
        for frame in read_frames(path, gray=True):
            assert frame.image[0, 0] >= 0

    pairs = [(seconds(luma), seconds(bare)) for _ in range(3)]
    ratio = min(ours / peer for ours, peer in pairs)
    assert ratio < 1.5, f"luma takes {ratio:.2f} times the bare decoder's time (measured: 1.1)"


def test_frames_are_freed_as_soon_as_they_are_let_go(tmp_path: Path) -> None:
    path = tmp_path / "clip.mp4"
    with VideoWriter(path, (64, 48), 30) as writer:
        for level in range(0, 200, 5):
            writer.write(np.full((48, 64), level, np.uint8))
    gc.collect()
    gc.disable()
    try:
        for frame in read_frames(path, gray=True):
            del frame
        kept = sum(isinstance(o, av.VideoFrame) for o in gc.get_objects())
    finally:
        gc.enable()
    assert kept <= 2, f"{kept} of 40 frames wait for the garbage collector"


def steps(count: int, size: tuple[int, int] = (96, 64)) -> list[NDArray[np.uint8]]:
    """Gray pictures that tell their number by how far a bright bar reaches."""
    found = []
    for i in range(count):
        image = np.full((size[1], size[0]), 40, np.uint8)
        image[:, : i + 2] = 220
        found.append(image)
    return found


def test_lossless_video_gives_every_pixel_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for shape in ((64, 96), (64, 96, 3)):
        images = [rng.integers(0, 256, shape).astype(np.uint8) for _ in range(3)]
        path = tmp_path / f"{len(shape)}.mkv"
        with VideoWriter(path, (96, 64), 60, lossless=True) as writer:
            for image in images:
                writer.write(image)

        gray = len(shape) == 2
        for image, frame in zip(images, read_frames(path, gray=gray), strict=True):
            np.testing.assert_array_equal(frame.image, image)


def test_lossless_video_is_written_as_matroska(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.mp4: lossless video is written as \.mkv"):
        VideoWriter(tmp_path / "a.mp4", (96, 64), 60, lossless=True)


def test_time_stamps_may_be_irregular(tmp_path: Path) -> None:
    times = [0.0, 0.0151, 0.0402, 0.1]
    with VideoWriter(tmp_path / "a.mp4", (96, 64), 60, time_base=Fraction(1, 90000)) as writer:
        for image, t in zip(steps(4), times, strict=True):
            writer.write(image, t)
        with pytest.raises(ValueError, match="grow"):
            writer.write(steps(1)[0], 0.1)

    found = [f.time_s for f in read_frames(tmp_path / "a.mp4")]
    np.testing.assert_allclose(found, times, atol=1 / 90000)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_joined_videos_are_the_parts_in_their_places(tmp_path: Path, suffix: str) -> None:
    images = steps(24)
    parts = []
    for k in range(3):
        parts.append(tmp_path / f"part{k}{suffix}")
        with VideoWriter(parts[-1], (96, 64), 30, lossless=suffix == ".mkv") as writer:
            for image in images[8 * k : 8 * k + 8]:
                writer.write(image)
    sound = Audio(0.5 * np.sin(np.arange(16_000) * 0.05).astype(np.float32), 16_000)

    # a gap of 0.2 s before the last part
    starts = [0.0, 8 / 30, 16 / 30 + 0.2]
    join_videos(parts, tmp_path / f"all{suffix}", starts_s=starts, audio=sound)

    found = list(read_frames(tmp_path / f"all{suffix}", gray=True))
    expected = np.arange(24) / 30 + np.where(np.arange(24) < 16, 0, 0.2)
    np.testing.assert_allclose([f.time_s for f in found], expected, atol=1.1e-3)
    for i, frame in enumerate(found):
        bar = int((frame.image[32].astype(int) > 130).sum())
        assert bar == i + 2
    assert read_audio(tmp_path / f"all{suffix}").duration_s == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("rotation", [0, 90, 180, 270])
def test_a_joined_video_may_say_that_it_lies_on_its_side(tmp_path: Path, rotation: int) -> None:
    if not hasattr(av.VideoStream, "set_display_rotation"):
        pytest.skip("this PyAV cannot write a rotation")
    upright = steps(30)[29]
    lying = np.ascontiguousarray(np.rot90(upright, -rotation // 90))
    with VideoWriter(tmp_path / "part.mp4", (lying.shape[1], lying.shape[0]), 30) as writer:
        writer.write(lying)

    join_videos(
        [tmp_path / "part.mp4"], tmp_path / "all.mp4", starts_s=[0.0], rotation_deg=rotation
    )

    (frame,) = read_frames(tmp_path / "all.mp4", gray=True)
    assert frame.image.shape == upright.shape
    assert ((frame.image > 130) == (upright > 130)).mean() > 0.98
