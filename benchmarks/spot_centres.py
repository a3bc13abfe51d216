"""How near the centres of spots come to the bound, and how fast they are found.

    python benchmarks/spot_centres.py [--seeds 6] [--no-torch]

Gaussian spots of σ 1 to 4 px and SNR (peak over the noise's standard deviation) 10 to 100 against
the Cramér-Rao bound and trackpy's locate on the same pictures; discs, whole and slanted; then the
fit against a batched Gauss-Newton fit in torch and kornia's soft argmax, by batch size, on the
processor and on a CUDA device where there is one.

The bound: of white noise of standard deviation s in every pixel, a Gaussian of amplitude A sampled
at every pixel tells each coordinate of its centre with the information
(A / s)² ∫ (x/σ²)² exp(-r²/σ²) dx dy = (A / s)² π / 2, whatever σ is. Amplitude, width and
background are even about the centre, so that not knowing them costs nothing:
sd ≥ √(2/π) s / A = 0.798 / SNR.
(A sloping background is odd; not knowing it costs 3 π / k⁴ of that in a window of k σ.)
Rounding to whole grey levels is counted as noise of variance 1/12.
"""

from __future__ import annotations

import argparse
import platform
import time
import warnings
from collections.abc import Callable
from functools import partial

import numba
import numpy as np
import trackpy
from numpy.typing import NDArray
from scipy import ndimage

from facewright.tracking.blobs import BlobSettings, find_blobs
from facewright.tracking.spot_fit import (
    AMP,
    BACK,
    CX,
    CY,
    N_SPOT,
    SHARP,
    WXX,
    WYY,
    fit_spot,
)
from facewright.tracking.spot_profiles import profile_table

Floats = NDArray[np.float64]
BACKGROUND, PEAK = 60.0, 120.0
LEVEL_SHARE = 0.38
BATCHES = (30, 300, 3000, 30000)
WINDOW = 15  # px, of the batched fits
STEPS = 6


def picture(
    rng: np.random.Generator, spot: Callable[[Floats, Floats], Floats], reach: float, noise: float
) -> tuple[NDArray[np.uint8], Floats]:
    """12 × 12 spots far apart at random places, with noise; their centres (144, 2)."""
    step = int(np.ceil(2 * reach))
    at = float(step) * np.stack(np.meshgrid(np.arange(1, 13), np.arange(1, 13)), axis=-1)
    centres = at.reshape(-1, 2) + rng.uniform(-0.5, 0.5, size=(144, 2))
    level = np.full((step * 13, step * 13), BACKGROUND)
    for cx, cy in centres:
        x0, y0 = int(np.rint(cx)) - step // 2, int(np.rint(cy)) - step // 2
        y, x = np.mgrid[y0 : y0 + step, x0 : x0 + step].astype(np.float64)
        level[y0 : y0 + step, x0 : x0 + step] += PEAK * spot(x - cx, y - cy)
    noisy = level + rng.normal(0, noise, level.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), centres


def gaussian(sigma: float) -> Callable[[Floats, Floats], Floats]:
    """A spot of peak 1."""
    return lambda x, y: np.asarray(np.exp(-(x**2 + y**2) / (2 * sigma**2)))


def disc(a: float, b: float, blur: float = 0.45) -> Callable[[Floats, Floats], Floats]:
    """A slanted disc of half axes a and b, turned by 0.6 rad, through a lens's blur."""
    n, c, s = 8, np.cos(0.6), np.sin(0.6)
    sub = (np.arange(n) + 0.5) / n - 0.5

    def spot(x: Floats, y: Floats) -> Floats:
        fx, fy = (x[0][:, None] + sub).ravel(), (y[:, 0][:, None] + sub).ravel()
        u, v = np.meshgrid(fx, fy)
        inside = ((u * c + v * s) / a) ** 2 + ((v * c - u * s) / b) ** 2 < 1
        fine = ndimage.gaussian_filter(inside.astype(np.float64), blur * n)
        return np.asarray(fine.reshape(len(y), n, x.shape[1], n).mean(axis=(1, 3)))

    return spot


