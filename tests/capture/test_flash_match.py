"""Flashes in two videos. Truth: a light that rises at once and dies away, seen by known clocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.capture.flash_match import (
    Brightness,
    clear_flashes,
    frame_brightness,
    synchronise_by_flashes,
)
from facewright.capture.flashes import Flash
from facewright.core.errors import InputError
from facewright.core.video_writer import VideoWriter

FRAME_S = 1 / 60
DECAY_S = 0.03
SAME_WITHIN = 0.02  # `synchronise_flash_light`'s own: how alike a flash is for two cameras


def filmed(
    flashes: tuple[float, ...], late_s: float, seed: int, *, n: int = 300, strength: float = 2.0
) -> Brightness:
    """A camera whose clock shows `late_s` more than the world's, and whose frames fall anywhere."""
    rng = np.random.default_rng(seed)
    t = rng.uniform(0, FRAME_S) + np.arange(n) * FRAME_S
    light = np.ones(n)
    strength *= 1 + rng.normal(0, SAME_WITHIN / np.sqrt(2))
    for start in flashes:
        late = t - start
        light += np.where(late >= 0, strength * np.exp(-np.maximum(late, 0) / DECAY_S), 0)
    noise = 1 + rng.normal(0, 2e-3, n)
    return Brightness(np.asarray(t + late_s, np.float64), 50 * light * noise, np.zeros(n))


def found(*words: Brightness, whole: bool = False) -> list[tuple[Flash, ...]]:
    return [clear_flashes(seen, whole=whole) for seen in words]


@pytest.mark.parametrize(("by_light", "limit_s"), [(False, FRAME_S), (True, 0.002)])
def test_offset_is_found_within_what_is_stated(by_light: bool, limit_s: float) -> None:
    z = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        late, flash = rng.uniform(-0.5, 0.5), rng.uniform(1, 2)
        a, b = found(filmed((flash,), 0.0, seed), filmed((flash,), late, 50 + seed), whole=by_light)

        fit = synchronise_by_flashes(a, b, max_offset_s=2, by_light=by_light)

        assert abs(fit.offset_s - late) < limit_s
        z.append((fit.offset_s - late) / fit.offset_sd_s)
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 2.0


def test_flash_that_one_camera_did_not_see_does_no_harm() -> None:
    times = (0.8, 1.9, 3.7)
    a, b = found(filmed(times, 0.0, 1), filmed((times[0], times[2]), 0.31, 2))

    fit = synchronise_by_flashes(a, b)

    assert fit.n_used == 2
    assert abs(fit.offset_s - 0.31) < FRAME_S


def test_faint_flicker_is_no_flash() -> None:
    clear = filmed((1.0,), 0.0, 1)
    faint = filmed((3.0,), 0.0, 1, strength=0.3)
    both = Brightness(clear.time_s, clear.light + faint.light - 50, clear.saturated)

    flashes = clear_flashes(both)

    assert [round(f.time_s) for f in flashes] == [1]


def test_offsets_that_fit_alike_are_refused() -> None:
    a, b = found(filmed((1.0,), 0.0, 1), filmed((1.2, 2.4), 0.0, 2))

    with pytest.raises(InputError, match="as well as at"):
        synchronise_by_flashes(a, b)
    near = synchronise_by_flashes(a, b, max_offset_s=0.5)

    assert abs(near.offset_s - 0.2) < FRAME_S
    with pytest.raises(InputError, match="--max-offset"):
        synchronise_by_flashes(a, b, max_offset_s=0.05)


def test_white_picture_tells_no_light() -> None:
    seen = filmed((1.0,), 0.0, 3)
    white = Brightness(seen.time_s, seen.light, np.where(seen.light > 80, 0.2, 0.0))

    assert len(clear_flashes(white)) == 1
    with pytest.raises(InputError, match="20 % of the picture white"):
        clear_flashes(white, whole=True)


def test_brightness_is_light_above_black(tmp_path: Path) -> None:
    levels = [0, 60, 120, 255]
    with VideoWriter(tmp_path / "limited.mp4", (64, 64), 30, crf=2) as video:
        for level in levels:
            video.write(np.full((64, 64, 3), level, np.uint8))
    with VideoWriter(tmp_path / "full.mkv", (64, 64), 30, lossless=True) as video:
        for level in levels:
            video.write(np.full((64, 64), level, np.uint8))

    limited, full = (frame_brightness(tmp_path / n) for n in ("limited.mp4", "full.mkv"))

    # BT.709: 219 steps of luma for 255 of grey
    np.testing.assert_allclose(limited.light, np.array(levels) * 219 / 255, atol=1.0)
    np.testing.assert_allclose(full.light, levels)
    for seen in (limited, full):
        assert seen.saturated.tolist() == [0, 0, 0, 1]
        np.testing.assert_allclose(seen.time_s, np.arange(4) / 30, atol=1e-3)
