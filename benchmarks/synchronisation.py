"""How well clocks are brought into step: from sound, from a flash, from motion.

    python benchmarks/synchronisation.py [--draws 100]

Every draw has its own offset (up to ±0.5 s) and its own phase of the frames. Sound: claps heard by
two microphones of synthetic takes, drift up to 50 ppm. Flash: at once a factor 4, dying away in
30 ms, filmed at 60 frames/s; by its beginning alone, and by its light (`synchronise_flash_light`).
Motion: two cameras' pictures of one moving corner at 60 frames/s. Errors are of the time that the
fit gives for the middle of what was compared; z is the error over the stated deviation.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from facewright import __version__
from facewright.capture.flashes import find_flashes
from facewright.capture.synchronise import (
    ClockFit,
    synchronise_flash_light,
    synchronise_motion,
    synchronise_sound,
)
from facewright.core.audio import Audio
from facewright.datasets_synthetic.clocks import CameraClock
from facewright.datasets_synthetic.take_sound import Clap, HeardSound, clap_source

Floats = NDArray[np.float64]
FRAME_S = 1 / 60
STRENGTH, DECAY_S = 3.0, 0.03
#: Error of the time in the middle, s, and the stated deviation.
Outcome = tuple[float, float]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--draws", type=int, default=100)
    n = parser.parse_args().draws
    print(
        f"facewright {__version__}, seeds 0 to {n - 1}; {platform.machine()}, "
        f"{os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}\n"
    )
    print(
        "| from | RMS ms | 95 % below ms | largest ms | RMS z | limit ms | s each |\n"
        "| --- | --- | --- | --- | --- | --- | --- |"
    )
    rolling = np.linspace(-0.5, 0.5, 480) * 0.012
    studies: dict[str, tuple[Callable[[np.random.Generator], Outcome], float]] = {
        "sound": (sound, 1.0),
        "flash, 8 ms exposure, its beginning": (lambda r: flash(r, 0.008, None, False), 2.0),
        "flash, 8 ms exposure, its light": (lambda r: flash(r, 0.008, None, True), 2.0),
        "flash, 2 ms, rolling shutter 12 ms": (lambda r: flash(r, 0.002, rolling, False), 2.0),
        "flash, 8 ms, rolling shutter 12 ms": (lambda r: flash(r, 0.008, rolling, False), 2.0),
        "motion": (motion, 0.05e3 * FRAME_S),
    }
    for name, (study, limit_ms) in studies.items():
        start = time.perf_counter()
        found = np.array([study(np.random.default_rng(seed)) for seed in range(n)])
        took = (time.perf_counter() - start) / n
        off, z = 1e3 * np.abs(found[:, 0]), found[:, 0] / found[:, 1]
        print(
            f"| {name} | {np.sqrt((off**2).mean()):.3f} | {np.quantile(off, 0.95):.3f} | "
            f"{off.max():.3f} | {np.sqrt((z**2).mean()):.2f} | {limit_ms:.2f} | {took:.2f} |",
            flush=True,
        )


def sound(rng: np.random.Generator) -> Outcome:
    """Five claps in 8 s, heard from 1 m and 1.4 m; the way through the air is known."""
    places = np.array([[0.0, 0, 1000], [300, 0, 1400]])
    claps = tuple(Clap(float(t), int(rng.integers(1 << 30))) for t in rng.uniform(1, 7, 5))
    source = clap_source(np.zeros(3), claps)
    clocks = [CameraClock(), CameraClock(rng.uniform(-0.5, 0.5), rng.uniform(-5e-5, 5e-5))]
    heard = [
        HeardSound((source,), place, clock, seconds=8.5, noise_seed=int(rng.integers(1 << 30)))
        for place, clock in zip(places, clocks, strict=True)
    ]
    delays = [source.delay_s(place) for place in places]
    fit = synchronise_sound(
        *(Audio(h[0 : len(h)], h.rate_hz) for h in heard),
        reference_delay_s=delays[0],
        other_delay_s=delays[1],
    )
    middle = float(np.mean([c.time_s for c in claps]))
    return float(fit.other_s(middle)) - float(clocks[1].clock_s(middle)), fit.offset_sd_s


def flash(
    rng: np.random.Generator, exposure: float, delay: Floats | None, by_light: bool
) -> Outcome:
    """One flash filmed by two cameras."""
    offset, start = rng.uniform(-0.5, 0.5), 0.5 + rng.uniform(0, FRAME_S)
    seen = []
    for late in (0.0, offset):
        t = rng.uniform(0, FRAME_S) + np.arange(60) * FRAME_S
        delays = np.zeros(1) if delay is None else delay
        y = 1 + _glow(t[:, None] + delays - start, exposure)
        y = y * rng.uniform(20, 80, len(delays)) * (1 + rng.normal(0, 2e-3, y.shape))
        brightness = y[:, 0] if delay is None else y
        seen.append(find_flashes(t + late, brightness, exposure, row_delay_s=delay, most=1)[0])
    if by_light:
        fit = synchronise_flash_light(*seen)
        return fit.offset_s - offset, fit.offset_sd_s
    sd = float(np.hypot(seen[0].sd_s, seen[1].sd_s))
    return seen[1].time_s - seen[0].time_s - offset, sd


def _glow(late: Floats, exposure: float) -> Floats:
    """Mean light over exposures whose middles lie `late` after the flash began."""
    opened, closed = (np.maximum(late + s * exposure / 2, 0) for s in (-1, 1))
    light = np.exp(-opened / DECAY_S) - np.exp(-closed / DECAY_S)
    return np.asarray(STRENGTH * DECAY_S * light / exposure)


def motion(rng: np.random.Generator) -> Outcome:
    """A corner waved for 5 s, tracked to 0.1 px by both cameras."""
    rates, phases = rng.uniform(2, 10, (2, 4)), rng.uniform(0, 6, (2, 4))
    offset = rng.uniform(-0.5, 0.5)

    def course(t: Floats) -> Floats:
        return np.sin(t[:, None, None] * rates + phases).sum(axis=2) * 60

    ta = np.arange(300) * FRAME_S
    tb = ta + rng.uniform(0, FRAME_S)
    turned = np.array([[0.8, 0.3], [-0.4, 0.9]])
    a = course(ta) + rng.normal(0, 0.1, (300, 2))
    b = course(tb - offset) @ turned + rng.normal(0, 0.1, (300, 2))
    fit: ClockFit = synchronise_motion(ta, a, tb, b)
    return fit.offset_s - offset, fit.offset_sd_s


if __name__ == "__main__":
    main()
