"""Sound files and sound tracks."""

from __future__ import annotations

import logging
import struct
import wave
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
import soundfile
from numpy.typing import NDArray

from facewright.core.audio import Audio, read_audio, write_audio
from facewright.core.errors import FileFormatError, InputError
from facewright.core.video_writer import VideoWriter

RATE = 16_000


def tone(seconds: float = 1.0, rate_hz: int = RATE) -> NDArray[np.float32]:
    """A sweep: no part of it is like another."""
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    return (0.5 * np.sin(2 * np.pi * (200 + 400 * t) * t)).astype(np.float32)


@pytest.mark.parametrize("rate_hz", [8000, 16_000, 44_100, 48_000, 96_000])
def test_what_is_written_reads_back(tmp_path: Path, rate_hz: int) -> None:
    audio = Audio(tone(0.5, rate_hz), rate_hz)
    write_audio(tmp_path / "a.wav", audio)
    found = read_audio(tmp_path / "a.wav")
    assert found.rate_hz == rate_hz
    assert found.duration_s == 0.5
    np.testing.assert_allclose(found.samples, audio.samples, atol=0.5 / 32768)
    write_audio(tmp_path / "b.wav", found)  # 16-bit samples are exact
    assert (tmp_path / "a.wav").read_bytes() == (tmp_path / "b.wav").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_full_scale_neither_wraps_nor_shrinks(tmp_path: Path) -> None:
    write_audio(tmp_path / "a.wav", Audio(np.array([1, -1, 0], np.float32), RATE))
    with wave.open(str(tmp_path / "a.wav")) as peer:
        assert (peer.getnchannels(), peer.getsampwidth(), peer.getframerate()) == (1, 2, RATE)
        assert struct.unpack("<3h", peer.readframes(3)) == (32767, -32768, 0)