def errors(found: Floats, true: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """(n, 2) px of those found within 1.5 px, and which found spot each is."""
    d = np.linalg.norm(found[None] - true[:, None], axis=2)
    near = d.min(axis=1) < 1.5
    which = d.argmin(axis=1)[near]
    return found[which] - true[near], which


def accuracy(seeds: int) -> None:
    """Tables of Gaussian spots and of discs."""
    print(
        "\n| spot | SNR | RMS px | over the bound | bias px (its sd) | stated sd / RMS | "
        "within 1.96 sd % | found % | trackpy RMS px | trackpy bias px |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    for sigma in (1.0, 1.5, 2.0, 3.0, 4.0):
        for snr in (10.0, 20.0, 50.0, 100.0):
            row(f"Gaussian σ {sigma:g}", gaussian(sigma), 6 * sigma, sigma, snr, seeds, bound=True)
    for a, b in ((2.0, 2.0), (3.5, 3.5), (5.0, 5.0), (5.0, 2.5), (4.0, 1.5), (3.0, 1.2)):
        for snr in (20.0, 100.0):
            row(f"disc {a:g} × {b:g}", disc(a, b), a + 8, (a + b) / 4, snr, seeds, bound=False)


def row(
    name: str, spot: Callable[[Floats, Floats], Floats], reach: float, size: float, snr: float,
    seeds: int, *, bound: bool,
) -> None:  # fmt: skip
    """Measure and print one kind of spot."""
    off, sd, peer_off = [], [], []
    n = 0
    for seed in range(seeds):
        image, true = picture(np.random.default_rng(seed), spot, reach, PEAK / snr)
        blobs = find_blobs(image, BlobSettings(BACKGROUND + LEVEL_SHARE * PEAK))
        e, which = errors(blobs.centres, true)
        off.append(e)
        sd.append(blobs.sd_px[which])
        n += len(true)
        width = 2 * int(np.ceil(3 * size)) + 1
        peer = trackpy.locate(image, width, topn=len(true), separation=reach, engine="numba")
        peer_off.append(errors(peer[["x", "y"]].to_numpy(), true)[0])
    error, stated, peer_error = np.concatenate(off), np.concatenate(sd), np.concatenate(peer_off)
    rms = float(np.sqrt((error**2).mean()))
    least = np.sqrt(2 / np.pi) * np.hypot(PEAK / snr, np.sqrt(1 / 12)) / PEAK
    bias = np.abs(error.mean(axis=0)).max()
    inside = (np.abs(error) < 1.96 * stated[:, None]).mean()
    print(
        f"| {name} | {snr:g} | {rms:.4f} | {f'{rms / least:.3f}' if bound else ''} "
        f"| {bias:.4f} ({rms / np.sqrt(len(error)):.4f}) "
        f"| {np.sqrt(np.square(stated).mean()) / rms:.2f} | {100 * inside:.1f} "
        f"| {100 * len(error) / n:.1f} | {np.sqrt((peer_error**2).mean()):.4f} "
        f"| {np.abs(peer_error.mean(axis=0)).max():.4f} |"
    )


@numba.njit(cache=False)
def fit_all(windows, x, y, table, starts):  # type: ignore[no-untyped-def]
    """Our fit of windows of one size, one after another."""
    scratch = np.empty((3, len(x)), np.float32)
    for i in range(len(windows)):
        fit_spot(x, y, windows[i], 1e9, table, starts[i], scratch)


def windows_of(rng: np.random.Generator, n: int) -> tuple[NDArray[np.float32], Floats]:
    """n noisy windows of a Gaussian of σ 1.8, SNR 50, and their centres from the middle."""
    half = WINDOW // 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    c = rng.uniform(-0.5, 0.5, size=(n, 2))
    q = (x - c[:, 0, None, None]) ** 2 + (y - c[:, 1, None, None]) ** 2
    light = BACKGROUND + PEAK * np.exp(-q / (2 * 1.8**2))
    return (light + rng.normal(0, PEAK / 50, light.shape)).astype(np.float32), c


def batched(device: str, with_torch: bool) -> None:
    """The same windows by our fit and by torch and kornia."""
    rng = np.random.default_rng(0)
    half = WINDOW // 2
    y, x = (v.ravel().astype(np.float32) for v in np.mgrid[-half : half + 1, -half : half + 1])
    print(
        f"\nRefinement of {WINDOW} × {WINDOW} windows, {device}\n\n"
        "| windows | our fit, one thread, µs each (RMS px) | torch Gauss-Newton | "
        "kornia spatial_soft_argmax2d |\n| --- | --- | --- | --- |"
    )
    for n in BATCHES:
        windows, true = windows_of(rng, n)
        flat = windows.reshape(n, -1)
        start = np.zeros((n, N_SPOT))
        start[:, BACK], start[:, AMP], start[:, SHARP] = BACKGROUND, 0.9 * PEAK, 0.3
        start[:, WXX] = start[:, WYY] = 1 / 1.5**2
        spots = start.copy()
        fit_all(flat[:2], x, y, profile_table(), spots[:2])
        spots = start.copy()
        us = timed(partial(fit_all, flat, x, y, profile_table(), spots), once=True) / n
        rms = np.sqrt(((spots[:, [CX, CY]] - true) ** 2).mean())
        cells = [f"{us:.2f} ({rms:.4f})"]
        if with_torch:
            cells += torch_cells(windows, true, device)
        print(f"| {n} | {' | '.join(cells)} |")


def timed(run: Callable[[], object], *, once: bool = False) -> float:
    """Microseconds, median of 5 runs after one to warm up."""
    times = []
    if not once:
        run()
    for _ in range(1 if once else 5):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return float(np.median(times)) * 1e6


def torch_cells(windows: NDArray[np.float32], true: Floats, device: str) -> list[str]:
    """Times and errors of the batched refinements, copies to the device and back included."""
    import torch
    from kornia.geometry.subpix import spatial_soft_argmax2d

    half = WINDOW // 2
    n = len(windows)
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float32)
    px, py = torch.tensor(x.ravel(), device=device), torch.tensor(y.ravel(), device=device)

    def gauss_newton() -> NDArray[np.float32]:
        grey = torch.from_numpy(windows).to(device).reshape(n, -1)
        # centre, inverse variance, amplitude, background, slopes
        p = torch.tensor([0, 0, 1 / 1.5**2, 0.9 * PEAK, BACKGROUND, 0, 0], device=device)
        p = p.repeat(n, 1)
        for _ in range(STEPS):
            dx, dy = px - p[:, :1], py - p[:, 1:2]
            q = dx * dx + dy * dy
            f = torch.exp(-0.5 * p[:, 2:3] * q)
            af = p[:, 3:4] * f
            rest = grey - af - p[:, 4:5] - p[:, 5:6] * dx - p[:, 6:7] * dy
            columns = (
                af * p[:, 2:3] * dx, af * p[:, 2:3] * dy, -0.5 * af * q, f,
                torch.ones_like(f), dx, dy,
            )  # fmt: skip
            J = torch.stack(columns, dim=2)
            normal = J.transpose(1, 2) @ J
            p = p + torch.linalg.solve(normal, J.transpose(1, 2) @ rest[..., None])[..., 0]
        return np.asarray(p[:, :2].cpu().numpy())

    def soft_argmax() -> NDArray[np.float32]:
        grey = torch.from_numpy(windows).to(device)[None]
        temperature = torch.tensor(0.08, device=device)
        found = spatial_soft_argmax2d(grey, temperature, normalized_coordinates=False)
        return np.asarray(found[0].cpu().numpy()) - half

    cells = []
    for method in (gauss_newton, soft_argmax):
        rms = np.sqrt(((method() - true) ** 2).mean())
        cells.append(f"{timed(method) / n:.2f} ({rms:.4f})")
    return cells


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--no-torch", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(
        f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, numba "
        f"{numba.__version__}, trackpy {trackpy.__version__}; 144 spots a picture, seeds 0 to "
        f"{options.seeds - 1}; peak {PEAK:g}, level at {LEVEL_SHARE:g} of it"
    )
    accuracy(options.seeds)
    devices = ["cpu"]
    if not options.no_torch:
        import torch

        print(f"\ntorch {torch.__version__}, {torch.get_num_threads()} threads")
        if torch.cuda.is_available():
            devices.append("cuda")
    for device in devices:
        batched(device, not options.no_torch)


if __name__ == "__main__":
    main()
