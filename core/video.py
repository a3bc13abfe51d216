"""Video files: frames in, one after the other, and out.

Nothing here holds a whole video in memory. Decoding is the same to the bit for any number of
threads.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .audio import Audio
from .errors import FileFormatError, InputError
from .files import atomic_path

_MAX_PIXELS = 16384 * 16384
#: What opens as "video" but is none: pictures, text as ANSI art, lists of other files.
_NO_VIDEO_FORMATS = ("image2", "tty", "ico", "concat", "hls", "dash")
#: 8-bit formats whose first plane is luma (or gray) for each pixel.
_LUMA_PLANE_8 = frozenset(
    ["gray", "nv12", "nv21", "nv16", "nv24", "nv42", "yuva420p", "yuva422p", "yuva444p"]
    + [f"yuv{j}{layout}p" for j in ("", "j") for layout in (410, 411, 420, 422, 440, 444)]
)
_CONTAINER_CODECS = {  # suffix: (format, video encoders in order of preference, sound encoders)
    ".mp4": ("mp4", ("libx264", "libvpx-vp9"), ("aac", "libopus")),
    ".m4v": ("mp4", ("libx264", "libvpx-vp9"), ("aac", "libopus")),
    ".mov": ("mov", ("libx264",), ("aac",)),
    ".mkv": ("matroska", ("libx264", "libvpx-vp9"), ("aac", "libopus")),
    ".webm": ("webm", ("libvpx-vp9",), ("libopus",)),
}
_AAC_RATES_HZ = (96000, 88200, 64000, 48000, 44100, 32000, 24000, 22050, 16000, 12000, 11025, 8000)
_OPUS_RATES_HZ = (48000, 24000, 16000, 12000, 8000)
_VP9_SPEED = {"ultrafast": 8, "superfast": 8, "veryfast": 7, "faster": 6, "fast": 5, "medium": 4}
_SOUND_BLOCK = 1024
#: swscale's flags: bilinear colour for each pixel, rounded right. Its fast path is off by up to 4
#: grey levels, and takes the colour of every other pixel.
_EXACT = 0x2 | 0x40000 | 0x2000
_BT709, _LIMITED = 1, 1  # AVCOL_SPC_BT709 (also primaries and transfer), AVCOL_RANGE_MPEG


@dataclass(frozen=True)
class VideoInfo:
    """What a video file says of itself.

    Attributes
    ----------
    path : Path
    width, height : int, px
        As shown: after the rotation that phones write beside the pictures.
    rate_hz : float
        Average; NaN where the container does not know.
    duration_s : float
        NaN where the container does not know.
    n_frames : int or None
        As the container promises; None where it does not.
    codec, pixel_format : str
        FFmpeg's names.
    bit_rate : int or None
        Bits per second of the video stream, or of the file where only that is known.
    """

    path: Path
    width: int
    height: int
    rate_hz: float
    duration_s: float
    n_frames: int | None
    codec: str
    pixel_format: str
    bit_rate: int | None


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a video.

    Attributes
    ----------
    index : int
        From 0.
    time_s : float
        From the first frame, by the container's own time stamps.
    image : (height, width) or (height, width, 3) uint8
        Luma or RGB; read-only. Rows may be further apart than they are long.
    """

    index: int
    time_s: float
    image: NDArray[np.uint8]


@contextmanager
def open_container(path: Path, expected: str = "a video") -> Iterator[Any]:
    """FFmpeg's view of a local file; it is closed with the block.

    Raises
    ------
    FileFormatError
        If FFmpeg does not know what the file is, or its index is missing.
    """
    import av

    if path.stat().st_size == 0:
        raise FileFormatError(path, "file", expected, "an empty file")
    if not path.is_file():
        raise FileFormatError(path, "path", expected, "a folder or a device")
    try:
        # no list of addresses may make us call there, nor a name be taken for an address
        options = {"protocol_whitelist": "file"}
        container = av.open(f"file:{path}", options=options, metadata_errors="replace")
    except av.FFmpegError as error:
        found = f"something else, or a file cut off ({error.strerror})"
        raise FileFormatError(path, "file", expected, found) from error
    with container:
        yield container


