"""What lies between a mouth and a recording: a room, noise, a microphone, a telephone line.

References
----------
Allen & Berkley, Image method for efficiently simulating small-room acoustics, JASA 65(4), 1979.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, resample_poly, sosfilt, sosfiltfilt

from ..core.errors import InputError
from .voice_talkers import SOUND_MM_PER_S

NOISE_COLOURS = ("white", "pink", "brown")
TELEPHONE_BAND_HZ = (300.0, 3400.0)
_TELEPHONE_RATE_HZ = 8000
_MU = 255.0  # ITU-T G.711
_SIZE_MM = ((2800.0, 7000.0), (2500.0, 6000.0), (2300.0, 3400.0))
_WALL_MM = 400.0  # nobody stands nearer to a wall
_MAX_RT60_S = 3.0
_DECAY_ROUNDS = 3  # Eyring's formula is short by half where walls are even: corrected for


@dataclass(frozen=True)
class RoomSettings:
    """A room and how far the microphone is.

    Attributes
    ----------
    rt60_s : float
        Time in which sound decays by 60 dB.
    distance_mm : float
        From mouth to microphone.
    """

    rt60_s: float = 0.4
    distance_mm: float = 1000.0

    def __post_init__(self) -> None:
        if not 0.05 <= self.rt60_s <= _MAX_RT60_S:
            raise ValueError(f"rt60_s must lie in 0.05..{_MAX_RT60_S}, got {self.rt60_s}")
        if not 50 <= self.distance_mm <= 2000:
            raise ValueError(f"distance_mm must lie in 50..2000, got {self.distance_mm}")


def random_room(rng: np.random.Generator) -> RoomSettings:
    """From a booth to a hall's corner."""
    return RoomSettings(float(rng.uniform(0.15, 0.8)), float(rng.uniform(300, 1800)))


