"""Centres of spots through video compression: against a Gaussian fit, and how sure they are.

    python benchmarks/codec_centres.py [--seconds 2] [--crf 12 18 23]

Forty spots move smoothly over shaded skin at 60 frames/s, with sensor noise, written lossless and
as H.264. Errors of our centres and of a Gaussian fitted by SciPy to the same decoded pixels; then
how many true places lie within 1.96 stated standard deviations: as single pictures tell them, and
scaled by what the jitter of the decoded centres tells (`place_noise`, which knows no truth).
"""

from __future__ import annotations

import argparse
import platform
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

from facewright.core.errors import InputError
from facewright.core.video import read_frames
from facewright.core.video_writer import VideoWriter
from facewright.tracking.blobs import BlobSettings, find_blobs
from facewright.tracking.spot_noise import place_noise

Floats = NDArray[np.float64]
SIZE, RATE_HZ, LIGHT, LEVEL = (640, 360), 60.0, 150.0, 105.0
GAUSSIAN_EVERY = 5  # frames: SciPy is slow
SPOTS = {"Gaussian σ 1.3": (1.3, 0.0), "Gaussian σ 2.5": (2.5, 0.0), "disc 2.4": (0.0, 2.4),
         "disc 4": (0.0, 4.0)}  # fmt: skip


def take(
    rng: np.random.Generator, sigma: float, radius: float, noise: float, frames: int
) -> Iterator[tuple[NDArray[np.uint8], Floats]]:
    """Pictures (360, 640) and the spots' centres (40, 2), px."""
    w, h = SIZE
    home = np.stack(np.meshgrid(np.linspace(50, w - 50, 8), np.linspace(40, h - 40, 5)), axis=-1)
    home = home.reshape(-1, 2)
    phase, rate_hz = rng.uniform(0, 2 * np.pi, home.shape), rng.uniform(0.2, 1.5, home.shape)
    sway = rng.uniform(2, 10, home.shape)
    y, x = np.mgrid[:h, :w].astype(np.float64)
    skin = 45 + 20 * np.sin(x / 90) * np.cos(y / 70)
    for t in range(frames):
        centres = home + sway * np.sin(phase + 2 * np.pi * rate_hz * t / RATE_HZ)
        image = skin.copy()
        for p in centres:
            x0, y0 = np.rint(p).astype(int) - 13
            tile = np.s_[y0 : y0 + 27, x0 : x0 + 27]
            image[tile] += LIGHT * spot(p - (x0, y0), sigma, radius)
        noisy = image + rng.normal(0, noise, image.shape)
        yield np.clip(np.rint(noisy), 0, 255).astype(np.uint8), centres


def spot(centre: Floats, sigma: float, radius: float) -> Floats:
    """A Gaussian, or a disc through a blur of 0.45 px, in a (27, 27) tile; its peak is 1."""
    n = 1 if sigma else 8
    s = (np.arange(27 * n) + 0.5) / n - 0.5
    r2 = (s - centre[0]) ** 2 + (s[:, None] - centre[1]) ** 2
    if sigma:
        return np.asarray(np.exp(-r2 / (2 * sigma**2)))
    fine = ndimage.gaussian_filter((r2 < radius**2).astype(np.float64), 0.45 * n)
    return np.asarray(fine.reshape(27, n, 27, n).mean(axis=(1, 3)))


def fit_gaussian(image: NDArray[np.uint8], near: Floats, sigma: float) -> Floats:
    """Centre of an elliptic Gaussian on a slope, by SciPy, on 3.5 σ around a place."""
    half = int(np.ceil(3.5 * sigma)) + 1
    x0, y0 = np.rint(near).astype(int) - half
    window = image[y0 : y0 + 2 * half + 1, x0 : x0 + 2 * half + 1].astype(np.float64)
    y, x = np.mgrid[: window.shape[0], : window.shape[1]].astype(np.float64) - half

    def rest(p: Floats) -> Floats:
        dx, dy = x - p[0], y - p[1]
        q = p[2] * dx**2 + 2 * p[3] * dx * dy + p[4] * dy**2
        model = p[5] * np.exp(-q / 2) + p[6] + p[7] * x + p[8] * y
        return np.asarray((model - window).ravel())

    v = 1 / sigma**2
    start = [0.0, 0.0, v, 0.0, v, LIGHT, float(window.min()), 0.0, 0.0]
    found = least_squares(rest, start, method="lm").x[:2]
    return np.asarray(found + (x0 + half, y0 + half))