@pytest.mark.parametrize(
    ("suffix", "subtype", "tolerance"),
    [
        (".wav", "PCM_16", 2**-15),
        (".wav", "PCM_24", 2**-23),
        (".wav", "FLOAT", 0),
        (".flac", "PCM_16", 2**-15),
        (".ogg", "VORBIS", 0.05),
        (".mp3", None, 0.05),
    ],
)
def test_formats_are_read_and_mixed_to_one_channel(
    tmp_path: Path, suffix: str, subtype: str | None, tolerance: float
) -> None:
    left = tone()
    stereo = np.stack([left, 0.5 * left], axis=1)
    path = tmp_path / f"a{suffix}"
    soundfile.write(path, stereo, RATE, subtype)

    found = read_audio(path)

    assert found.rate_hz == RATE and found.samples.dtype == np.float32
    assert abs(len(found.samples) - len(left)) < 3000 if suffix == ".mp3" else True
    n = min(len(found.samples), len(left))
    expected = stereo.mean(axis=1)[:n]
    # codecs err at the ends: judge the middle
    middle = slice(n // 8, -n // 8)
    np.testing.assert_allclose(found.samples[:n][middle], expected[middle], atol=tolerance + 1e-7)


@pytest.mark.parametrize("suffix", [".mp4", ".webm", ".mkv"])
@pytest.mark.parametrize("rate_hz", [16_000, 20_000, 48_000])
def test_the_sound_track_of_a_video_is_in_step(tmp_path: Path, suffix: str, rate_hz: int) -> None:
    sound = tone(1.2, rate_hz)
    path = tmp_path / f"a{suffix}"
    with VideoWriter(path, (32, 32), 25, audio=Audio(sound, rate_hz)) as writer:
        for _ in range(30):
            writer.write(np.zeros((32, 32, 3), np.uint8))

    found = read_audio(path)

    # line up by correlation, on a common rate
    t = np.arange(0.1, 1.1, 1 / 48_000)
    want = np.interp(t, np.arange(len(sound)) / rate_hz, sound)

    def likeness(shift_s: float) -> float:
        times = np.arange(len(found.samples)) / found.rate_hz
        got = np.interp(t + shift_s, times, found.samples)
        return float(np.corrcoef(want, got)[0, 1])

    shifts = np.linspace(-5e-3, 5e-3, 101)
    best = shifts[int(np.argmax([likeness(s) for s in shifts]))]
    assert abs(best) <= 3e-4, f"{best * 1000:.2f} ms out of step"
    assert likeness(best) > 0.99
    assert found.duration_s == pytest.approx(1.2, abs=0.14)


@pytest.mark.parametrize("late_s", [0.25, 0.0])
def test_a_track_that_starts_late_is_led_by_silence(tmp_path: Path, late_s: float) -> None:
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        video = container.add_stream("libvpx-vp9", rate=25)
        video.width = video.height = 32
        video.pix_fmt = "yuv420p"
        sound = container.add_stream("pcm_s16le", rate=RATE, layout="mono")
        for n in range(25):
            frame = av.VideoFrame(32, 32, "yuv420p")
            frame.pts, frame.time_base = n, Fraction(1, 25)
            container.mux(video.encode(frame))
        samples = (tone(0.5) * 32767).astype(np.int16)
        block = av.AudioFrame.from_ndarray(samples[None], format="s16", layout="mono")
        block.sample_rate, block.pts = RATE, int(late_s * RATE)
        block.time_base = Fraction(1, RATE)
        container.mux(sound.encode(block))
        container.mux(video.encode(None))
        container.mux(sound.encode(None))

    found = read_audio(path)

    lead = int(late_s * RATE)
    assert len(found.samples) == lead + len(samples)
    assert not found.samples[:lead].any()
    np.testing.assert_allclose(found.samples[lead:] * 32768, samples, atol=1)


@pytest.mark.parametrize("suffix", [".wav", ".flac", ".ogg", ".mp3", ".aiff"])
@pytest.mark.parametrize("keep", [0.0, 0.001, 0.3, 0.9, 0.99])
def test_cut_files_are_refused(tmp_path: Path, suffix: str, keep: float) -> None:
    if suffix == ".mp3":
        keep = min(keep, 0.9)  # of an MP3 the last block may lack
    path = tmp_path / f"a{suffix}"
    soundfile.write(path, tone(3), RATE)
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(FileFormatError) as caught:
        read_audio(path)
    assert str(caught.value).startswith(str(path))


def test_an_mp3_without_a_promise_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    """Without the tag that counts its blocks, its length is a guess."""
    path = tmp_path / "a.mp3"
    soundfile.write(path, tone(3), RATE)
    path.write_bytes(path.read_bytes()[1000:])  # from somewhere in the stream
    assert 2.5 < read_audio(path).duration_s < 3


def test_a_cut_sound_track_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with VideoWriter(path, (32, 32), 25, audio=Audio(tone(5), RATE)) as writer:
        for _ in range(125):
            writer.write(np.zeros((32, 32, 3), np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
    with pytest.raises(FileFormatError, match=r"sample \d+: expected more sound.*cut off"):
        read_audio(path)


@pytest.mark.parametrize("length", [0, 0xFFFFFFFF])
def test_wav_files_of_streaming_writers_are_whole(tmp_path: Path, length: int) -> None:
    path = tmp_path / "a.wav"
    write_audio(path, Audio(tone(), RATE))
    data = bytearray(path.read_bytes())
    at = data.index(b"data") + 4
    data[at : at + 4] = struct.pack("<I", length)
    path.write_bytes(data)
    if length == 0:
        with pytest.raises(FileFormatError, match="no samples"):
            read_audio(path)
    else:
        assert len(read_audio(path).samples) == RATE


def test_a_lying_header_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    write_audio(path, Audio(tone(), RATE))
    data = bytearray(path.read_bytes())
    at = data.index(b"data") + 4
    data[at : at + 4] = struct.pack("<I", 0x70000000)
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="expected 1879048192 bytes of data, found 32000"):
        read_audio(path)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_broken_numbers_name_their_sample(tmp_path: Path, bad: float) -> None:
    samples = tone()
    samples[123] = bad
    soundfile.write(tmp_path / "a.wav", samples, RATE, "FLOAT")
    with pytest.raises(FileFormatError, match="sample 123: expected a finite number"):
        read_audio(tmp_path / "a.wav")


def test_samples_beyond_full_scale_are_clipped_and_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    soundfile.write(tmp_path / "a.wav", 4 * tone(), RATE, "FLOAT")
    with caplog.at_level(logging.WARNING):
        found = read_audio(tmp_path / "a.wav")
    assert np.abs(found.samples).max() == 1
    assert "samples reach 2, clipped to 1" in caplog.text


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.wav", b"", "an empty file"),
        ("a.wav", b"hello, this is text\n" * 20, "expected a sound file, or a video with sound"),
        ("a.wav", b"RIFF\x04\0\0\0WAVE", "sound data"),
        ("a.ogg", b"OggS" + bytes(100), "the last page"),
        ("a.flac", b"fLaC" + bytes(100), "sound"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FileFormatError, match=message):
        read_audio(tmp_path / name)


def test_a_video_without_sound_and_a_file_without_samples_are_refused(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "a.mp4", (32, 32), 25) as writer:
        writer.write(np.zeros((32, 32, 3), np.uint8))
    with pytest.raises(FileFormatError, match="expected a sound track, found none"):
        read_audio(tmp_path / "a.mp4")
    soundfile.write(tmp_path / "a.wav", np.zeros(0), RATE)
    with pytest.raises(FileFormatError, match="no samples"):
        read_audio(tmp_path / "a.wav")
    with pytest.raises(FileNotFoundError):
        read_audio(tmp_path / "none.wav")


def test_sound_is_written_as_wav_only(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the suffix \.wav"):
        write_audio(tmp_path / "a.mp3", Audio(tone(), RATE))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("samples", "rate_hz", "message"),
    [
        (np.zeros((2, 2)), RATE, "shape"),
        (np.array([2.0]), RATE, r"lie in \[-1, 1\]"),
        (np.array([np.nan]), RATE, "finite"),
        (np.zeros(3), 0, "rate_hz"),
    ],
)
def test_sound_that_cannot_be_is_refused(
    samples: NDArray[np.float64], rate_hz: int, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Audio(samples.astype(np.float32), rate_hz)


def test_real_recordings_are_read(real_data: Path) -> None:
    files = sorted((real_data / "speech").rglob("*.wav"))
    assert files
    for path in files[:: max(1, len(files) // 12)]:
        expected, rate_hz = soundfile.read(path, dtype="float32", always_2d=True)
        found = read_audio(path)
        assert found.rate_hz == rate_hz
        np.testing.assert_allclose(found.samples, expected.mean(axis=1), atol=1e-7)
