"""Sound: one channel of samples with its rate."""

from __future__ import annotations

import logging
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from .arrays import readonly
from .errors import FileFormatError, InputError
from .files import atomic_path

#: Longer sound is refused before it fills the memory: 93 minutes at 48 kHz.
MAX_SAMPLES = 2**28
_MAX_RATE_HZ = 768_000
_BLOCK_FRAMES = 65536
#: RIFF sizes of writers that could not go back and fill them in.
_UNKNOWN_RIFF_SIZES = (0, 0x7FFFFFFF, 0x7FFFF000, 0xFFFFFFFF)

_WRITE_BLOCK = 1 << 18

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Audio:
    """One channel of sound.

    Attributes
    ----------
    samples : (n,) float32, in [-1, 1]
    rate_hz : int
    """

    samples: NDArray[np.float32]
    rate_hz: int

    def __post_init__(self) -> None:
        samples = readonly(self.samples, (None,), "samples", np.float32)
        if not np.isfinite(samples).all() or (len(samples) and np.abs(samples).max() > 1):
            raise ValueError("samples must be finite and lie in [-1, 1]")
        if not 0 < int(self.rate_hz) <= _MAX_RATE_HZ:
            raise ValueError(f"rate_hz must lie in 1..{_MAX_RATE_HZ}, got {self.rate_hz}")
        object.__setattr__(self, "samples", samples)
        object.__setattr__(self, "rate_hz", int(self.rate_hz))

    @property
    def duration_s(self) -> float:
        """Length, s."""
        return len(self.samples) / self.rate_hz


class SoundTrack(Protocol):
    """Sound that need not lie in memory: `Audio`, or what computes samples when they are sliced."""

    @property
    def samples(self) -> Any:
        """Has a length; ``samples[a:b]`` is (b − a,) float32 in [-1, 1]."""

    @property
    def rate_hz(self) -> int:
        """Samples a second."""


def read_audio(path: Path) -> Audio:
    """Read a sound file, or the sound track of a video, as one channel (the channels' mean).

    WAV, FLAC, OGG, MP3 and more through libsndfile; anything else through FFmpeg. A video's sound
    starts with its first picture: silence is put before a track that starts later, and what comes
    earlier is cut off. Samples of float files beyond ±1 are clipped, and that is logged.

    Raises
    ------
    FileFormatError
        If there is no sound in the file, it is cut off, or holds NaN.
    OSError
        If it cannot be read.
    """
    import soundfile

    if path.stat().st_size == 0:
        raise FileFormatError(path, "file", "a sound file", "an empty file")
    with open(path, "rb") as stream:
        _check_riff(path, stream)
        _check_ogg(path, stream)
    try:
        opened = soundfile.SoundFile(str(path))
    except soundfile.LibsndfileError:
        return _read_track(path)
    with opened:
        samples = _read_blocks(path, opened)
        return _checked(path, samples, int(opened.samplerate))


def write_audio(path: Path, audio: SoundTrack) -> None:
    """Write a 16-bit WAV file: samples to the nearest 1/32768, +1 as 32767/32768."""
    import soundfile

    if path.suffix.lower() not in (".wav", ".wave"):
        raise InputError(f"{path}: sound is written as WAV; give the file the suffix .wav")
    with atomic_path(path) as part, open(part, "wb") as stream:
        with soundfile.SoundFile(
            stream, "w", audio.rate_hz, channels=1, subtype="PCM_16", format="WAV"
        ) as out:
            for start in range(0, len(audio.samples), _WRITE_BLOCK):
                block = audio.samples[start : start + _WRITE_BLOCK].astype(np.float64)
                out.write(np.clip(np.rint(block * 32768), -32768, 32767).astype(np.int16))
        stream.flush()
        os.fsync(stream.fileno())


