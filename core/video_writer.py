"""Video files out, one frame after the other; `video` reads them.

Nothing here holds a whole video in memory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .audio import SoundTrack
from .errors import InputError
from .files import atomic_path
from .video_pixels import EXACT_SCALING

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
_BT709, _LIMITED = 1, 1  # AVCOL_SPC_BT709 (also primaries and transfer), AVCOL_RANGE_MPEG


class VideoWriter:
    """Writes a video that appears at `path` only if the ``with`` block succeeds.

    H.264 where this FFmpeg has an encoder for it, else VP9 (always for ``.webm``); 4:2:0, BT.709,
    limited range. MP4 files start to play before they are loaded whole. Lossless video is FFV1,
    gray or RGB as the first picture is, full range.

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
    audio : SoundTrack or None
        An `Audio`, for example, that starts with the first frame; AAC, or Opus for ``.webm``.
        Written whole.
    codec : str or None
        An encoder by FFmpeg's name, instead of the choice above.
    lossless : bool
        Every pixel comes back as it was; for ``.mkv``.
    time_base : Fraction or None, s
        What time stamps are multiples of, if not of the time between frames.
    reproducible : bool
        The same pictures give the same bytes; and bits go where there is contrast rather than
        into even areas, where a sensor's noise would take them.

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
        audio: SoundTrack | None = None,
        codec: str | None = None,
        lossless: bool = False,
        time_base: Fraction | None = None,
        reproducible: bool = False,
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
        if lossless and path.suffix.lower() != ".mkv":
            raise InputError(f"{path}: lossless video is written as .mkv")
        rate = Fraction(rate_hz).limit_denominator(1001)
        if not 0 < rate <= 1000:
            raise ValueError(f"rate_hz must lie above 0 and at most at 1000, got {rate_hz}")
        self._path = path
        self._size = (width, height)
        self._rate = rate
        self._quality = _Quality(crf, max_bit_rate, preset, gop, reproducible)
        self._audio = audio
        self._codec = "ffv1" if lossless else codec
        self._lossless = lossless
        self._time_base = 1 / rate if time_base is None else time_base
        self._stack: ExitStack | None = None
        self._n_frames = 0
        self._last_pts = -1

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
            self._sound = (
                None
                if self._audio is None
                else _Sound(self._container, self._path, sound_codecs, self._audio)
            )
            self._stack = stack.pop_all()
        return self

    def write(self, image: NDArray[np.uint8], time_s: float | None = None) -> None:
        """Add one frame.

        Parameters
        ----------
        image : (height, width, 3) uint8 RGB, or (height, width) uint8 gray
        time_s : float, optional
            Its time stamp, from the start of the file, rounded to the time base; later than the
            frame before. By default one frame after that.
        """
        if self._stack is None:
            raise ValueError("write to a VideoWriter inside its with block")
        step = 1 / self._rate / self._time_base
        pts = round(self._n_frames * step) if time_s is None else round(time_s / self._time_base)
        if pts <= self._last_pts:
            raise ValueError(f"time stamps must grow, got {time_s} s")
        width, height = self._size
        if image.dtype != np.uint8 or image.shape not in ((height, width), (height, width, 3)):
            raise ValueError(
                f"image must be ({height}, {width}) or ({height}, {width}, 3) uint8, "
                f"got {image.shape} {image.dtype}"
            )
        self._encode_picture(image, pts)
        self._last_pts = pts
        self._n_frames += 1
        if self._sound is not None:
            self._sound.encode(float(pts * self._time_base) + 0.5)

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
            if self._sound is not None:
                self._sound.encode(math.inf)
                self._sound.close()

    def _add_video(self, codec: str) -> Any:
        stream = self._container.add_stream(codec, rate=self._rate)
        stream.width, stream.height = self._size
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.time_base = self._time_base
        if not self._lossless:
            context.colorspace = context.color_primaries = context.color_trc = _BT709
            context.color_range = _LIMITED
            stream.options = self._quality.options(codec)
        if self._quality.gop is not None:
            stream.gop_size = self._quality.gop
        return stream

    def _encode_picture(self, image: NDArray[np.uint8], pts: int) -> None:
        import av

        source = "gray" if image.ndim == 2 else "rgb24"
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), source)
        if self._lossless:
            if self._n_frames == 0:
                self._stream.pix_fmt = "gray" if image.ndim == 2 else "bgr0"
            frame = frame.reformat(format=self._stream.pix_fmt)
        else:
            frame = frame.reformat(
                format="yuv420p",
                dst_color_range="MPEG",
                src_colorspace="ITU709",
                dst_colorspace="ITU709",
                interpolation=EXACT_SCALING,
            )
        frame.pts, frame.time_base = pts, self._time_base
        self._container.mux(self._stream.encode(frame))


