"""Clocks from sound, flashes and motion, and rolling shutters: against how they were made."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from facewright.capture.flashes import Flash, find_flash, find_flashes
from facewright.capture.lens import BoardView
from facewright.capture.rolling_shutter import estimate_readout
from facewright.capture.synchronise import (
    ClockFit,
    synchronise_flash_light,
    synchronise_flashes,
    synchronise_motion,
    synchronise_sound,
)
from facewright.core.audio import Audio
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.errors import InputError

Floats = NDArray[np.float64]
STRENGTH, DECAY_S = 3.0, 0.03
FRAME_S = 1 / 60


def light(t: float, start: float) -> float:
    """A flash as synthetic takes film it, over the light before."""
    return 1 + (STRENGTH * np.exp(-(t - start) / DECAY_S) if t >= start else 0.0)


def exposed(middle: float, exposure: float, start: float) -> float:
    """Its mean over an exposure, by quadrature."""
    if exposure == 0:
        return light(middle, start)
    low, high = middle - exposure / 2, middle + exposure / 2
    edges = [low, *([start] if low < start < high else []), high]
    whole = sum(quad(light, a, b, args=(start,))[0] for a, b in pairwise(edges))
    return float(whole / exposure)


def film(
    start: float,
    phase: float,
    exposure: float,
    rng: np.random.Generator,
    *,
    delay: Floats | None = None,
    noise: float = 2e-3,
    n: int = 50,
) -> tuple[Floats, Floats]:
    """Times and brightness of frames, (T,), or of rows, (T, H)."""
    t: Floats = np.asarray(phase + np.arange(n) * FRAME_S, dtype=float)
    delays = np.zeros(1) if delay is None else delay
    y = np.array([[exposed(m + d, exposure, start) for d in delays] for m in t])
    y = y * rng.uniform(20, 80, len(delays)) * (1 + rng.normal(0, noise, y.shape))
    return t, y[:, 0] if delay is None else y


@pytest.mark.parametrize("exposure", [0.0, 0.004, 0.008, 0.015])
def test_a_flash_begins_within_what_is_stated(exposure: float) -> None:
    z, inside, n = [], 0, 60
    for seed in range(n):
        rng = np.random.default_rng(seed)
        start = 0.4 + rng.uniform(0, FRAME_S)
        found = find_flashes(*film(start, rng.uniform(0, FRAME_S), exposure, rng), exposure)[0]
        z.append((found.time_s - start) / found.sd_s)
        inside += found.earliest_s <= start <= found.latest_s

    assert inside >= 0.97 * n
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.5, f"{np.sqrt(np.mean(np.square(z))):.2f}"
    assert np.abs(z).max() < 5


def test_a_flash_between_exposures_is_known_to_the_gap_and_no_better() -> None:
    rng = np.random.default_rng(0)
    t, y = film(0.4, 0.4 - 23.5 * FRAME_S, 0.004, rng, noise=1e-5)  # just between two frames
    gap = FRAME_S - 0.004

    time_s, sd_s = find_flash(t, y, 0.004)

    assert sd_s == pytest.approx(gap / np.sqrt(12), rel=0.05)
    assert time_s == pytest.approx(0.4, abs=0.02 * gap)


def test_a_flash_within_an_exposure_is_known_exactly() -> None:
    rng = np.random.default_rng(0)
    t, y = film(0.401, 0.4 - 20 * FRAME_S, 0.008, rng, noise=1e-5)

    time_s, sd_s = find_flash(t, y, 0.008)

    assert time_s == pytest.approx(0.401, abs=1e-4)
    assert sd_s < 2e-4


@pytest.mark.parametrize("exposure", [0.0, 0.002, 0.008])
def test_rows_of_a_rolling_shutter_narrow_a_flash_down(exposure: float) -> None:
    delay = np.linspace(-0.5, 0.5, 48) * 0.014
    off = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        start = 0.3 + rng.uniform(0, FRAME_S)
        t, y = film(start, rng.uniform(0, FRAME_S), exposure, rng, delay=delay, n=36)
        found = find_flashes(t, y, exposure, row_delay_s=delay)[0]
        off.append(found.time_s - start)
        assert found.earliest_s <= start <= found.latest_s
    dead = max(FRAME_S - 0.014 - exposure, 0)
    assert np.abs(off).max() < dead / 2 + 3e-4
    assert np.abs(off).max() < 2e-3


def test_several_flashes_are_told_apart() -> None:
    rng = np.random.default_rng(1)
    starts = (0.4, 1.1, 2.0)
    t = np.arange(180) * FRAME_S
    y = np.array([sum(exposed(m, 0.008, s) - 1 for s in starts) + 1 for m in t])

    found = find_flashes(t, 50 * y * (1 + rng.normal(0, 1e-3, 180)), 0.008)

    assert len(found) == 3
    for flash, start in zip(found, starts, strict=True):
        assert flash.earliest_s <= start <= flash.latest_s


def pair(seed: int, exposure: float, **options: float) -> tuple[float, Flash, Flash]:
    """The true offset between two cameras' times, and what each saw of one flash."""
    rng = np.random.default_rng(seed)
    start, offset = 0.4 + rng.uniform(0, FRAME_S), rng.uniform(-0.1, 0.1)
    a = find_flashes(*film(start, rng.uniform(0, FRAME_S), exposure, rng, **options), exposure)  # type: ignore[arg-type]
    t, y = film(start, rng.uniform(0, FRAME_S), exposure, rng, **options)  # type: ignore[arg-type]
    return offset, a[0], find_flashes(t + offset, y, exposure)[0]


