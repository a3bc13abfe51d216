"""Speech on a face: lips that meet for bilabials, rounding that comes early, rest in silence."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.core.phones import ARPABET, SILENCE, PhoneTrack
from facewright.datasets_synthetic.acting_babble import VOWELS, babble, phone_track
from facewright.datasets_synthetic.acting_curves import SEAL, SPEAKING, Floats
from facewright.datasets_synthetic.acting_limits import limit
from facewright.datasets_synthetic.acting_speech import (
    FIRST_SOUND_S,
    accents,
    mouth_of_speech,
    spoken_phrases,
)

RATE_HZ = 480.0


def times(seconds: float) -> Floats:
    return np.arange(round(seconds * RATE_HZ)) / RATE_HZ


def said(text: str, length: float = 0.1, start: float = 0.5) -> PhoneTrack:
    return phone_track([(phone, length) for phone in text.split()], start)


def at(t: Floats, curve: Floats, time_s: float) -> float:
    return float(np.interp(time_s, t, curve))


@pytest.mark.parametrize("phone", ["P", "B", "M"])
@pytest.mark.parametrize("vowel", VOWELS)
@pytest.mark.parametrize("length", [0.04, 0.09])
def test_bilabials_shut_the_lips_between_any_vowels(phone: str, vowel: str, length: float) -> None:
    t = times(1.2)
    track = phone_track([(vowel, 0.15), (phone, length), (vowel, 0.15)], 0.5)

    curves = mouth_of_speech(t, track).curves
    face = limit(curves)

    during = (t >= 0.65) & (t <= 0.65 + length)
    np.testing.assert_allclose(face["mouthClose"][during], face["jawOpen"][during], atol=1e-9)
    assert curves[SEAL][during].min() > 1 - 1e-9
    for shape in ("mouthLowerDownLeft", "mouthUpperUpRight", "mouthFunnel"):
        if shape in face:
            assert face[shape][during].max() < 1e-9
    middle = at(t, face["jawOpen"] - face["mouthClose"], 0.65 + length + 0.1)
    assert middle > 0.03  # and open again in the vowel after


@pytest.mark.parametrize("phone", sorted(set(ARPABET) - {"P", "B", "M"}))
def test_no_other_phone_seals_the_lips(phone: str) -> None:
    t = times(1.2)
    assert mouth_of_speech(t, said(f"AA {phone} AA")).curves[SEAL].max() == 0


@pytest.mark.parametrize("phone", ["F", "V"])
def test_f_and_v_bring_the_lower_lip_in_under_the_teeth(phone: str) -> None:
    t = times(1.2)
    face = limit(mouth_of_speech(t, said(f"AA {phone} AA", 0.12)).curves)
    assert at(t, face["mouthRollLower"], 0.68) > 0.3
    assert at(t, face["mouthRollLower"], 0.54) < 0.1
    assert at(t, face["jawOpen"], 0.68) < 0.5 * at(t, face["jawOpen"], 0.56)


def test_rounding_comes_before_its_vowel_and_through_consonants() -> None:
    """/s/ before /u/ is said with round lips, before /i/ with spread ones."""
    t = times(1.4)
    soon = mouth_of_speech(t, said("S UW")).curves
    never = mouth_of_speech(t, said("S IY")).curves

    assert at(t, soon["mouthPucker"], 0.57) > 0.15
    assert "mouthPucker" not in never or at(t, never["mouthPucker"], 0.57) < 0.02
    begins = t[np.argmax(soon["mouthPucker"] > 0.02)]
    assert 0.46 < begins < 0.56  # 40 ms and more before the vowel, not much before all sound


def test_vowels_differ_and_the_jaw_opens_most_for_a() -> None:
    t = times(1.2)
    opening = {}
    for vowel in ("AA", "EH", "IY", "UW", "AO"):
        face = limit(mouth_of_speech(t, said(f"T {vowel} T", 0.16)).curves)
        opening[vowel] = at(t, face["jawOpen"], 0.74)
    assert opening["AA"] > opening["EH"] > opening["IY"]
    assert opening["AO"] > opening["UW"]


def test_short_vowels_stay_short_of_their_target() -> None:
    t = times(1.6)
    peaks = []
    for length in (0.05, 0.1, 0.25):
        track = phone_track([("T", 0.07), ("AA", length), ("T", 0.07)], 0.5)
        peaks.append(mouth_of_speech(t, track).curves["jawOpen"].max())
    assert peaks[0] < peaks[1] < peaks[2]


def test_silence_closes_the_mouth_and_keeps_it_still() -> None:
    t = times(3.0)
    lengths = [(p, 0.1) for p in ("HH", "AA", "L", "OW")]
    track = phone_track([*lengths, (SILENCE, 0.8), *lengths], 0.5)

    layer = mouth_of_speech(t, track)

    quiet = (t < 0.3) | ((t > 1.15) & (t < 1.5)) | (t > 2.4)
    assert max(c[quiet].max() for n, c in layer.curves.items() if n != SPEAKING) < 1e-3
    assert len(layer.events) == 2
    assert layer.curves[SPEAKING].max() <= 1


def test_strength_scales_articulation() -> None:
    t = times(1.2)
    weak, strong = (mouth_of_speech(t, said("T AA T"), strength=s).curves for s in (0.5, 1.0))
    np.testing.assert_allclose(2 * weak["jawOpen"], strong["jawOpen"], atol=1e-12)


def test_phrases_are_runs_between_silences() -> None:
    track = said("SIL M AA SIL B AA T SIL")
    phrases = spoken_phrases(track)
    assert [p for _, _, p in phrases] == ["M AA", "B AA T"]
    np.testing.assert_allclose([p[:2] for p in phrases], [(0.6, 0.8), (0.9, 1.2)])


def test_accents_are_the_long_vowels() -> None:
    track = phone_track(
        [("B", 0.07), ("AH", 0.05), ("N", 0.06), ("AE", 0.18), ("N", 0.06), ("AH", 0.06)], 0.5
    )
    found = accents(track)
    assert len(found) == 1
    assert found[0][0] == pytest.approx(0.5 + 0.18 + 0.09)


def test_babble_is_speech_in_tempo_and_in_time() -> None:
    track = babble(np.random.default_rng(0), start_s=0.6, end_s=60.0)

    assert track.start_s[0] == 0.6
    assert track.end_s[-1] <= 60.0
    spoken = [(p, e - s) for p, s, e in zip(track.phones, track.start_s, track.end_s, strict=True)
              if p != SILENCE]  # fmt: skip
    rate = len(spoken) / sum(length for _, length in spoken)
    assert 8 < rate < 15  # phones a second, as in conversation
    assert len({p for p, _ in spoken}) > 30
    syllables = sum(phone in VOWELS for phone, _ in spoken)
    assert 3 < syllables / sum(length for _, length in spoken) < 7  # a second


def test_a_sound_too_early_is_told() -> None:
    with pytest.raises(ValueError, match=r"must not be before 0\.45 s"):
        mouth_of_speech(times(1.0), said("AA", start=0.2))
    mouth_of_speech(times(1.0), said("AA", start=FIRST_SOUND_S))
    assert not any(
        curve[times(1.0) <= 0.3].any()
        for curve in mouth_of_speech(times(1.0), said("UW", start=FIRST_SOUND_S)).curves.values()
    )


def test_speech_is_as_smooth_as_skin() -> None:
    """The change of acceleration from sample to sample shrinks with the step: no corners."""
    track = babble(np.random.default_rng(3), start_s=0.6, end_s=4.0)
    jumps = []
    for rate in (2000.0, 4000.0):
        t = np.arange(round(4.5 * rate)) / rate
        face = limit(mouth_of_speech(t, track).curves)
        table = np.stack(list(face.values()), axis=1)
        jumps.append(np.abs(np.diff(np.diff(table, 2, axis=0) * rate**2, axis=0)).max(axis=0))
    moving = jumps[0] > 1e-2
    assert moving.sum() > 8
    assert (jumps[1][moving] / jumps[0][moving]).max() < 0.75