def join_videos(
    parts: Sequence[Path],
    path: Path,
    *,
    starts_s: Sequence[float],
    audio: SoundTrack | None = None,
    rotation_deg: int = 0,
) -> None:
    """Put videos of one encoder and size one after another, without encoding anew.

    Parameters
    ----------
    parts : sequence of Path
        Videos without sound, as `VideoWriter` wrote them with equal settings.
    path : Path
        Appears only if all went well.
    starts_s : sequence of float, s
        When each part starts.
    audio : SoundTrack, optional
        Sound that starts at 0 s.
    rotation_deg : int
        0, 90, 180 or 270: players turn the pictures by it, counter-clockwise.
    """
    import av

    layout, _, sound_codecs = _CONTAINER_CODECS[path.suffix.lower()]
    options = {"movflags": "+faststart"} if layout in ("mp4", "mov") else {}
    with ExitStack() as stack:
        part = stack.enter_context(atomic_path(path))
        out = stack.enter_context(av.open(str(part), "w", format=layout, container_options=options))
        sources = [stack.enter_context(av.open(f"file:{p}")) for p in parts]
        first = sources[0].streams.video[0]
        stream = out.add_stream_from_template(first)
        stream.time_base = first.time_base
        if rotation_deg:
            stream.set_display_rotation(rotation_deg)
        sound = _Sound(out, path, sound_codecs, audio) if audio is not None else None
        last = -(2**62)
        for source, start_s in zip(sources, starts_s, strict=True):
            video = source.streams.video[0]
            shift = round(Fraction(start_s).limit_denominator(10**6) / video.time_base)
            for packet in source.demux(video):
                if packet.size and packet.dts is not None:
                    # decoding may begin before the part does: not before the last part's end
                    packet.dts = last = max(packet.dts + shift, last + 1)
                    packet.pts += shift
                    packet.stream = stream
                    out.mux(packet)
                    if sound is not None:
                        sound.encode(float(packet.pts * video.time_base) + 0.5)
        if sound is not None:
            sound.encode(math.inf)
            sound.close()


class _Sound:
    """The sound of a file that is written, in step with its pictures."""

    def __init__(
        self, container: Any, path: Path, codecs: tuple[str, ...], audio: SoundTrack
    ) -> None:
        codec = _available(path, codecs)
        rates = _OPUS_RATES_HZ if codec == "libopus" else _AAC_RATES_HZ
        rate = audio.rate_hz if audio.rate_hz in rates else 48000
        self._container, self._audio, self._done = container, audio, 0
        self._stream = container.add_stream(codec, rate=rate, layout="mono")

    def encode(self, until_s: float) -> None:
        """Write what is heard before a time."""
        import av

        samples, rate_hz = self._audio.samples, self._audio.rate_hz
        while self._done < len(samples) and self._done / rate_hz < until_s:
            block = samples[self._done : self._done + _SOUND_BLOCK]
            frame = av.AudioFrame.from_ndarray(block[None], format="fltp", layout="mono")
            frame.sample_rate, frame.pts = rate_hz, self._done
            frame.time_base = Fraction(1, rate_hz)
            self._container.mux(self._stream.encode(frame))
            self._done += len(block)

    def close(self) -> None:
        """Write what the encoder still holds."""
        self._container.mux(self._stream.encode(None))


@dataclass(frozen=True)
class _Quality:
    crf: int
    max_bit_rate: int | None
    preset: str
    gop: int | None
    reproducible: bool

    def options(self, codec: str) -> dict[str, str]:
        """The encoder's own words for the quality."""
        limit = {}
        if self.max_bit_rate is not None:
            limit = {"maxrate": str(self.max_bit_rate), "bufsize": str(2 * self.max_bit_rate)}
        if codec in ("libx264", "libx265"):
            # with a rate limit and several threads, x264's choices depend on their timing
            params = {"x264-params": "mbtree=0:aq-mode=0:threads=1:lookahead-threads=1"}
            same = params if self.reproducible and codec == "libx264" else {}
            return {"crf": str(self.crf), "preset": self.preset, **same, **limit}
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