def test_the_light_of_one_flash_brings_two_cameras_within_two_milliseconds() -> None:
    off, z = [], []
    for seed in range(60):
        offset, a, b = pair(seed, 0.008)
        found = synchronise_flash_light(a, b)
        off.append(found.offset_s - offset)
        z.append(off[-1] / found.offset_sd_s)

    assert np.abs(off).max() < 2e-3, f"{1e3 * np.abs(off).max():.2f} ms"
    assert np.sqrt(np.mean(np.square(off))) < 5e-4
    assert np.sqrt(np.mean(np.square(z))) < 1.5


def test_several_flashes_make_the_clock_surer() -> None:
    errors = {1: [], 8: []}  # type: dict[int, list[float]]
    for seed in range(8):
        flashes = [pair(100 * seed + i, 0.008) for i in range(8)]
        for n in errors:
            a = [f.time_s + 3.0 * i for i, (_, f, _) in enumerate(flashes[:n])]
            b = [f.time_s - o + 0.05 + 3.0 * i for i, (o, _, f) in enumerate(flashes[:n])]
            fit = synchronise_flashes(
                a, b, reference_sd_s=[f.sd_s for _, f, _ in flashes[:n]],
                other_sd_s=[f.sd_s for _, _, f in flashes[:n]],
            )  # fmt: skip
            errors[n].append(float(fit.other_s(5.0)) - 5.05)
    rms = {n: float(np.sqrt(np.mean(np.square(e)))) for n, e in errors.items()}
    assert rms[8] < 0.002, f"{1e3 * rms[8]:.2f} ms"
    assert rms[8] < 0.6 * rms[1]


def test_flashes_without_deviations_give_offset_and_drift() -> None:
    a = np.array([0.5, 60.0, 300.0])
    fit = synchronise_flashes(a.tolist(), (2.0 + (1 + 4e-5) * a).tolist())

    assert fit.offset_s == pytest.approx(2.0, abs=1e-9)
    assert fit.drift == pytest.approx(4e-5, rel=1e-6)