def probe_video(path: Path) -> VideoInfo:
    """What a video file says of itself; decodes its first frame only.

    Raises
    ------
    FileFormatError
        If it is no video, or its first frame cannot be decoded.
    OSError
        If it cannot be read.
    """
    with open_container(path) as container:
        stream = _video_stream(path, container)
        first, _ = next(_decoded(path, container, stream))
        height, width = _turned(np.empty((first.height, first.width)), first).shape
        rate = stream.average_rate or stream.guessed_rate
        duration_s = _matroska_duration_s(container, stream) or math.nan
        if stream.duration is not None:
            duration_s = float(stream.duration * stream.time_base)
        elif math.isnan(duration_s) and container.duration is not None:
            duration_s = container.duration / 1e6
        return VideoInfo(
            path,
            width,
            height,
            float(rate) if rate else math.nan,
            duration_s,
            stream.frames or None,
            stream.codec_context.codec.name,
            first.format.name,
            stream.bit_rate or container.bit_rate or None,
        )


def read_frames(
    path: Path, *, gray: bool = False, threads: int = 0
) -> Generator[Frame, None, None]:
    """The frames of a video, in order, decoded as they are asked for.

    The file is closed when the iterator ends or is closed; errors come while iterating.

    Parameters
    ----------
    path : Path
    gray : bool
        Hand out luma instead of RGB. It is as coded, usually of limited range (16 is black, 235
        white), and for 8-bit YUV a view of the decoder's own memory, not a copy. Formats of more
        bits are rounded to 8, RGB formats converted (full range).
    threads : int
        Decoder threads; 0 takes all processors.

    Yields
    ------
    Frame

    Raises
    ------
    FileFormatError
        If the file is no video; where it is damaged or cut off, after the frames before that
        (``cam2.mp4, frame 54: expected 60 frames, found the end of the file``); where the
        pictures change size or time stamps do not grow.
    OSError
        If the file cannot be read.
    """
    with open_container(path) as container:
        stream = _video_stream(path, container)
        stream.thread_type = "AUTO"
        stream.thread_count = threads
        rate = stream.average_rate or stream.guessed_rate
        start_s, last_s, size = 0.0, -math.inf, (0, 0)
        for index, (decoded, time_s) in enumerate(_decoded(path, container, stream)):
            if time_s is None:  # raw streams have no clock
                if not rate:
                    raise FileFormatError(path, f"frame {index}", "a time stamp or rate", "neither")
                time_s = index / float(rate)
            if index == 0:
                start_s, size = time_s, (decoded.width, decoded.height)
            if (decoded.width, decoded.height) != size:
                found = f"{decoded.width}x{decoded.height}"
                raise FileFormatError(path, f"frame {index}", f"{size[0]}x{size[1]}", found)
            if time_s <= last_s:
                expected = f"a time stamp after {last_s - start_s:.6f} s"
                raise FileFormatError(path, f"frame {index}", expected, f"{time_s - start_s:.6f} s")
            last_s = time_s
            image = _luma(decoded) if gray else _rgb(decoded)
            image = _turned(image, decoded)
            image.flags.writeable = False
            yield Frame(index, time_s - start_s, image)


def _video_stream(path: Path, container: Any) -> Any:
    """The first stream of moving pictures."""
    name = container.format.name
    if name in _NO_VIDEO_FORMATS or name.endswith("_pipe"):
        raise FileFormatError(path, "file", "a video", f"something else ({name})")
    import av.stream

    cover = av.stream.Disposition.attached_pic
    streams = [s for s in container.streams.video if not s.disposition & cover]
    if not streams:
        raise FileFormatError(path, "file", "a video stream", "none")
    stream = streams[0]
    context = stream.codec_context
    if context is None:
        raise FileFormatError(path, "file", "a video we can decode", "a codec that is not known")
    if context.width * context.height > _MAX_PIXELS:
        found = f"{context.width}x{context.height}"
        raise FileFormatError(path, "header", f"at most {_MAX_PIXELS} pixels", found)
    return stream