def _check_riff(path: Path, stream: BinaryIO) -> None:
    """libsndfile takes what is there of a WAV or AIFF file for the whole; do not."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    form, kind = stream.read(8), stream.read(4)
    if form[:4] == b"FORM" and kind in (b"AIFF", b"AIFC"):
        (length,) = struct.unpack(">I", form[4:])
        if 8 + length > size:
            raise FileFormatError(path, "file", f"{8 + length} bytes", f"{size} (cut off)")
    if form[:4] != b"RIFF" or kind != b"WAVE":
        return
    at = 12
    while at + 8 <= size:
        stream.seek(at)
        name, length = struct.unpack("<4sI", stream.read(8))
        is_unknown = name == b"data" and length in _UNKNOWN_RIFF_SIZES
        if at + 8 + length > size and not is_unknown:
            what = name.decode("latin-1").strip()
            expected = f"{length} bytes of {what}"
            raise FileFormatError(path, f"byte {at + 8}", expected, f"{size - at - 8} (cut off)")
        if name == b"data":
            return
        at += 8 + length + length % 2
    raise FileFormatError(path, "file", "sound data", "none (cut off)")


def _check_ogg(path: Path, stream: BinaryIO) -> None:
    """A whole OGG file ends with a page that is marked as the last of its stream."""
    stream.seek(0)
    if stream.read(4) != b"OggS":
        return
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - 2 * 65536))
    tail = stream.read()
    page = tail[max(0, tail.rfind(b"OggS")) :]
    if len(page) >= 27 and len(page) >= 27 + page[26] and page[5] & 4:
        lengths = page[27 : 27 + page[26]]
        if len(page) >= 27 + len(lengths) + sum(lengths):
            return
    raise FileFormatError(path, "the end", "the last page of the sound", "none (cut off)")


def _read_blocks(path: Path, opened: Any) -> NDArray[np.float32]:
    """All frames of an open file, averaged over its channels."""
    import soundfile

    promised = _promised_frames(path, opened)
    blocks: list[NDArray[np.float32]] = []
    n_frames = 0
    while True:
        try:
            block = opened.read(_BLOCK_FRAMES, dtype="float32", always_2d=True)
        except soundfile.LibsndfileError as error:
            where = f"sample {n_frames}"
            raise FileFormatError(path, where, "sound", f"damaged data ({error})") from error
        if not len(block):
            break
        blocks.append(block.mean(axis=1, dtype=np.float32))
        n_frames += len(block)
        _check_length(path, n_frames)
    if n_frames < promised:
        raise FileFormatError(
            path, f"sample {n_frames}", f"{promised} samples", "the end (cut off)"
        )
    return np.concatenate(blocks) if blocks else np.zeros(0, np.float32)


def _promised_frames(path: Path, opened: Any) -> int:
    """How many frames an open file must have at least."""
    promised = int(opened.frames)
    if promised >= 2**62:  # libsndfile's mark for streams of no known length
        return 0
    if opened.format not in ("MP3", "MPEG"):
        return promised
    with open(path, "rb") as stream:
        head = stream.read(65536)
    if not any(tag in head for tag in (b"Xing", b"Info", b"VBRI")):
        return 0  # an estimate from the size of the file
    return promised - 1152  # some count the tag's own block too


def _check_length(path: Path, n_samples: int) -> None:
    if n_samples > MAX_SAMPLES:
        raise FileFormatError(path, "file", f"at most {MAX_SAMPLES} samples", "more")


def _checked(path: Path, samples: NDArray[np.float32], rate_hz: int) -> Audio:
    if not len(samples):
        raise FileFormatError(path, "file", "sound", "no samples")
    if not 0 < rate_hz <= _MAX_RATE_HZ:
        expected = f"a rate of 1 to {_MAX_RATE_HZ} Hz"
        raise FileFormatError(path, "header", expected, str(rate_hz))
    broken = np.flatnonzero(~np.isfinite(samples))
    if len(broken):
        found = str(samples[broken[0]])
        raise FileFormatError(path, f"sample {broken[0]}", "a finite number", found)
    peak = float(np.abs(samples).max())
    if peak > 1:
        _log.warning("%s: samples reach %.3g, clipped to 1", path, peak)
        samples = np.clip(samples, -1, 1)
    return Audio(samples, rate_hz)


def _read_track(path: Path) -> Audio:
    """The sound track of a video."""
    import av

    from .video import open_container

    with open_container(path, "a sound file, or a video with sound") as container:
        if not container.streams.audio:
            raise FileFormatError(path, "file", "a sound track", "none")
        stream = container.streams.audio[0]
        to_planar_floats = av.AudioResampler(format="fltp")
        blocks: list[NDArray[np.float32]] = []
        n_samples, start_s = 0, 0.0
        try:
            for packet in container.demux(stream):
                if packet.is_corrupt:
                    where = f"sample {n_samples}"
                    raise FileFormatError(path, where, "more sound", "the end (cut off)")
                for decoded in packet.decode():
                    if not blocks and decoded.time is not None:
                        start_s = float(decoded.time)
                    for frame in to_planar_floats.resample(decoded):
                        blocks.append(frame.to_ndarray().mean(axis=0, dtype=np.float32))
                        n_samples += len(blocks[-1])
                    _check_length(path, n_samples)
        except av.FFmpegError as error:
            where = f"sample {n_samples}"
            raise FileFormatError(path, where, "sound", f"damaged data ({error})") from error
        rate_hz = int(stream.rate)
        samples = np.concatenate(blocks) if blocks else np.zeros(0, np.float32)
        lead = round((start_s - _first_picture_s(container)) * rate_hz)
        _check_length(path, n_samples + max(lead, 0))
        if lead > 0:
            samples = np.concatenate([np.zeros(lead, np.float32), samples])
        return _checked(path, samples[max(0, -lead) :], rate_hz)


def _first_picture_s(container: Any) -> float:
    """When the video starts on the container's clock; 0 if there is none."""
    for stream in container.streams.video:
        if stream.start_time is not None and stream.time_base is not None:
            return float(stream.start_time * stream.time_base)
    return 0.0
