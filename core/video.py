"""Video files in, one frame after the other; `video_writer` writes them.

Nothing here holds a whole video in memory. Decoding is the same to the bit for any number of
threads.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import FileFormatError
from .video_pixels import luma_of, rgb_of, turn_of

_MAX_PIXELS = 16384 * 16384
#: What opens as "video" but is none: pictures, text as ANSI art, lists of other files.
_NO_VIDEO_FORMATS = ("image2", "tty", "ico", "concat", "hls", "dash")
#: Containers whose index says where pictures of their own lie.
_INDEXED_FORMATS = frozenset(["mov", "mp4", "matroska", "webm"])
_SEEK_BEFORE_S = 1.0  # pictures after a seek may refer to ones before it
_STAMP_S = 5e-4  # half of a container's millisecond
_SAMPLE_EVERY = 7  # frames; lamps flicker with even numbers of them


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
        height, width = turn_of(first)(np.empty((first.height, first.width))).shape
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
    path: Path, *, gray: bool = False, threads: int = 0, from_s: float = 0.0
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
    from_s : float, s
        Begin with the first frame at or after this time; its index is 0, while times are still
        those from the start of the file. What lies before is skipped over if the container has
        an index, else decoded and dropped.

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
        last_s, size = -math.inf, (0, 0)
        start_s = _sought(path, container, stream, from_s) if from_s > 0 else None
        n_skipped = 0
        for count, (decoded, time_s) in enumerate(
            _decoded(path, container, stream, sought=start_s is not None)
        ):
            if time_s is None:  # raw streams have no clock
                if not rate:
                    raise FileFormatError(path, f"frame {count}", "a time stamp or rate", "neither")
                time_s = count / float(rate)
            if start_s is None:
                start_s = time_s
            if from_s > 0 and time_s - start_s < from_s - _STAMP_S:
                n_skipped += 1
                continue
            index = count - n_skipped
            if index == 0:
                size, turned = (decoded.width, decoded.height), turn_of(decoded)
            if (decoded.width, decoded.height) != size:
                found = f"{decoded.width}x{decoded.height}"
                raise FileFormatError(path, f"frame {index}", f"{size[0]}x{size[1]}", found)
            if time_s <= last_s:
                expected = f"a time stamp after {last_s - start_s:.6f} s"
                raise FileFormatError(path, f"frame {index}", expected, f"{time_s - start_s:.6f} s")
            last_s = time_s
            image = turned(luma_of(decoded) if gray else rgb_of(decoded))
            image.flags.writeable = False
            yield Frame(index, time_s - start_s, image)


def sample_frames(path: Path, count: int, *, gray: bool = False) -> list[Frame]:
    """Some pictures spread over a video, cheaply: those that can be decoded by themselves.

    Of a file without an index, or with one such picture only, they are from its first seconds.

    Parameters
    ----------
    path : Path
    count : int
        How many, if there are so many.
    gray : bool
        As `read_frames`; pictures are copies.

    Returns
    -------
    list of Frame
        In order of time, at least one; `index` counts them.

    Raises
    ------
    FileFormatError, OSError
        As `read_frames`.
    """
    with open_container(path) as container:
        stream = _video_stream(path, container)
        stream.thread_type = "AUTO"
        found = list(_key_frames(path, container, stream, count, gray))
    if len(found) >= min(count, 4):
        return [Frame(i, t, image) for i, (t, image) in enumerate(found)]
    early: list[Frame] = []
    with closing(read_frames(path, gray=gray)) as frames:
        for frame in frames:
            if frame.index % _SAMPLE_EVERY == 0:
                early.append(Frame(len(early), frame.time_s, np.array(frame.image)))
            if len(early) == count:
                break
    return early


def _key_frames(
    path: Path, container: Any, stream: Any, count: int, gray: bool
) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Time from the first frame, and picture, of up to `count` pictures that seeking finds."""
    first, start_s = next(_decoded(path, container, stream))
    turned = turn_of(first)
    length_s = float(stream.duration * stream.time_base) if stream.duration else 0.0
    if start_s is None or not set(container.format.name.split(",")) & _INDEXED_FORMATS:
        return
    if not length_s and container.duration:
        length_s = container.duration / 1e6
    last_s = -math.inf
    for i in range(count):
        container.seek(
            math.floor((start_s + length_s * i / count) / stream.time_base), stream=stream
        )
        decoded, time_s = next(_decoded(path, container, stream, sought=True))
        if time_s is not None and time_s > last_s:
            last_s = time_s
            image = turned(luma_of(decoded) if gray else rgb_of(decoded))
            yield time_s - start_s, np.array(image)


def _sought(path: Path, container: Any, stream: Any, from_s: float) -> float | None:
    """Go to a picture before a time that can be decoded by itself; the time of the first frame.

    None, and still at the start, where the container has no index that can be trusted.
    """
    if not set(container.format.name.split(",")) & _INDEXED_FORMATS:
        return None
    decoded = _decoded(path, container, stream)
    _, start_s = next(decoded)
    decoded.close()
    before_s = -math.inf if start_s is None else start_s + from_s - _SEEK_BEFORE_S
    if start_s is None or before_s <= start_s:
        container.seek(0)
        return None
    container.seek(math.floor(before_s / stream.time_base), stream=stream)
    return float(start_s)


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


def _decoded(
    path: Path, container: Any, stream: Any, *, sought: bool = False
) -> Generator[tuple[Any, float | None], None, None]:
    """Decoded frames and their times; at least one, and never fewer than promised: or an error.

    Where the middle of the file was sought, the first pictures may lack those they refer to: they
    are left out; and nobody counts how many come.
    """
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
                if last.is_corrupt and sought and n_frames == 0:
                    continue
                if last.is_corrupt:
                    raise av.InvalidDataError(0, "damaged data")
                yield timed(last)
                n_frames += 1
        if not problem and not sought and not _is_whole(path, container, stream, n_packets):
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
