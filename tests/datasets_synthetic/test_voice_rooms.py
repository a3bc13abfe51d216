"""Rooms, noise, microphones and telephones against their own definitions."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.core.errors import InputError
from facewright.datasets_synthetic.voice_rooms import (
    RoomSettings,
    add_noise,
    microphone,
    random_room,
    room_response,
    telephone,
)
from facewright.datasets_synthetic.voices import make_voice, record_voice


@pytest.mark.parametrize("rt60_s", [0.2, 0.4, 0.8])
def test_a_room_decays_in_the_time_asked_for(rt60_s: float) -> None:
    found = []
    for seed in range(6):
        h = room_response(RoomSettings(rt60_s), 16_000, np.random.default_rng(seed))
        assert h[0] == pytest.approx(1, abs=1e-9)
        left = np.cumsum(h[::-1] ** 2)[::-1]  # Schroeder's integral
        db = 10 * np.log10(left / left[0] + 1e-12)
        late = np.flatnonzero((db < -5) & (db > -25))
        slope = np.polyfit(late / 16_000, db[late], 1)[0]
        found.append(-60 / slope)

    # the decay bends where echoes are few: 10 % between definitions
    assert np.median(found) == pytest.approx(rt60_s, rel=0.1)
    assert np.abs(np.array(found) / rt60_s - 1).max() < 0.25


def test_a_near_mouth_is_drier_than_a_far_one() -> None:
    ratios = []
    for distance in (200.0, 600.0, 1800.0):
        ratio = [
            1
            / (
                room_response(RoomSettings(0.5, distance), 16_000, np.random.default_rng(s))[32:]
                ** 2
            ).sum()
            for s in range(5)
        ]
        ratios.append(np.median(ratio))

    assert ratios[0] > 3 * ratios[1] > 9 * ratios[2]


@pytest.mark.parametrize(
    ("colour", "slope_db"), [("white", 0.0), ("pink", -3.01), ("brown", -6.02)]
)
def test_noise_has_its_colour_and_its_ratio(colour: str, slope_db: float) -> None:
    rng = np.random.default_rng(1)
    sound = np.sin(np.arange(160_000) * 0.3)

    noise = add_noise(sound, 12.0, rng, colour=colour) - sound

    assert 10 * np.log10(0.5 / np.mean(noise**2)) == pytest.approx(12, abs=0.01)
    power = np.abs(np.fft.rfft(noise)) ** 2
    f = np.fft.rfftfreq(len(noise), 1 / 16_000)
    octaves = [power[(f >= low) & (f < 2 * low)].mean() for low in (125, 250, 500, 1000, 2000)]
    steps = np.diff(10 * np.log10(octaves))
    assert steps.mean() == pytest.approx(slope_db, abs=0.35)


def test_silence_has_no_ratio_to_noise() -> None:
    with pytest.raises(InputError, match="silent"):
        add_noise(np.zeros(100), 10.0, np.random.default_rng(0))


@pytest.mark.parametrize("rate_hz", [8_000, 16_000, 44_100])
def test_a_telephone_keeps_its_band_and_the_time(rate_hz: int) -> None:
    rng = np.random.default_rng(2)
    sound = 0.1 * rng.standard_normal(rate_hz)

    heard = telephone(sound, rate_hz)

    assert len(heard) == len(sound)
    gain = np.abs(np.fft.rfft(heard)) ** 2
    f = np.fft.rfftfreq(len(heard), 1 / rate_hz)
    inside = gain[(f > 500) & (f < 3000)].mean()
    assert 10 * np.log10(inside / gain[f < 100].mean()) > 25
    assert 10 * np.log10(inside / gain[f > 3800].mean()) > 20
    lag = np.argmax(np.correlate(heard, sound[1000:-1000], "valid")) - 1000
    assert lag == 0


def test_a_microphone_colours_but_keeps_the_level() -> None:
    rng = np.random.default_rng(3)
    sound = 0.1 * rng.standard_normal(16_000)

    heard = [microphone(sound, 16_000, np.random.default_rng(s)) for s in range(8)]

    levels = [10 * np.log10(np.mean(h**2) / np.mean(sound**2)) for h in heard]
    assert np.abs(levels).max() < 6
    assert not np.allclose(heard[0], heard[1])
    f = np.fft.rfftfreq(16_000, 1 / 16_000)
    bass = np.abs(np.fft.rfft(np.mean(heard, axis=0)))[(f > 0) & (f < 15)].mean()
    assert bass < 0.25 * np.abs(np.fft.rfft(sound))[(f > 0) & (f < 15)].mean()


def test_a_room_delays_nothing_and_is_reported() -> None:
    clean = make_voice(3, kind="hvd")

    recorded = record_voice(clean, room=RoomSettings(0.2, 200.0), over_telephone=True)

    n = len(clean.audio.samples)
    assert len(recorded.audio.samples) == n
    both = np.correlate(
        recorded.audio.samples.astype(float), clean.audio.samples[400:-400].astype(float), "valid"
    )
    assert abs(int(np.argmax(np.abs(both))) - 400) <= 2
    assert recorded.settings["room_rt60_s"] == 0.2
    assert recorded.settings["telephone"] is True
    assert "room_rt60_s" not in clean.settings


def test_rooms_have_limits() -> None:
    with pytest.raises(ValueError, match="rt60_s"):
        RoomSettings(10.0)
    with pytest.raises(ValueError, match="distance_mm"):
        RoomSettings(0.5, 1.0)
    for seed in range(50):
        random_room(np.random.default_rng(seed))
