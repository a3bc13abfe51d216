"""What microphones hear, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.core.audio import Audio
from facewright.datasets_synthetic.clocks import CameraClock
from facewright.datasets_synthetic.take_sound import (
    RATE_HZ,
    REFERENCE_MM,
    SPEED_OF_SOUND_MM_PER_S,
    Clap,
    HeardSound,
    Source,
    clap_source,
    record,
    scene_source,
)

ORIGIN = np.zeros(3)


def tone(hz: float) -> Source:
    def samples(first: int, last: int) -> np.ndarray:
        return 0.4 * np.sin(2 * np.pi * hz * np.arange(first, last) / RATE_HZ)

    return Source(ORIGIN, samples)


def heard(source: Source, place: np.ndarray, clock: CameraClock, seconds: float) -> HeardSound:
    return HeardSound((source,), place, clock, seconds=seconds, noise_seed=1, noise=0.0)


@pytest.mark.parametrize("hz", [200.0, 3000.0, 9000.0])
@pytest.mark.parametrize("clock", [CameraClock(), CameraClock(0.0123, 8e-5)])
def test_a_tone_arrives_late_weaker_and_at_the_clocks_pace(hz: float, clock: CameraClock) -> None:
    place = np.array([300.0, -400.0, 1200.0])  # 1300 mm
    sound = heard(tone(hz), place, clock, 1.0)[10_000:20_000]

    n = np.arange(10_000, 20_000)
    t = clock.offset_s + (1 + clock.drift) * n / RATE_HZ - 1300 / SPEED_OF_SOUND_MM_PER_S
    expected = 0.4 * REFERENCE_MM / 1300 * np.sin(2 * np.pi * hz * t)
    assert np.abs(sound - expected).max() < 2e-4


def test_pieces_join_without_a_seam() -> None:
    track = HeardSound(
        (tone(440.0), clap_source(ORIGIN, (Clap(0.31, 5),))),
        np.array([0.0, 0.0, 700.0]),
        CameraClock(0.01, 5e-5),
        seconds=2.0,
        noise_seed=3,
    )

    whole = track[0 : len(track)]
    parts = np.concatenate([track[a : a + 1024] for a in range(0, len(track), 1024)])

    np.testing.assert_array_equal(whole, parts)


def test_a_clap_starts_when_it_is_said_to() -> None:
    place = np.array([0.0, 0.0, 686.0])  # 2 ms of sound
    clock = CameraClock(offset_s=-0.05, drift=0.0)
    track = heard(clap_source(ORIGIN, (Clap(0.25, 9),)), place, clock, 1.0)[0:48_000]

    arrives_s = 0.25 + 0.002 + 0.05
    onset = np.flatnonzero(np.abs(track) > 0.02)[0] / RATE_HZ
    assert onset == pytest.approx(arrives_s, abs=2e-4)
    assert np.abs(track[: int((arrives_s - 0.001) * RATE_HZ)]).max() < 0.01


def test_scenes_follow_one_another() -> None:
    def sound_of(scene: int) -> Audio | None:
        return None if scene == 1 else Audio(np.full(8000, 0.1 * (scene + 1), np.float32), 16_000)

    found = record((scene_source(ORIGIN, sound_of, 1.0),), 3.0)[0 : 3 * RATE_HZ]

    middle = RATE_HZ // 4
    assert found[middle] == pytest.approx(0.1, abs=1e-3)
    assert found[RATE_HZ + middle] == 0
    assert found[2 * RATE_HZ + middle] == pytest.approx(0.3, abs=1e-3)
    assert np.abs(found[RATE_HZ // 2 + 100 : RATE_HZ]).max() < 1e-3  # the sound is half as long


def test_noise_is_there_and_is_the_seeds() -> None:
    a, b = (
        HeardSound((), ORIGIN, CameraClock(), seconds=1.0, noise_seed=s, noise=1e-3)[0:48_000]
        for s in (1, 2)
    )

    assert a.std() == pytest.approx(1e-3, rel=0.03)
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.03
