from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from facewright.core.audio import Audio
from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.retarget.resampling import (
    MAX_FRAMES,
    USUAL_RATES,
    exact_rate,
    fit_sound,
    frame_times,
    parse_rate,
    rate_text,
    resample_clip,
)

HOUR_S = 3600.0


@pytest.mark.parametrize(
    ("text", "exact"),
    [
        ("24", Fraction(24)),
        ("25", Fraction(25)),
        ("29.97", Fraction(30000, 1001)),
        ("30", Fraction(30)),
        ("50", Fraction(50)),
        ("59.94", Fraction(60000, 1001)),
        ("60.0", Fraction(60)),
        (" 30000/1001 ", Fraction(30000, 1001)),
        ("25/2", Fraction(25, 2)),
    ],
)
def test_rates_are_exact(text: str, exact: Fraction) -> None:
    assert parse_rate(text) == exact


@pytest.mark.parametrize(
    "text", ["0", "-25", "", "fast", "nan", "inf", "1e3", "29.9", "1001", "1/0", "1/3", "25 30"]
)
def test_what_is_no_rate_is_refused_with_those_that_are(text: str) -> None:
    with pytest.raises(InputError, match=r"24, 25, 29\.97, 30, 50, 59\.94, 60"):
        parse_rate(text)


@pytest.mark.parametrize("text", USUAL_RATES)
def test_a_rate_measured_from_stamps_is_the_one_meant(text: str) -> None:
    rate = parse_rate(text)
    stamps = np.round(np.arange(500) / float(rate), 4)
    measured = (len(stamps) - 1) / (stamps[-1] - stamps[0])

    assert exact_rate(measured) == rate
    assert rate_text(rate) == text


@pytest.mark.parametrize("text", USUAL_RATES)
def test_frames_do_not_drift_from_the_exact_rate_over_an_hour(text: str) -> None:
    rate = parse_rate(text)

    times = frame_times(2.0, 2.0 + HOUR_S, rate)

    assert len(times) == int(HOUR_S * rate) + 1
    for k in (0, 1, len(times) // 2, len(times) - 1):
        assert times[k] == pytest.approx(float(2 + Fraction(k) / rate), abs=1e-12 * HOUR_S)


def test_a_clip_of_days_is_refused() -> None:
    with pytest.raises(InputError, match=f"more than {MAX_FRAMES}"):
        frame_times(0.0, 1e7, Fraction(60))


def test_lines_stay_lines_and_fields_of_visemes_are_held() -> None:
    t = np.array([0.0, 0.1, 0.25, 0.5])
    values = np.stack([100 * t, [3, 3, 7, 7], [0, 0, 0, 1]], axis=1)
    clip = Clip(t, ("open_jaw", "viseme.select1", "expression.select1"), values)

    found = resample_clip(clip, Fraction(40))

    np.testing.assert_allclose(found.clip["open_jaw"], 100 * found.clip.time_s, atol=1e-9)
    assert found.clip["viseme.select1"].tolist() == [3.0] * 10 + [7.0] * 11
    assert (found.interpolated, found.held) == (
        ("open_jaw",),
        ("viseme.select1", "expression.select1"),
    )
    assert found.text() == (
        "resampled to 21 frames, 40/s: 1 channels linear between keys, 2 of FAPs 1 and 2 held"
    )


def test_a_clip_of_the_rate_keeps_its_values_and_gets_exact_times() -> None:
    rate = Fraction(30000, 1001)
    t = np.round(np.arange(90) / float(rate), 3)
    clip = Clip(t, ("open_jaw",), np.random.default_rng(0).normal(size=(90, 1)))

    found = resample_clip(clip, rate)

    assert not found.is_changed and found.text() == ""
    np.testing.assert_array_equal(found.clip.values, clip.values)
    np.testing.assert_allclose(found.clip.time_s, np.arange(90) * 1001 / 30000, atol=1e-15)


def test_what_is_not_set_stays_not_set() -> None:
    t = np.arange(10) / 10
    values = np.ones((10, 2))
    values[3:6, 0] = np.nan
    clip = Clip(t, ("open_jaw", "head_yaw"), values)

    found = resample_clip(clip, Fraction(20)).clip

    missing = np.isnan(found["open_jaw"])
    assert missing.tolist() == [False] * 6 + [True] * 5 + [False] * 8
    assert not np.isnan(found["head_yaw"]).any()


def test_going_up_and_back_down_is_the_identity() -> None:
    rng = np.random.default_rng(1)
    clip = Clip(1.5 + np.arange(48) / 24, ("a", "viseme.blend"), rng.normal(size=(48, 2)))

    up = resample_clip(clip, Fraction(48)).clip
    down = resample_clip(up, Fraction(24)).clip

    np.testing.assert_allclose(down.values, clip.values, atol=1e-9)
    np.testing.assert_allclose(down.time_s, clip.time_s, atol=1e-12)


def test_one_frame_is_a_clip_and_none_is_not() -> None:
    one = Clip(np.array([3.0]), ("open_jaw",), np.array([[7.0]]))
    assert resample_clip(one, Fraction(25)).clip["open_jaw"].tolist() == [7.0]
    with pytest.raises(InputError, match="no frames"):
        resample_clip(Clip(np.zeros(0), ("a",), np.zeros((0, 1))), Fraction(25))


# sound


def click(at_s: float, duration_s: float, rate_hz: int = 8000) -> Audio:
    samples = np.zeros(round(duration_s * rate_hz), np.float32)
    samples[round(at_s * rate_hz)] = 1.0
    return Audio(samples, rate_hz)


@pytest.mark.parametrize("start_s", [0.0, 0.25, -0.5, 0.999])
def test_a_click_is_heard_at_the_frame_of_its_time(start_s: float) -> None:
    found = fit_sound(click(1.0, 2.0), start_s, start_s + 3.0)

    heard_s = float(np.argmax(found.audio.samples)) / found.audio.rate_hz
    assert start_s + heard_s == pytest.approx(1.0, abs=0.5 / 8000)
    assert any("begins" in line for line in found.notes) == (start_s != 0)


def test_longer_sound_holds_the_last_pose_and_shorter_is_followed_by_silence() -> None:
    longer = fit_sound(click(0.1, 2.0), 0.0, 1.25)
    assert longer.hold_s == pytest.approx(0.75)
    assert longer.notes == ("the sound goes on 0.750 s after the clip: the last pose is held",)

    shorter = fit_sound(click(0.1, 2.0), 0.0, 3.0)
    assert shorter.hold_s == 0
    assert shorter.notes == ("the sound ends 1.000 s before the clip: silence from then on",)

    assert fit_sound(click(0.1, 2.0), 0.0, 2.0).notes == ()


def test_sound_that_ends_before_the_clip_begins_is_refused() -> None:
    with pytest.raises(InputError, match=r"lasts 2\.000 s, and the clip begins only at 2\.500 s"):
        fit_sound(click(0.1, 2.0), 2.5, 4.0)
