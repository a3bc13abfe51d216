"""Sentences by eSpeak NG, where it is installed."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from facewright.core.errors import InputError
from facewright.core.phones import SILENCE
from facewright.datasets_synthetic.espeak import (
    GROUP_VOICES,
    MNEMONICS,
    EspeakSettings,
    arpabet_of,
    espeak_voice,
    has_espeak,
    random_espeak,
)
from facewright.datasets_synthetic.voice_phones import phone_kinds
from facewright.datasets_synthetic.voice_scripts import SENTENCES, WORDS, script_of_text

needs_espeak = pytest.mark.skipif(not has_espeak(), reason="eSpeak NG is not installed")


def test_without_the_program_the_user_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)

    assert not has_espeak()
    with pytest.raises(InputError, match="install the package espeak-ng"):
        espeak_voice("hello")


def test_mnemonics_become_phones() -> None:
    known = {p for phones in MNEMONICS.values() for p in phones}

    assert known <= set(phone_kinds())
    assert known >= set(phone_kinds()) - {SILENCE}
    assert arpabet_of("tS") == ("CH",)
    assert arpabet_of("i@3") == ("IH", "R")
    assert arpabet_of("n-") == ("N",)
    assert arpabet_of("_:") == ()
    with pytest.raises(InputError, match="English"):
        arpabet_of("Q^")


@needs_espeak
def test_a_sentence_has_its_phones_at_their_times() -> None:
    text = "we see the blue moon over the water"
    voice = espeak_voice(text)

    phones = voice.truth.phones
    assert phones.start_s[0] == 0
    assert phones.end_s[-1] == pytest.approx(voice.audio.duration_s, abs=1e-3)
    np.testing.assert_allclose(phones.start_s[1:], phones.end_s[:-1], atol=1e-12)
    ours = [p.phone for p in script_of_text(text).phones if p.phone != SILENCE]
    theirs = [p for p in phones.phones if p != SILENCE]
    consonants = [p for p in ours if not phone_kinds()[p].is_vowel]
    assert [p for p in theirs if not phone_kinds()[p].is_vowel] == consonants
    assert voice.truth.f0_hz is None


@needs_espeak
def test_times_lie_where_the_sound_is() -> None:
    quiet, vowels, hiss, voiced = [], [], [], []
    for text in SENTENCES[:12]:
        voice = espeak_voice(text)
        x, rate = voice.audio.samples.astype(float), voice.audio.rate_hz
        phones = voice.truth.phones
        for phone, start, end in zip(phones.phones, phones.start_s, phones.end_s, strict=True):
            a, b = (round((start + k * (end - start)) * rate) for k in (0.25, 0.75))
            sound = x[a:b]
            if len(sound) < 80:
                continue
            level = 10 * np.log10(np.mean(sound**2) + 1e-12)
            crossings = (np.diff(np.signbit(sound)) != 0).mean() * rate
            if phone in ("AA", "AE", "EY", "IY", "OW"):
                vowels.append(level)
                voiced.append(crossings)
            elif phone in ("S", "SH"):
                hiss.append(crossings)
        shut = np.flatnonzero(np.diff(np.pad(voice.truth.lips_closed.astype(int), 1))).reshape(
            -1, 2
        )
        frames = [x[int((s + 4) * rate / 1000) : int((e - 4) * rate / 1000)] for s, e in shut]
        quiet += [10 * np.log10(np.mean(f**2) + 1e-12) for f in frames if len(f) > 100]

    assert len(vowels) > 20
    assert len(hiss) >= 8
    assert len(quiet) > 8
    assert np.quantile(hiss, 0.2) > 3500
    assert np.quantile(voiced, 0.8) < 2500
    assert np.median(quiet) < np.median(vowels) - 5  # /m/ among them is not silent


@needs_espeak
def test_the_same_settings_make_the_same_sound_and_others_another() -> None:
    first, second = espeak_voice("hello there"), espeak_voice("hello there")
    other = espeak_voice("hello there", settings=EspeakSettings(pitch=80))

    np.testing.assert_array_equal(first.audio.samples, second.audio.samples)
    n = min(len(first.audio.samples), len(other.audio.samples))
    assert not np.array_equal(first.audio.samples[:n], other.audio.samples[:n])


@needs_espeak
def test_every_word_of_ours_and_every_voice_can_be_said() -> None:
    voice = espeak_voice(" ".join(sorted(WORDS)))
    assert len(voice.truth.phones) > 200

    for group, names in GROUP_VOICES.items():
        for name in names:
            assert espeak_voice("yes", settings=EspeakSettings(name)).group == group
        random_espeak(np.random.default_rng(0), group)


@needs_espeak
def test_nothing_to_say_and_foreign_voices_are_refused() -> None:
    with pytest.raises(InputError, match="no words"):
        espeak_voice("  ... ")
    with pytest.raises(InputError, match="no voice"):
        espeak_voice("yes", settings=EspeakSettings("en-us-nobody"))
    with pytest.raises(ValueError, match="en-us"):
        EspeakSettings("de")