def test_bad_flashes_are_told() -> None:
    with pytest.raises(InputError, match="found 2 and 3"):
        synchronise_flashes([1.0, 2.0], [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="found 0 and 0"):
        synchronise_flashes([], [])
    rng = np.random.default_rng(0)
    t = np.arange(60) * FRAME_S
    for dull in (np.ones(60), 50 + rng.normal(0, 1, 60), np.linspace(200, 10, 60)):
        with pytest.raises(InputError, match="no flash"):
            find_flash(t, dull)
    with pytest.raises(InputError, match="finite"):
        find_flash(t, np.full(60, np.nan))
    with pytest.raises(InputError, match="3 frames"):
        find_flash(t[:3], t[:3])
    with pytest.raises(ValueError, match="60 frames and 1 rows"):
        find_flash(t, np.ones(59))


def speech(seconds: float, seed: int = 0) -> Floats:
    """Something that comes and goes as speech does, 48 kHz."""
    rng = np.random.default_rng(seed)
    n = round(seconds * 48000)
    knots = np.arange(0, n + 6000, 6000)
    envelope = np.interp(np.arange(n), knots, rng.uniform(0, 1, len(knots)))
    return np.asarray(0.2 * envelope**2 * rng.standard_normal(n))


def heard(sound: Floats, offset: float, drift: float, seed: int, noise: float = 3e-3) -> Audio:
    """The sound on a clock on which a moment t reads offset + (1 + drift) t; through FFT shifts."""
    n = len(sound)
    own = np.arange(n) / 48000
    world = (own - offset) / (1 + drift)
    base = np.interp(world * 48000, np.arange(n), sound, left=0, right=0)
    base += np.random.default_rng(seed).normal(0, noise, n)
    return Audio(np.clip(base, -1, 1).astype(np.float32), 48000)


@pytest.mark.parametrize(
    ("offset", "drift"), [(0.0, 0.0), (0.7312, 0.0), (-1.2, 5e-5), (0.3, -8e-5)]
)
def test_sound_gives_offset_and_drift(offset: float, drift: float) -> None:
    sound = speech(24.0)

    fit = synchronise_sound(heard(sound, 0, 0, 1), heard(sound, offset, drift, 2))

    at = np.array([2.0, 12.0, 22.0])
    np.testing.assert_allclose(fit.other_s(at), offset + (1 + drift) * at, atol=1e-4)
    assert fit.drift == pytest.approx(drift, abs=1e-5)
    assert fit.n_used > 0.5 * fit.n_given


def test_known_sound_paths_are_taken_off() -> None:
    sound = speech(8.0)
    plain = synchronise_sound(heard(sound, 0, 0, 1), heard(sound, 0.2, 0, 2))
    told = synchronise_sound(
        heard(sound, 0, 0, 1), heard(sound, 0.2, 0, 2), other_delay_s=0.006, reference_delay_s=0.001
    )

    assert told.offset_s == pytest.approx(plain.offset_s - 0.005, abs=1e-9)


def test_sounds_that_have_nothing_in_common_are_told() -> None:
    a, b = speech(8.0, 1), speech(8.0, 2)
    with pytest.raises(InputError, match="no sound in common"):
        synchronise_sound(heard(a, 0, 0, 1), heard(b, 0, 0, 2))
    silent = Audio(np.zeros(48000, np.float32), 48000)
    with pytest.raises(InputError, match="other recording is silent"):
        synchronise_sound(heard(a, 0, 0, 1), silent)
    short = Audio(np.full(20, 0.1, np.float32), 48000)
    with pytest.raises(InputError, match="too short"):
        synchronise_sound(heard(a, 0, 0, 1), short)


def wave(t: Floats) -> Floats:
    return np.column_stack([np.sin(4.1 * t) + 0.4 * np.sin(9.7 * t + 1), np.cos(3.3 * t + 0.5)])


def motion_fit(seed: int, offset: float, drift: float = 0.0, **options: bool) -> ClockFit:
    rng = np.random.default_rng(seed)
    ta = np.arange(0, 6, FRAME_S)
    tb = np.arange(0, 6, FRAME_S) + rng.uniform(0, FRAME_S)
    a = 100 * wave(ta) + rng.normal(0, 0.3, (len(ta), 2))
    turned = np.array([[0.8, 0.3], [-0.5, 1.1], [0.2, -0.7]])
    b = 90 * wave((tb - offset) / (1 + drift)) @ turned.T + 40 + rng.normal(0, 0.3, (len(tb), 3))
    return synchronise_motion(ta, a, tb, b, **options)


def test_motion_gives_the_offset_to_a_fraction_of_a_frame() -> None:
    off, z = [], []
    for seed in range(15):
        offset = float(np.random.default_rng(seed).uniform(-1, 1))
        fit = motion_fit(seed, offset)
        off.append(fit.offset_s - offset)
        z.append(off[-1] / fit.offset_sd_s)

    assert np.abs(off).max() < 0.05 * FRAME_S, f"{np.abs(off).max() / FRAME_S:.3f} frame"
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.6


def test_motion_gives_drift_when_asked() -> None:
    fit = motion_fit(3, 0.2, 4e-4, estimate_drift=True)

    at = np.array([0.5, 3.0, 5.5])
    np.testing.assert_allclose(fit.other_s(at), 0.2 + (1 + 4e-4) * at, atol=0.05 * FRAME_S)


def test_motions_that_cannot_be_compared_are_told() -> None:
    t = np.arange(0, 3, FRAME_S)
    with pytest.raises(InputError, match="nothing moves"):
        synchronise_motion(t, np.ones(len(t)), t, wave(t))
    with pytest.raises(InputError, match="too few frames"):
        synchronise_motion(t[:5], wave(t)[:5], t, wave(t))
    with pytest.raises(InputError, match="overlap"):
        synchronise_motion(t, wave(t), t + 100, wave(t))


CORNERS = parse_board("chessboard:9x6:25").object_points()
K = np.array([[1100.0, 0, 640.0], [0, 1100.0, 360.0], [0, 0, 1]])
CAMERA = Camera(
    (1280, 720), K, distortion_model="opencv", distortion=np.array([-0.1, 0.02, 0, 0, 0])
)


def waved(
    readout: float, seed: int, *, amount: float = 1.0, sd: float = 0.05, n: int = 40
) -> tuple[Floats, list[BoardView]]:
    """A board swung before a camera; each corner is seen when its row is read."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 6, 6)
    middle = CORNERS.mean(axis=0)

    def at(t: Floats) -> Floats:  # each corner at its own time
        sines = amount * np.sin(t[:, None] * np.array([4, 5, 3, 6, 7, 4]) + phase)
        turns = Rotation.from_euler("xyz", sines[:, :3] * (0.3, 0.35, 0.5))
        return np.asarray(turns.apply(CORNERS - middle) + sines[:, 3:] * (70, 40, 60) + (0, 0, 560))

    times: Floats = np.asarray(np.arange(n) * FRAME_S, dtype=float)
    views: list[BoardView] = []
    for k, t in enumerate(times):
        uv = CAMERA.project(at(np.full(54, t)))
        for _ in range(6 if readout else 0):
            uv = CAMERA.project(at(t + readout * (uv[:, 1] / 719 - 0.5)))
        views.append(BoardView(f"frame {k}", CORNERS, uv + rng.normal(0, sd, uv.shape)))
    return times, views


@pytest.mark.parametrize("readout", [0.0, 0.015, -0.008])
def test_a_rolling_shutter_is_measured(readout: float) -> None:
    z = []
    for seed in range(2):
        found = estimate_readout(*waved(readout, seed), CAMERA)
        z.append((found.readout_s - readout) / found.sd_s)
        assert abs(found.readout_s - readout) < 2e-4
        assert bool(found.warnings) == (readout != 0)
    assert np.abs(z).max() < 4


def test_frames_that_are_missing_do_no_harm() -> None:
    times, views = waved(0.012, 5)
    kept = [k for k in range(40) if k not in (7, 20, 21)]
    views[30] = BoardView("cut off", CORNERS[:4], views[30].pixels[:4])

    found = estimate_readout(times[kept], [views[k] for k in kept], CAMERA)

    assert found.readout_s == pytest.approx(0.012, abs=3e-4)
    assert found.n_frames == 36


def test_boards_that_tell_nothing_of_a_shutter_are_told() -> None:
    with pytest.raises(InputError, match="hardly moves"):
        estimate_readout(*waved(0.0, 0, amount=0.0), CAMERA)
    times, views = waved(0.0, 0, n=3)
    with pytest.raises(InputError, match="4 frames in a row"):
        estimate_readout(times, views, CAMERA)
    with pytest.raises(InputError, match="grow"):
        estimate_readout(times[::-1], views, CAMERA)
    with pytest.raises(ValueError, match="a time for each"):
        estimate_readout(times[:2], views, CAMERA)
