"""How exactly synthetic markers are drawn: light against truth, truth against closed forms.

    python benchmarks/render_exactness.py [--markers 2000] [--seed 1]

Markers of 1 to 2 mm radius fill pictures of 1280×720, 300 to 2000 mm away, all over the picture,
dots at slants of 0 to 80°. Noise is off. Per lens: RMS distance between the intensity centroid of
each marker's picture and its `outlines`, for linear light before rounding and for 8-bit numbers;
between `outlines` and the projection of the centre in space (the bias of perspective, which truth
includes); and between `outlines` and the centre of the exact ellipse (pinholes only).
"""

from __future__ import annotations

import argparse
import platform
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from facewright import __version__
from facewright.core.camera import Camera
from facewright.datasets_synthetic.discs import Course, Discs
from facewright.datasets_synthetic.lens_light import apply_lens_light
from facewright.datasets_synthetic.marker_painting import Shining, paint_shining
from facewright.datasets_synthetic.optics import NOISELESS, Optics
from facewright.datasets_synthetic.sensor import develop
from facewright.datasets_synthetic.shots import Scene, Shot, half_time_s

Floats = NDArray[np.float64]

PINHOLE = Camera((1280, 720), np.array([[1950.0, 0, 645.0], [0, 1949, 352.0], [0, 0, 1]]))
LENS = replace(
    PINHOLE, distortion_model="opencv", distortion=np.array([-0.15, 0.12, 4e-4, -4e-4, 0.0])
)
SHARP = Optics(psf_px=0.5)
LENSES: dict[str, tuple[Camera, Optics]] = {
    "pinhole, square pixels alone": (PINHOLE, Optics()),
    "pinhole, blur 0.35 px": (PINHOLE, Optics(psf_px=0.35)),
    "pinhole, blur 0.5 px": (PINHOLE, SHARP),
    "distortion, blur 0.5 px": (LENS, SHARP),
    "distortion, blur 0.8 px": (LENS, Optics(psf_px=0.8)),
    "distortion, focus blur, 3 mm pupil": (LENS, replace(SHARP, pupil_mm=3.0)),
    "distortion, half the corner light": (LENS, replace(SHARP, vignetting=0.5)),
    "distortion, 8 ms exposure, 0.5 m/s": (LENS, replace(SHARP, exposure_s=0.008)),
    "distortion, rolling 12 ms, 0.5 m/s": (LENS, replace(SHARP, readout_s=0.012)),
}
PER_PICTURE = 60


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--markers", type=int, default=2000, help="of each kind and lens")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(
        f"facewright {__version__}, seed {options.seed}, {options.markers} markers a row; "
        f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}\n"
    )
    print(
        "| lens | markers | linear light, RMS px | 8 bit, RMS px | perspective bias, largest px "
        "| truth to exact ellipse, largest px |\n| --- | --- | --- | --- | --- | --- |"
    )
    for lens, (camera, optics) in LENSES.items():
        for kind in ("spheres", "dots"):
            rng = np.random.default_rng(options.seed)
            found = [
                errors_of_picture(rng, camera, optics, kind)
                for _ in range(-(-options.markers // PER_PICTURE))
            ]
            light, numbers, bias, ellipse = (np.concatenate(x) for x in zip(*found, strict=True))
            exact = f"{ellipse.max():.1e}" if camera is PINHOLE else ""
            largest = f"{bias.max():.4f}" if np.isfinite(bias).all() else "moving"
            print(
                f"| {lens} | {kind} | {rms(light):.4f} | {rms(numbers):.4f} | {largest} "
                f"| {exact} |",
                flush=True,
            )


def rms(distance: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(distance**2)))


def errors_of_picture(
    rng: np.random.Generator, camera: Camera, optics: Optics, kind: str
) -> tuple[Floats, Floats, Floats, Floats]:
    """Distances, px, of one picture's markers: light, numbers, projected centre, exact ellipse."""
    centres, normals, radius = markers(rng, camera, kind)
    half_s = half_time_s(optics)
    slope = 500 * half_s * rng.normal(size=centres.shape) / np.sqrt(3)
    bend = 5e3 * half_s**2 * rng.normal(size=centres.shape)
    course = Course(centres, slope, bend, half_s) if half_s else Course.still(centres)
    n = len(centres)
    discs = Discs(course, Course.still(normals), radius, np.full(n, kind == "spheres"))
    width, height = camera.image_size
    bare = np.zeros((height, width), np.float32)
    level = bare.copy()
    shot = Shot(camera, optics, 0.0, (Scene(None, None, None),))
    outlines, _ = paint_shining(level, bare, shot, Shining(discs, np.full(n, 0.9), np.zeros(n)), [])
    light = apply_lens_light(level, optics, camera, psf=False)
    image = develop(light, NOISELESS, rng)
    errors = [np.linalg.norm(centroids(x, outlines) - outlines, axis=1) for x in (light, image)]
    bias = np.linalg.norm(outlines - camera.project(centres), axis=1)
    if half_s:
        bias = np.full(n, np.nan)
    exact = camera.pixel_from_normalised(
        [
            ellipse_centre(c, None if kind == "spheres" else m, r)
            for c, m, r in zip(centres, normals, radius, strict=True)
        ]
    )
    return errors[0], errors[1], bias, np.linalg.norm(outlines - exact, axis=1)


def markers(rng: np.random.Generator, camera: Camera, kind: str) -> tuple[Floats, Floats, Floats]:
    """Centres (M, 3) mm, normals (M, 3) and radii (M,) mm, on a jittered grid of the picture."""
    x, y = np.meshgrid(np.arange(64, 1280, 128), np.arange(60, 720, 120))
    at = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-6, 6, (PER_PICTURE, 2))
    depth = np.exp(rng.uniform(np.log(300), np.log(2000), PER_PICTURE))
    centres = np.column_stack([camera.undistort(at), np.ones(PER_PICTURE)]) * depth[:, None]
    ray = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    side = np.cross(ray, rng.normal(size=ray.shape))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    slant = np.deg2rad(rng.uniform(0, 80, PER_PICTURE))[:, None]
    normals = -np.cos(slant) * ray + np.sin(slant) * side
    return centres, normals, rng.uniform(1.0, 2.0, PER_PICTURE)


def centroids(picture: NDArray[np.generic], places: Floats, reach: int = 48) -> Floats:
    """Intensity centroids in windows around places, px."""
    found = []
    for x, y in places:
        x0, y0 = max(round(x) - reach, 0), max(round(y) - reach, 0)
        window = picture[y0 : y0 + 2 * reach + 1, x0 : x0 + 2 * reach + 1].astype(np.float64)
        v, u = np.mgrid[: window.shape[0], : window.shape[1]]
        found.append(
            [(window * u).sum() / window.sum() + x0, (window * v).sum() / window.sum() + y0]
        )
    return np.array(found)


def ellipse_centre(centre: Floats, normal: Floats | None, radius: float) -> Floats:
    """Of a sphere's tangent cone, or of a disc's picture: (2,), normalised coordinates."""
    if normal is None:
        conic = np.outer(centre, centre) - (centre @ centre - radius**2) * np.eye(3)
    else:
        axes = np.linalg.svd(normal[None])[2][1:] * radius
        to_disc = np.linalg.inv(np.column_stack([*axes, centre]))
        conic = to_disc.T @ np.diag([1.0, 1, -1]) @ to_disc
    return np.asarray(-np.linalg.solve(conic[:2, :2], conic[:2, 2]))


if __name__ == "__main__":
    main()
