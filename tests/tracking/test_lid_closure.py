"""Blinks that are seen too low are made whole; what is no blink is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.tracking.lid_closure import find_blinks, with_whole_blinks

Floats = NDArray[np.float64]
LIDS = ("close_t_l_eyelid", "close_b_l_eyelid", "close_t_r_eyelid", "close_b_r_eyelid")
BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")
TIME_S = np.arange(120) / 30


def lids(closing: Floats, share: tuple[float, float] = (1.0, 1.0)) -> tuple[Clip, Clip]:
    """A clip whose eyes close by (T,), 1 being shut, seen by a share left and right."""
    parts = [0.87 * share[0], 0.13 * share[0], 0.87 * share[1], 0.13 * share[1]]
    values = 1024 * closing[:, None] * np.array(parts)
    weights = np.clip(closing[:, None] * np.array(share), 0, 1)
    return Clip(TIME_S, LIDS, values), Clip(TIME_S, BLINKS, weights)


def bumps(times: tuple[float, ...], width_s: float = 0.06, height: float = 1.0) -> Floats:
    return height * sum(
        (np.exp(-0.5 * ((TIME_S - t) / width_s) ** 2) for t in times), np.zeros(len(TIME_S))
    )


@pytest.mark.parametrize("share", [(0.7, 0.8), (1.1, 1.0), (0.65, 0.65)])
def test_blinks_end_with_the_lids_together(share: tuple[float, float]) -> None:
    true, _ = lids(bumps((1.0, 2.5)))

    faps, weights = with_whole_blinks(*lids(bumps((1.0, 2.5)), share))

    assert np.allclose(faps.values, true.values, atol=3.0)
    assert weights.values[30].min() > 0.98


def test_a_blink_of_5_hz_is_one() -> None:
    closing = np.clip(np.sin(2 * np.pi * 5 * TIME_S), 0, 1) * (TIME_S > 1)

    faps, _ = with_whole_blinks(*lids(closing, (0.75, 0.75)))

    peak = (faps["close_t_l_eyelid"] + faps["close_b_l_eyelid"]).max() / 1024
    assert 0.95 < peak < 1.1


def test_wide_eyes_are_left_as_they_are() -> None:
    closing = bumps((1.0,)) - 0.3 * bumps((3.0,), 0.2)
    given, weights = lids(closing, (0.7, 0.7))

    found, _ = with_whole_blinks(given, weights)

    wide = closing < 0
    assert np.array_equal(found.values[wide], given.values[wide])


@pytest.mark.parametrize(
    "closing",
    [bumps((2.0,), 0.6, 0.6), bumps((1.0, 2.0), 0.06, 0.4), np.zeros(120)],
    ids=["squint", "flutter", "nothing"],
)
def test_what_is_no_blink_changes_nothing(closing: Floats) -> None:
    given = lids(closing)

    found = with_whole_blinks(*given)

    assert all(np.array_equal(a.values, b.values) for a, b in zip(found, given, strict=True))


def test_frames_without_a_face_stay_unset() -> None:
    faps, weights = lids(bumps((1.0, 3.0)), (0.7, 0.7))
    values = np.array(faps.values)
    values[50:60] = np.nan
    gone = Clip(TIME_S, LIDS, values)

    found, _ = with_whole_blinks(gone, weights)

    assert np.isnan(found.values[50:60]).all()
    assert find_blinks(gone).frames.tolist() == [30, 90]