def _decoded(path: Path, container: Any, stream: Any) -> Iterator[tuple[Any, float | None]]:
    """Decoded frames and their times; at least one, and never fewer than promised: or an error."""
    import av

    n_packets = n_frames = 0
    problem = ""
    times: deque[float] | None = deque() if container.format.name == "avi" else None

    def timed(frame: Any) -> tuple[Any, float | None]:
        if times is not None:
            return frame, times.popleft() if times else None
        return frame, None if frame.pts is None else float(frame.pts * stream.time_base)

    last = None
    try:
        for packet in container.demux(stream):
            if packet.is_corrupt:  # the demuxer's word for one that the file's end cuts short
                problem = "the end of the file"
            if packet.is_corrupt or not packet.size:
                break
            n_packets += 1
            if times is not None and packet.dts is not None:
                # AVI knows the order of decoding only: the n-th shown has the n-th time
                times.append(float(packet.dts * stream.time_base))
            for last in packet.decode():
                if last.is_corrupt:
                    raise av.InvalidDataError(0, "damaged data")
                yield timed(last)
                n_frames += 1
        if not problem and not _is_whole(path, container, stream, n_packets):
            problem = "the end of the file"
        for frame in stream.decode(None):
            # of a file cut off, what is still in the decoder may lack frames in between
            if problem and not _follows(frame, last, stream):
                break
            if frame.is_corrupt:
                raise av.InvalidDataError(0, "damaged data")
            yield timed(frame)
            last = frame
            n_frames += 1
    except (av.FFmpegError, EOFError) as error:
        problem = f"damaged data ({getattr(error, 'strerror', None) or error})"
    if problem:
        promised = _promised_frames(container, stream)
        expected = f"{promised} frames" if promised else "more frames"
        raise FileFormatError(path, f"frame {n_frames}", expected, problem)
    if n_frames == 0:
        raise FileFormatError(path, "frame 0", "a picture", "the end of the file")


def _follows(frame: Any, last: Any, stream: Any) -> bool:
    """Whether a frame is the next after `last` by its time."""
    if last is None or frame.pts is None or last.pts is None:
        return False
    rate = stream.average_rate or stream.guessed_rate or 25
    length = last.duration or 1 / (rate * stream.time_base)
    return bool(0 < frame.pts - last.pts <= 1.5 * length)


def _is_whole(path: Path, container: Any, stream: Any, n_packets: int) -> bool:
    """Whether as much was there as the container promises; True where it promises nothing."""
    if "matroska" in container.format.name:
        return not _matroska_is_cut(path)
    if container.format.name == "avi":  # counts frames that were dropped in recording
        return not _riff_is_cut(path)
    return bool(n_packets >= stream.frames)


def _promised_frames(container: Any, stream: Any) -> int | None:
    rate = stream.average_rate or stream.guessed_rate
    if stream.frames or not rate:
        return int(stream.frames) or None
    duration_s = _matroska_duration_s(container, stream)
    return round(duration_s * float(rate)) if duration_s else None


