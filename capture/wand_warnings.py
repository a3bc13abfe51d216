"""What is wrong with a wand calibration although its residuals may be small."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .rigs import RigCalibration

Floats = NDArray[np.float64]
_CELLS = 6
_LEAST_COVERED = 0.3  # of a picture's cells
_LEAST_THICKNESS = 0.04  # of the space that the wand filled, of its distance from the cameras
_ONE_WAY = 0.9  # share of the wand's directions along one axis
_FEW_MOMENTS = 50
_MUCH_REJECTED, _NEVER_FITS = 0.1, 0.5
_LARGE_PX = 0.75


def wand_warnings(
    found: RigCalibration, balls: Floats, pixels: Floats, share_rejected: Floats
) -> tuple[str, ...]:
    """Warnings in words.

    Parameters
    ----------
    found : RigCalibration
        As solved.
    balls : (B,) float64, mm
    pixels : (C, T, B, 2) float64, px
        All sightings of the rig's cameras, NaN where unseen; in the order of time.
    share_rejected : (B,) float64
        Of each ball's pictures.
    """
    said = []
    if found.unconnected:
        named = ", ".join(found.unconnected)
        said.append(
            f"{named}: shares too few moments with the other cameras, and is left out: wave the "
            "wand where it and another camera both see it"
        )
    said += _moments(found)
    said += _space(found, balls)
    for name, seen in zip(found.rig, pixels, strict=True):
        share = _covered(seen, found.rig[name].image_size)
        if share < _LEAST_COVERED:
            said.append(
                f"{name}: the wand was seen in {100 * share:.0f} % of the picture only: wave it "
                "through the whole space where faces will be"
            )
    odd = np.flatnonzero(share_rejected > _NEVER_FITS)
    for ball in odd:
        said.append(
            f"ball {ball} hardly ever lies where its place on the wand ({balls[ball]:g} mm from "
            "the first) would put it: measure the wand's places anew"
        )
    if share_rejected.mean() > _MUCH_REJECTED and not len(odd):
        share = 100 * share_rejected.mean()
        said.append(f"{share:.0f} % of the balls' pictures do not fit and were left out")
    if found.rms_used_px > _LARGE_PX:
        said.append(
            f"residuals of {found.rms_used_px:.2g} px are large: are the lenses those of these "
            "cameras, the balls' places on the wand right, and the videos in step?"
        )
    return tuple(said)


def _moments(found: RigCalibration) -> list[str]:
    by_view: dict[str, set[str]] = {}
    for camera, view in found.residuals:
        by_view.setdefault(view, set()).add(camera)
    said = []
    for name in found.rig:
        n = sum(name in cameras and len(cameras) > 1 for cameras in by_view.values())
        if n < _FEW_MOMENTS:
            said.append(
                f"{name} shares only {n} moments with others: {_FEW_MOMENTS} and more make its "
                "place sure"
            )
    return said


def _space(found: RigCalibration, balls: Floats) -> list[str]:
    """Whether the wand was everywhere, and pointed everywhere."""
    poses = list(found.view_poses.values())
    middle = np.array([balls.mean(), 0.0, 0.0])
    places = np.stack([pose.apply(middle) for pose in poses])
    ways = np.stack([pose.rotation[:, 0] for pose in poses])
    positions = np.stack([c.position for c in found.rig.cameras.values()])
    distance = float(np.median(np.linalg.norm(places[:, None] - positions[None], axis=2)))
    thin = float(np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[-1])
    thin /= np.sqrt(len(places))
    said = []
    if len(places) < 3 or 2 * thin < _LEAST_THICKNESS * distance:
        said.append(
            f"the wand filled little of the space: it kept within about {4 * thin:.0f} mm in one "
            f"direction, {distance:.0f} mm from the cameras; move it up and down, to the sides, "
            "nearer and farther"
        )
    along = float(np.linalg.eigvalsh(ways.T @ ways / len(ways))[-1])
    if along > _ONE_WAY:
        said.append(
            "the wand always lay in nearly the same direction: turn it while waving, so that the "
            "scale is held in every direction"
        )
    return said


def _covered(pixels: Floats, image_size: tuple[int, int]) -> float:
    """Share of a grid of cells over the picture in which a ball was seen; pixels (T, B, 2)."""
    p = pixels[np.isfinite(pixels[..., 0])]
    at = np.clip(np.floor((p + 0.5) / image_size * _CELLS).astype(int), 0, _CELLS - 1)
    return len(np.unique(at, axis=0)) / _CELLS**2