def room_response(
    room: RoomSettings, rate_hz: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Impulse response of a box of random size, (n,) float64.

    The direct sound is sample 0 with height 1: the time of flight is taken out, so that what was
    true of the clean sound's times stays true. Echoes fall between samples by linear interpolation.
    """
    size = np.array([rng.uniform(low, high) for low, high in _SIZE_MM])
    mouth = rng.uniform(_WALL_MM, size - _WALL_MM)
    microphone_at = _place_apart(mouth, size, room.distance_mm, rng)
    distance = float(np.linalg.norm(microphone_at - mouth))
    n = int(room.rt60_s * 1.1 * rate_hz) + 2
    nominal_s = room.rt60_s
    h = np.zeros(n)
    for _ in range(_DECAY_ROUNDS):
        reflection = _wall_reflection(size, nominal_s)
        h = _images(size, mouth, microphone_at, reflection, n, rate_hz / SOUND_MM_PER_S, distance)
        nominal_s *= room.rt60_s / _decay_s(h, rate_hz)
    return np.asarray(h, dtype=np.float64)


def add_noise(
    sound: NDArray[np.float64],
    snr_db: float,
    rng: np.random.Generator,
    *,
    is_speech: NDArray[np.bool_] | None = None,
    colour: str = "pink",
) -> NDArray[np.float64]:
    """`sound` with steady noise throughout, (n,) float64.

    Parameters
    ----------
    sound : (n,) float
    snr_db : float
        Power of the sound where `is_speech` (default: everywhere) over the power of the noise.
    colour : str
        white, pink (1/f) or brown (1/f²).

    Raises
    ------
    InputError
        If the sound is silent.
    """
    if colour not in NOISE_COLOURS:
        raise ValueError(f"colour must be one of {', '.join(NOISE_COLOURS)}, got {colour!r}")
    part = sound if is_speech is None else sound[is_speech]
    power = float(np.mean(part**2)) if len(part) else 0.0
    if power == 0:
        raise InputError("noise cannot be set in relation to a sound that is silent")
    spectrum = np.fft.rfft(rng.standard_normal(len(sound)))
    k = np.maximum(np.arange(len(spectrum)), max(1.0, len(sound) / 500))
    spectrum *= k ** (-0.5 * NOISE_COLOURS.index(colour))
    spectrum[0] = 0.0
    noise = np.fft.irfft(spectrum, len(sound))
    noise *= np.sqrt(power / 10 ** (snr_db / 10) / np.mean(noise**2))
    return np.asarray(sound + noise)


def telephone(sound: NDArray[np.float64], rate_hz: int) -> NDArray[np.float64]:
    """Through 300 to 3400 Hz, 8 kHz and 8 bits of µ-law; as long and at the rate it had."""
    common = int(np.gcd(rate_hz, _TELEPHONE_RATE_HZ))
    up, down = _TELEPHONE_RATE_HZ // common, rate_hz // common
    line = resample_poly(sound, up, down)
    band = butter(4, TELEPHONE_BAND_HZ, "bandpass", fs=_TELEPHONE_RATE_HZ, output="sos")
    line = np.clip(sosfiltfilt(band, line), -1, 1)  # both ways: no delay
    code = np.round(np.sign(line) * np.log1p(_MU * np.abs(line)) / np.log1p(_MU) * 127) / 127
    heard = np.sign(code) * np.expm1(np.abs(code) * np.log1p(_MU)) / _MU
    back = resample_poly(heard, down, up)
    return np.asarray(np.pad(back, (0, max(0, len(sound) - len(back))))[: len(sound)])


def microphone(
    sound: NDArray[np.float64], rate_hz: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """A cheap one: no bass, a tilt of up to 6 dB, a presence peak, soft overload."""
    low = butter(2, rng.uniform(40, 140), "highpass", fs=rate_hz, output="sos")
    heard = sosfilt(low, sound)
    spectrum = np.fft.rfft(heard)
    f = np.fft.rfftfreq(len(heard), 1 / rate_hz)
    octaves = np.log2(np.maximum(f, 100.0) / 1000)
    gain_db = rng.uniform(-1, 1) * octaves
    peak_octave = np.log2(rng.uniform(2.0, 5.0))
    gain_db += rng.uniform(0, 5) * np.exp(-0.5 * ((octaves - peak_octave) / 0.4) ** 2)
    heard = np.fft.irfft(spectrum * 10 ** (gain_db / 20), len(heard))
    drive = rng.uniform(0.2, 0.9)
    return np.asarray(np.tanh(drive * heard) / drive)


def _place_apart(
    mouth: NDArray[np.float64],
    size: NDArray[np.float64],
    distance_mm: float,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """A place in the room at a distance from the mouth; towards the middle if chance finds none."""
    for _ in range(50):
        direction = rng.standard_normal(3) * [1, 1, 0.3]
        found = mouth + distance_mm * direction / np.linalg.norm(direction)
        if (found > _WALL_MM / 4).all() and (found < size - _WALL_MM / 4).all():
            return np.asarray(found)
    inwards = size / 2 - mouth
    return np.asarray(mouth + distance_mm * inwards / np.linalg.norm(inwards))


def _decay_s(h: NDArray[np.float64], rate_hz: int) -> float:
    """Reverberation time: the decay from -5 to -25 dB, carried on to -60 (ISO 3382)."""
    left = np.cumsum(h[::-1] ** 2)[::-1]
    db = 10 * np.log10(np.maximum(left / left[0], 1e-12))
    first, last = int(np.argmax(db < -5)), int(np.argmax(db < -25))
    slope = np.polyfit(np.arange(first, last) / rate_hz, db[first:last], 1)[0]
    return float(-60 / slope)


def _wall_reflection(size: NDArray[np.float64], rt60_s: float) -> float:
    """Share of a pressure wave that walls send back, from Eyring's formula for RT60."""
    volume = size.prod()
    surface = 2 * (size[0] * size[1] + size[1] * size[2] + size[0] * size[2])
    lost = 24 * np.log(10) * volume / (SOUND_MM_PER_S * surface * rt60_s)
    return float(np.exp(-lost / 2))


@njit(cache=True, nogil=True)
def _images(size, source, receiver, reflection, n, samples_per_mm, direct):  # type: ignore[no-untyped-def]
    """Every mirror image of the source that is heard within n samples of the direct sound."""
    h = np.zeros(n + 1)
    reach = (n / samples_per_mm) + direct
    most = np.empty(3, np.int64)
    for a in range(3):
        most[a] = int(reach / (2 * size[a])) + 1
    for i in range(-most[0], most[0] + 1):
        for j in range(-most[1], most[1] + 1):
            for k in range(-most[2], most[2] + 1):
                for mirror in range(8):
                    u, v, w = mirror & 1, (mirror >> 1) & 1, (mirror >> 2) & 1
                    dx = (1 - 2 * u) * source[0] + 2 * i * size[0] - receiver[0]
                    dy = (1 - 2 * v) * source[1] + 2 * j * size[1] - receiver[1]
                    dz = (1 - 2 * w) * source[2] + 2 * k * size[2] - receiver[2]
                    d = np.sqrt(dx * dx + dy * dy + dz * dz)
                    at = (d - direct) * samples_per_mm
                    if at >= n or at < 0:
                        continue
                    bounces = abs(i - u) + abs(i) + abs(j - v) + abs(j) + abs(k - w) + abs(k)
                    height = reflection**bounces * direct / d
                    s = int(at)
                    h[s] += height * (1 - (at - s))
                    h[s + 1] += height * (at - s)
    return h[:n]
