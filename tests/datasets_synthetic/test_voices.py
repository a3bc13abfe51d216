"""Voices against measures that know nothing of how they were made."""

from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import resample_poly

from facewright.core.errors import InputError
from facewright.core.phones import ARPABET, SILENCE
from facewright.datasets_synthetic.formant_voice import formant_voice
from facewright.datasets_synthetic.voice_phones import CLASSES, phone_kinds
from facewright.datasets_synthetic.voice_scripts import (
    KINDS,
    SENTENCES,
    WORDS,
    Script,
    ScriptPhone,
    random_script,
    script_of_text,
)
from facewright.datasets_synthetic.voice_source import (
    SOURCE_RATE_HZ,
    VoiceQuality,
    glottal_source,
    lf_closure,
    lf_flow,
)
from facewright.datasets_synthetic.voice_talkers import (
    GROUPS,
    MEASURED_VOWELS,
    all_talkers,
    group_talkers,
    mean_talker,
)
from facewright.datasets_synthetic.voice_tracks import Timeline, VoiceTracks
from facewright.datasets_synthetic.voices import Voice, make_voice, record_voice, speaking


def steady_vowel(
    formants_hz: NDArray[np.float64], f0_hz: float, *, ms: int = 600
) -> NDArray[np.float64]:
    """A vowel that does not move, with an even glottis, at `SOURCE_RATE_HZ`."""
    phones = (SILENCE, "AA", SILENCE)
    script = Script("vowel", "", tuple(ScriptPhone(p, False, 0) for p in phones), 1.0)
    edges = np.array([0, 50, ms - 50, ms])
    one, none = np.ones(ms), np.zeros(ms)
    tracks = VoiceTracks(
        timeline=Timeline(script, edges, edges[1:]),
        f0_hz=f0_hz * one,
        formants_hz=np.tile(formants_hz, (ms, 1)),
        bandwidths_hz=np.tile([60.0, 80, 120, 200], (ms, 1)),
        voicing=one,
        aspiration=none,
        frication=none,
        velum=none,
    )
    rng = np.random.default_rng(0)
    quality = VoiceQuality(jitter=0.0, shimmer=0.0, breath=0.0)
    source = glottal_source(tracks.f0_hz, one, none, rng, quality=quality)
    return formant_voice(mean_talker("man"), tracks, source, rng)


