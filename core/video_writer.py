"""Video files out, one frame after the other; `video` reads them.

Nothing here holds a whole video in memory.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .audio import Audio
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
            interpolation=EXACT_SCALING,
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