def measure(path: Path, truth: list[Floats], sigma: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Centres (T, 40, 2) by us, their sd (T, 40), decoded centres by SciPy, and the truth."""
    T, N = len(truth), len(truth[0])
    ours, sd = np.full((T, N, 2), np.nan), np.full((T, N), np.nan)
    gaussians = np.full((T, N, 2), np.nan)
    with closing(read_frames(path, gray=True)) as frames:
        for frame in frames:
            t, true = frame.index, truth[frame.index]
            blobs = find_blobs(frame.image, BlobSettings(LEVEL))
            d = np.linalg.norm(blobs.centres[None] - true[:, None], axis=2)
            near = d.min(axis=1) < 2
            which = d.argmin(axis=1)[near]
            ours[t, near], sd[t, near] = blobs.centres[which], blobs.sd_px[which]
            if t % GAUSSIAN_EVERY == 0:
                for i in range(N):
                    gaussians[t, i] = fit_gaussian(frame.image, true[i], sigma)
    return ours, sd, gaussians, np.array(truth)


def row(folder: Path, name: str, noise: float, crf: int | None, frames: int, seed: int) -> str:
    """Film, decode, measure; a line of the table."""
    sigma, radius = SPOTS[name]
    path, truth = folder / "spots.mkv", []
    options = {"lossless": True} if crf is None else {"crf": crf}
    with VideoWriter(path, SIZE, RATE_HZ, **options) as video:
        for image, centres in take(np.random.default_rng(seed), sigma, radius, noise, frames):
            video.write(image)
            truth.append(centres)
    ours, sd, gaussians, true = measure(path, truth, sigma or radius / 2)
    error = ours - true
    both = np.isfinite(error) & np.isfinite(gaussians)
    ratio = np.sqrt((error[both] ** 2).mean() / ((gaussians - true)[both] ** 2).mean())
    rms = float(np.sqrt(np.nanmean(error**2)))
    z = np.abs(error) / sd[..., None]
    z = z[np.isfinite(z)]
    try:
        noise_of_place = place_noise(ours, sd)
    except InputError as problem:
        return f"| {name} | {noise:g} | {crf} | {rms:.4f} | {ratio:.3f} | {problem} | | | |"
    return (
        f"| {name} | {noise:g} | {'lossless' if crf is None else crf} | {rms:.4f} | {ratio:.3f} "
        f"| {100 * (z < 1.96).mean():.1f} | {np.sqrt((z**2).mean()):.2f} "
        f"| {noise_of_place.scale:.2f} (correlation {noise_of_place.correlation:.2f}) "
        f"| {100 * (z < 1.96 * noise_of_place.scale).mean():.1f} |"
    )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--crf", type=int, nargs="*", default=[12, 18, 23])
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    frames = round(options.seconds * RATE_HZ)
    print(
        f"{platform.machine()}, Python {platform.python_version()}, PyAV {av.__version__}; "
        f"40 spots, {frames} frames of {SIZE[0]}x{SIZE[1]}, x264 veryfast, seed {options.seed}\n"
    )
    print(
        "| spot | sensor noise | crf | RMS px | over a Gaussian fit's | within 1.96 sd %, "
        "one picture | true scale of sd | scale found from jitter | within 1.96 scaled sd % |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    with tempfile.TemporaryDirectory() as folder:
        for name in SPOTS:
            for noise in (2.0, 6.0):
                for crf in (None, *options.crf):
                    print(row(Path(folder), name, noise, crf, frames, options.seed), flush=True)


if __name__ == "__main__":
    main()