def _matroska_is_cut(path: Path) -> bool:
    """Whether the file ends before its one big element, the segment, does."""
    with open(path, "rb") as stream:
        head, size = stream.read(4096), path.stat().st_size
    at = 0
    for element in (b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"):  # EBML header, segment
        if head[at : at + 4] != element or at + 5 > len(head):
            return False
        n_bytes = 9 - head[at + 4].bit_length()  # the position of the first 1 says how many
        value = int.from_bytes(head[at + 4 : at + 4 + n_bytes], "big") & ~(1 << 7 * n_bytes)
        at += 4 + n_bytes
        if value == (1 << 7 * n_bytes) - 1:
            return False  # all ones: not known, as in live streams
        at += value
    return at > size


def _riff_is_cut(path: Path) -> bool:
    """Whether the file ends before its last RIFF chunk (one for each GB or so) does."""
    size, at = path.stat().st_size, 0
    with open(path, "rb") as stream:
        while at + 8 <= size:
            stream.seek(at)
            name, length = struct.unpack("<4sI", stream.read(8))
            if name != b"RIFF" or length == 0:  # padding, or a recorder that was stopped
                return False
            at += 8 + length
    return at > size


def _matroska_duration_s(container: Any, stream: Any) -> float | None:
    """When the stream ends by its own tag, or by the file's header if there is no other stream."""
    parts = stream.metadata.get("DURATION", "").split(":")
    if len(parts) == 3:
        try:
            return int(parts[0]) * 3600 + int(parts[1]) * 60 + float(parts[2])
        except ValueError:
            return None
    if container.duration is not None and len(container.streams) == 1:
        return float(container.duration) / 1e6
    return None


def _rgb(frame: Any) -> NDArray[np.uint8]:
    return np.asarray(frame.to_ndarray(format="rgb24", interpolation=_EXACT))


def _luma(frame: Any) -> NDArray[np.uint8]:
    """Brightness, (h, w) uint8, as coded; a view of the decoder's memory where it can be."""
    layout = frame.format
    bits = layout.components[0].bits
    is_luma_first = layout.name in _LUMA_PLANE_8
    if is_luma_first and frame.planes[0].line_size >= frame.width:
        plane = frame.planes[0]
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        return rows[: frame.height, : frame.width]
    is_yuv = layout.name.startswith(("yuv", "gray")) and layout.name.endswith("le")
    if is_yuv and 8 < bits <= 16 and layout.is_planar | (len(layout.components) == 1):
        plane = frame.planes[0]
        rows = np.frombuffer(plane, "<u2").reshape(-1, plane.line_size // 2)
        wide = rows[: frame.height, : frame.width].astype(np.uint32)
        rounded = (wide + (1 << (bits - 9))) >> (bits - 8)
        return np.asarray(np.minimum(rounded, 255), dtype=np.uint8)
    if layout.is_rgb:
        return np.asarray(frame.to_ndarray(format="gray"))
    return _luma(frame.reformat(format="yuv420p"))  # packed or semi-planar: same range


def _turned(image: NDArray[Any], frame: Any) -> NDArray[Any]:
    """The picture as it is to be shown, by the quarter turns and flips beside it."""
    data = next((bytes(d) for d in frame.side_data if d.type.name == "DISPLAYMATRIX"), None)
    if data is None or len(data) < 36:
        return image
    # x' = a x + c y, y' = b x + d y; 16.16 fixed point, in the machine's order
    a, b, _, c, d = np.frombuffer(data, np.int32, count=5)
    if abs(int(a)) + abs(int(d)) >= abs(int(b)) + abs(int(c)):
        flip_x, flip_y, turned = a < 0, d < 0, image
    else:
        flip_x, flip_y, turned = c < 0, b < 0, image.swapaxes(0, 1)
    turned = turned[:: -1 if flip_y else 1, :: -1 if flip_x else 1]
    return image if turned is image else np.ascontiguousarray(turned)


class VideoWriter:
    """Writes a video that appears at `path` only if the ``with`` block succeeds.

    H.264 where this FFmpeg has an encoder for it, else VP9 (always for ``.webm``); 4:2:0, BT.709,
    limited range. MP4 files start to play before they are loaded whole.

    Parameters
    ----------
    path : Path
        ``.mp4``, ``.m4v``, ``.mov``, ``.mkv`` or ``.webm``.
    size : (width, height), px
        Both even: 4:2:0 has one colour for each 2x2 pixels.
    rate_hz : float or Fraction
    crf : int
        Quality, 0 (best) to 51; 18 is hard to tell from the source.
    max_bit_rate : int or None
        Bits per second that are not exceeded for longer than two seconds.
    preset : str
        x264's word for speed against size.
    gop : int or None
        Frames from key frame to key frame; 1 makes every frame one, for scrubbing.
    audio : Audio or None
        Sound that starts with the first frame; AAC, or Opus for ``.webm``. Written whole.
    codec : str or None
        An encoder by FFmpeg's name, instead of the choice above.

    Raises
    ------
    InputError
        If the size is odd, the suffix is not known, or no encoder is there; on leaving the block,
        if no frame was written.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        rate_hz: float | Fraction,
        *,
        crf: int = 18,
        max_bit_rate: int | None = None,
        preset: str = "veryfast",
        gop: int | None = None,
        audio: Audio | None = None,
        codec: str | None = None,
    ) -> None:
        width, height = (int(n) for n in size)
        if width < 2 or height < 2 or width % 2 or height % 2:
            raise InputError(
                f"{path}: a video needs an even width and height, got {width}x{height}: "
                "crop or pad the pictures by a pixel"
            )
        if path.suffix.lower() not in _CONTAINER_CODECS:
            known = ", ".join(_CONTAINER_CODECS)
            raise InputError(f"{path}: a video is written as one of {known}")
        rate = Fraction(rate_hz).limit_denominator(1001)
        if not 0 < rate <= 1000:
            raise ValueError(f"rate_hz must lie above 0 and at most at 1000, got {rate_hz}")
        self._path = path
        self._size = (width, height)
        self._rate = rate
        self._quality = _Quality(crf, max_bit_rate, preset, gop)
        self._audio = audio
        self._codec = codec
        self._stack: ExitStack | None = None
        self._n_frames = 0
        self._n_sound = 0

    def __enter__(self) -> VideoWriter:
        import av

        with ExitStack() as stack:
            part = stack.enter_context(atomic_path(self._path))
            layout, video_codecs, sound_codecs = _CONTAINER_CODECS[self._path.suffix.lower()]
            options = {"movflags": "+faststart"} if layout in ("mp4", "mov") else {}
            self._container = av.open(
                str(part), "w", format=layout, container_options=options or None
            )
            stack.callback(self._container.close)
            codec = self._codec or _available(self._path, video_codecs)
            self._stream = self._add_video(codec)
            self._sound = self._add_sound(sound_codecs) if self._audio is not None else None
            self._stack = stack.pop_all()
        return self

    def write(self, image: NDArray[np.uint8]) -> None:
        """Add one frame: (height, width, 3) uint8 RGB, or (height, width) uint8 gray."""
        if self._stack is None:
            raise ValueError("write to a VideoWriter inside its with block")
        width, height = self._size
        if image.dtype != np.uint8 or image.shape not in ((height, width), (height, width, 3)):
            raise ValueError(
                f"image must be ({height}, {width}) or ({height}, {width}, 3) uint8, "
                f"got {image.shape} {image.dtype}"
            )
        self._encode_picture(image)
        self._n_frames += 1
        self._encode_sound(until_s=float(self._n_frames / self._rate) + 0.5)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        stack, self._stack = self._stack, None
        assert stack is not None
        if error is not None:
            stack.__exit__(kind, error, traceback)  # closes and removes the file
            return
        with stack:  # closes the file, then lets it appear
            if not self._n_frames:
                raise InputError(f"{self._path}: no frame was written to the video")
            self._container.mux(self._stream.encode(None))
            self._encode_sound(until_s=math.inf)
            if self._sound is not None:
                self._container.mux(self._sound.encode(None))

    def _add_video(self, codec: str) -> Any:
        stream = self._container.add_stream(codec, rate=self._rate)
        stream.width, stream.height = self._size
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.time_base = 1 / self._rate
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = _LIMITED
        stream.options = self._quality.options(codec)
        if self._quality.gop is not None:
            stream.gop_size = self._quality.gop
        return stream

    def _add_sound(self, codecs: tuple[str, ...]) -> Any:
        assert self._audio is not None
        codec = _available(self._path, codecs)
        rates = _OPUS_RATES_HZ if codec == "libopus" else _AAC_RATES_HZ
        rate = self._audio.rate_hz if self._audio.rate_hz in rates else 48000
        return self._container.add_stream(codec, rate=rate, layout="mono")

    def _encode_picture(self, image: NDArray[np.uint8]) -> None:
        import av

        source = "gray" if image.ndim == 2 else "rgb24"
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), source)
        frame = frame.reformat(
            format="yuv420p",
            dst_color_range="MPEG",
            src_colorspace="ITU709",
            dst_colorspace="ITU709",
            interpolation=_EXACT,
        )
        frame.pts, frame.time_base = self._n_frames, 1 / self._rate
        self._container.mux(self._stream.encode(frame))

    def _encode_sound(self, until_s: float) -> None:
        import av

        if self._sound is None or self._audio is None:
            return
        samples, rate_hz = self._audio.samples, self._audio.rate_hz
        while self._n_sound < len(samples) and self._n_sound / rate_hz < until_s:
            block = samples[self._n_sound : self._n_sound + _SOUND_BLOCK]
            frame = av.AudioFrame.from_ndarray(block[None], format="fltp", layout="mono")
            frame.sample_rate, frame.pts = rate_hz, self._n_sound
            frame.time_base = Fraction(1, rate_hz)
            self._container.mux(self._sound.encode(frame))
            self._n_sound += len(block)


@dataclass(frozen=True)
class _Quality:
    crf: int
    max_bit_rate: int | None
    preset: str
    gop: int | None

    def options(self, codec: str) -> dict[str, str]:
        """The encoder's own words for the quality."""
        limit = {}
        if self.max_bit_rate is not None:
            limit = {"maxrate": str(self.max_bit_rate), "bufsize": str(2 * self.max_bit_rate)}
        if codec in ("libx264", "libx265"):
            return {"crf": str(self.crf), "preset": self.preset, **limit}
        if codec == "libvpx-vp9":
            speed = str(_VP9_SPEED.get(self.preset, 2))
            target = str(self.max_bit_rate or 0)  # 0: quality alone decides
            own = {"b": target, "deadline": "good" if int(speed) < 6 else "realtime"}
            return {"crf": str(self.crf), "cpu-used": speed, "row-mt": "1", **own, **limit}
        return limit


def _available(path: Path, codecs: tuple[str, ...]) -> str:
    """The first of the encoders that this machine's FFmpeg has."""
    import av

    for name in codecs:
        if name in av.codecs_available:
            return name
    raise InputError(f"{path}: FFmpeg has none of the encoders {', '.join(codecs)} here")