def lpc_resonances(
    sound: NDArray[np.float64], rate_hz: int, order: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies and bandwidths of the sharp poles of an autocorrelation predictor, Hz."""
    x = np.append(sound[0], sound[1:] - 0.97 * sound[:-1]) * np.hamming(len(sound))
    r = np.correlate(x, x, "full")[len(x) - 1 : len(x) + order]
    a = solve_toeplitz(r[:order], r[1:])
    z = np.roots(np.concatenate([[1.0], -a]))
    z = z[z.imag > 0]
    f = np.angle(z) * rate_hz / (2 * np.pi)
    bandwidth = -np.log(np.abs(z)) * rate_hz / np.pi
    keep = (f > 150) & (bandwidth < 500)
    order_of = np.argsort(f[keep])
    return f[keep][order_of], bandwidth[keep][order_of]


def pitch_by_autocorrelation(sound: NDArray[np.float64], rate_hz: int) -> float:
    """F0 of a voiced stretch, Hz, by the highest peak between 60 and 500 Hz."""
    x = sound - sound.mean()
    r = np.correlate(x, x, "full")[len(x) - 1 :]
    r = r / (len(x) - np.arange(len(x)))  # unbiased: a later period is no lower
    first, last = rate_hz // 500, rate_hz // 60
    lag = first + int(np.argmax(r[first:last]))
    # the first peak that is nearly as high: not an octave below
    for k in range(first, lag):
        if r[k] > 0.9 * r[lag] and r[k] >= r[k - 1] and r[k] >= r[k + 1]:
            lag = k
            break
    a, b, c = r[lag - 1 : lag + 2]
    return float(rate_hz / (lag + 0.5 * (a - c) / (a - 2 * b + c)))


def crossings_per_second(sound: NDArray[np.float64], rate_hz: int) -> float:
    return float((np.diff(np.signbit(sound)) != 0).sum() * rate_hz / len(sound))


def level_db(sound: NDArray[np.float64]) -> float:
    return float(10 * np.log10(np.mean(sound**2) + 1e-20))


def part(voice: Voice, index: int, *, middle: float = 1.0) -> NDArray[np.float64]:
    """The sound of one phone, or of its middle."""
    start, end = voice.truth.phones.start_s[index], voice.truth.phones.end_s[index]
    trim = 0.5 * (1 - middle) * (end - start)
    a, b = np.rint(np.array([start + trim, end - trim]) * voice.audio.rate_hz).astype(int)
    return voice.audio.samples[a:b].astype(np.float64)


@pytest.mark.parametrize("vowel", ["IY", "AE", "AA", "UH", "ER"])
def test_a_predictor_finds_the_formants_of_a_steady_vowel(vowel: str) -> None:
    formants = mean_talker("man").vowels[vowel].formants_hz[1]

    sound = resample_poly(steady_vowel(formants, 100.0), 5, 12)
    f, _ = lpc_resonances(sound[2000:3000], 10_000, 12)

    # a predictor is drawn towards harmonics: up to a fifth of F0 of 100 Hz, and beyond by the tilt
    for true in formants[:3]:
        assert np.abs(f - true).min() < max(30.0, 0.03 * true), (true, f)


def test_pitch_is_the_melodys_in_every_group_and_synthesiser() -> None:
    errors = []
    for synth in ("formant", "tube"):
        for seed, group in enumerate(GROUPS):
            voice = make_voice(seed, talker=group, synth=synth, kind="vowel")
            t = (
                voice.truth.phones.start_s[1]
                + 0.4 * voice.truth.phones.end_s[1]
                - 0.4 * (voice.truth.phones.start_s[1])
            )
            assert voice.truth.f0_hz is not None
            true = voice.truth.f0_hz[int(t * 1000)]
            first = int((t - 0.025) * voice.audio.rate_hz)
            heard = voice.audio.samples[first : first + voice.audio.rate_hz // 20]
            found = pitch_by_autocorrelation(heard.astype(np.float64), voice.audio.rate_hz)
            errors.append(abs(found / true - 1))
    # periods wobble by up to 1.2 %; 5 to 12 of them are averaged; the melody moves meanwhile
    assert max(errors) < 0.03, errors


def test_glottal_pulses_come_at_the_pitch_with_the_jitter_asked_for() -> None:
    n = 20_000
    rng = np.random.default_rng(4)
    quality = VoiceQuality(jitter=0.01)

    source = glottal_source(np.full(n, 125.0), np.ones(n), np.zeros(n), rng, quality=quality)

    periods = np.diff(source.closures_s)
    assert periods.mean() == pytest.approx(1 / 125, rel=0.001)
    # the instant within a pulse moves with its own length: (1 - te) of one, te of the next
    te = lf_closure(quality.rd)
    expected = 0.01 * np.hypot(te, 1 - te)
    assert periods.std() * 125 == pytest.approx(expected, rel=0.06)
    at = np.rint(source.closures_s[5:-5] * SOURCE_RATE_HZ).astype(int)
    lowest = [source.pulses[k - 40 : k + 40].argmin() - 40 for k in at]
    assert np.abs(lowest).max() <= 2  # samples of 1/24 ms


@pytest.mark.parametrize("rd", [0.4, 0.7, 1.0, 1.6, 2.6])
def test_glottal_flow_is_that_of_the_model(rd: float) -> None:
    flow = lf_flow(rd)

    slope = np.diff(flow) * (len(flow) - 1)
    assert flow[0] == 0
    assert flow[-1] == 0
    assert abs(flow[-2]) < 1e-3
    assert flow.min() > -1e-4  # air does not flow back
    assert slope.min() == pytest.approx(-1, abs=0.02)
    assert np.argmin(slope) / len(slope) == pytest.approx(lf_closure(rd), abs=0.005)
    # Fant 1995, eq. 1: Rd is the flow's peak over its steepest fall, in ms, times F0 / 110 Hz
    assert flow.max() * 1000 / 110 == pytest.approx(rd, rel=0.12)


def test_talkers_are_those_of_the_table() -> None:
    assert [len(group_talkers(g)) for g in GROUPS] == [45, 48, 46]
    # means that Hillenbrand et al. 1995 print in their table V, within what a missing token moves
    assert mean_talker("man").vowels["IY"].formants_hz[1, :3] == pytest.approx(
        [342, 2322, 3000], rel=0.01
    )
    assert mean_talker("woman").vowels["AA"].formants_hz[1, :3] == pytest.approx(
        [936, 1551, 2815], rel=0.025
    )
    assert (
        mean_talker("man").tract_mm > mean_talker("woman").tract_mm > mean_talker("child").tract_mm
    )
    for talker in all_talkers():
        for name in MEASURED_VOWELS:
            vowel = talker.vowels[name]
            assert (np.diff(vowel.formants_hz, axis=1) > 0).all(), (talker.name, name)
            assert 0.05 < vowel.duration_s < 0.7
            assert 60 < vowel.f0_hz < 400


def test_every_phone_has_a_kind_and_is_said_in_some_word() -> None:
    said = {p.rstrip("1") for phones in WORDS.values() for p in phones.split()}

    assert set(phone_kinds()) == {*ARPABET, SILENCE}
    assert {k.class_ for k in phone_kinds().values()} == set(CLASSES)
    assert said == set(ARPABET)
    for sentence in SENTENCES:
        assert len(script_of_text(sentence).phones) > 10


@pytest.mark.parametrize("synth", ["formant", "tube"])
def test_the_same_seed_makes_the_same_voice_and_another_another(synth: str) -> None:
    first = make_voice(5, synth=synth, kind="hvd")
    second = make_voice(5, synth=synth, kind="hvd")
    other = make_voice(6, synth=synth, kind="hvd")

    np.testing.assert_array_equal(first.audio.samples, second.audio.samples)
    np.testing.assert_array_equal(first.truth.phones.end_s, second.truth.phones.end_s)
    assert (first.talker, first.text) == (second.talker, second.text)
    n = min(len(first.audio.samples), len(other.audio.samples))
    assert not np.array_equal(first.audio.samples[:n], other.audio.samples[:n])


@pytest.mark.parametrize("rate_hz", [8_000, 11_025, 22_050, 44_100, 48_000])
def test_a_rate_changes_neither_truth_nor_voice(rate_hz: int) -> None:
    usual = make_voice(3, kind="vowels")
    voice = make_voice(3, kind="vowels", rate_hz=rate_hz)

    np.testing.assert_array_equal(voice.truth.phones.start_s, usual.truth.phones.start_s)
    assert voice.audio.duration_s == pytest.approx(usual.audio.duration_s, abs=1 / 8000)
    # below 3.3 kHz, where every rate has it all, the sounds differ by the resampler's ripple only
    n = 2048
    start = voice.truth.phones.start_s[1] + 0.05
    spectra = []
    for v in (usual, voice):
        a = round(start * v.audio.rate_hz)
        length = round(0.1 * v.audio.rate_hz)
        x = v.audio.samples[a : a + length] * np.hanning(length)
        f = np.arange(100.0, 3300.0, 3200 / n)
        k = np.exp(-2j * np.pi * np.outer(f, np.arange(length) / v.audio.rate_hz))
        spectra.append(np.abs(k @ x) / v.audio.rate_hz / v.truth.gain)
    ratio = (
        spectra[1][spectra[0] > 0.01 * spectra[0].max()]
        / spectra[0][spectra[0] > 0.01 * spectra[0].max()]
    )
    assert np.abs(20 * np.log10(ratio)).max() < 0.6


@pytest.mark.parametrize("synth", ["formant", "tube"])
def test_fricatives_cross_zero_often_and_vowels_seldom(synth: str) -> None:
    voice = make_voice(2, talker="woman", synth=synth, text="she see shoes, yes, zoo")
    rates: dict[str, list[float]] = {"sibilant": [], "vowel": []}

    for i, phone in enumerate(voice.truth.phones.phones):
        what = "sibilant" if phone in ("S", "SH") else "vowel"
        if phone in ("S", "SH", "IY", "UW", "EH"):
            sound = part(voice, i, middle=0.5)
            rates[what].append(crossings_per_second(sound, voice.audio.rate_hz))

    assert len(rates["sibilant"]) == 4
    assert min(rates["sibilant"]) > 4000
    assert max(rates["vowel"]) < 3000


@pytest.mark.parametrize("synth", ["formant", "tube"])
def test_a_stop_is_silent_while_shut_and_the_lips_are_where_truth_says(synth: str) -> None:
    voice = make_voice(11, talker="man", synth=synth, text="happy people open apple")
    rate = voice.audio.rate_hz
    sound = voice.audio.samples.astype(np.float64)
    shut = np.flatnonzero(np.diff(voice.truth.lips_closed.astype(int)))

    assert len(shut) == 2 * sum(p == "P" for p in voice.truth.phones.phones) == 10
    vowel_db = max(
        level_db(part(voice, i, middle=0.5))
        for i, p in enumerate(voice.truth.phones.phones)
        if phone_kinds()[p].is_vowel
    )
    for first, last in shut.reshape(-1, 2):
        middle = sound[int((first + 25) * rate / 1000) : int((last - 3) * rate / 1000)]
        burst = sound[int(last * rate / 1000) : int((last + 12) * rate / 1000)]
        assert level_db(middle) < vowel_db - 30
        assert level_db(burst) > level_db(middle) + 10


def test_nasal_sound_is_weaker_above_a_kilohertz_than_the_vowel_beside_it() -> None:
    for synth in ("formant", "tube"):
        voice = make_voice(1, talker="man", synth=synth, text="moon money")
        tilt = []
        for i in (1, 2, 4, 5):  # M UW ... M AH
            x = np.abs(np.fft.rfft(part(voice, i, middle=0.6), 4096)) ** 2
            f = np.fft.rfftfreq(4096, 1 / voice.audio.rate_hz)
            tilt.append(10 * np.log10(x[f < 500].sum() / x[(f > 1000) & (f < 3000)].sum()))
        assert voice.truth.phones.phones[1] == voice.truth.phones.phones[4] == "M"
        assert tilt[2] > tilt[3] + 5, (synth, tilt)


def test_truth_is_missing_where_there_is_none() -> None:
    voice = make_voice(7, talker="man", synth="tube", text="the big dog")
    truth = voice.truth
    assert truth.f0_hz is not None
    assert truth.formants_hz is not None
    assert truth.areas_mm2 is not None

    silent = truth.frame_class == CLASSES.index("silence")
    assert np.isnan(truth.formants_hz[silent]).all()
    assert np.isnan(truth.f0_hz[:100]).all()
    closed = truth.areas_mm2.min(axis=1) < 2
    assert closed.sum() > 50
    assert np.isnan(truth.formants_hz[closed]).all()
    vowel = np.isin(truth.frame_class, [CLASSES.index(c) for c in "aeiou"])
    inside = np.convolve(vowel, np.ones(41), "same") == 41  # 20 ms from any edge
    assert np.isfinite(truth.f0_hz[inside]).all()
    assert np.isfinite(truth.formants_hz[inside]).all()


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_asked_for_fills_the_time_exactly(kind: str) -> None:
    voice = make_voice(8, kind=kind, seconds=5.0)

    phones = voice.truth.phones
    assert len(voice.audio.samples) == 5 * 16_000
    assert phones.start_s[0] == 0
    assert phones.end_s[-1] == 5.0
    np.testing.assert_array_equal(phones.start_s[1:], phones.end_s[:-1])
    assert len(voice.truth.time_s) == 5000
    for phone, start, end in zip(phones.phones, phones.start_s, phones.end_s, strict=True):
        frames = voice.truth.frame_class[round(start * 1000) : round(end * 1000)]
        kinds = phone_kinds()[phone]
        assert CLASSES[frames[0]] == kinds.class_
        assert CLASSES[frames[-1]] == kinds.class_end


def test_noise_has_the_ratio_asked_for_and_truth_stays() -> None:
    clean = make_voice(4, text="the dog is in the house")

    for snr_db in (20.0, 5.0, -5.0):
        noisy = record_voice(clean, noise_db=snr_db)
        turned_down = noisy.truth.gain / clean.truth.gain
        noise = (noisy.audio.samples / turned_down - clean.audio.samples).astype(np.float64)
        said = speaking(clean)
        measured = level_db(clean.audio.samples[said].astype(float)) - level_db(noise)
        assert measured == pytest.approx(snr_db, abs=0.05)
        assert noisy.truth.phones is clean.truth.phones


def test_voice_is_much_faster_than_real_time() -> None:
    make_voice(0, seconds=1.0, kind="vowel")  # compiles

    start = time.perf_counter()
    voice = make_voice(1, seconds=20.0, kind="sentence")
    took_s = time.perf_counter() - start

    assert voice.audio.duration_s / took_s > 20


def test_wrong_calls_and_unknown_words_are_told() -> None:
    with pytest.raises(InputError, match="does not know xylophone"):
        make_voice(0, text="the xylophone")
    with pytest.raises(InputError, match="no words"):
        make_voice(0, text=" , ")
    with pytest.raises(InputError, match="more --seconds"):
        make_voice(0, text="the dog is in the house", seconds=0.5)
    with pytest.raises(InputError, match="too short"):
        make_voice(0, kind="sentence", seconds=0.5)
    with pytest.raises(ValueError, match="rate_hz"):
        make_voice(0, rate_hz=4000)
    with pytest.raises(ValueError, match="synth"):
        make_voice(0, synth="choir")
    with pytest.raises(ValueError, match="group"):
        make_voice(0, talker="robot")
    with pytest.raises(ValueError, match="kind"):
        random_script(np.random.default_rng(0), "song")
    with pytest.raises(ValueError, match="rd"):
        VoiceQuality(rd=5.0)
