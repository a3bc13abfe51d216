"""Cylindrical range and colour images, as a laser that is led around a head makes them.

A vertical line of laser light, in the plane of the axis, runs around the subject; two cameras look
at it from either side at the triangulation angle, and the better one counts. Where neither sees the
line (occlusion), where it grazes, or where too little light returns (dark hair, pupils), there is
no range: voids at hair, under the chin, in nostrils (Lee, Terzopoulos & Waters 1995, figure 1).

Scan frame: y up along the axis, which runs through the origin; the face looks roughly along +z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.rigid import Rigid
from ..heads.head import Head
from ..heads.srgb import srgb_from_linear
from ..heads.texture_noise import noise_at
from .scan_target import Floats, ScanTarget, Seen, random_tilt

CYLINDER_SIZE = 512
RADIUS_MM = 260.0  # what is farther from the axis is out of the scanner's reach
_TRIANGULATION_RAD = np.radians(30.0)
_CAMERA_MM = 900.0  # from the axis
_ABOVE_MM, _BELOW_CHIN_MM = 22.0, 105.0
_AXIS_BEHIND_MM = 75.0  # of the eyes, about where a head turns
_TILT_RAD, _SHIFT_MM = np.radians(4.0), 8.0
_LEAST_COSINE, _LEAST_RECEIVED = 0.32, 0.20  # the line's image smears out where the laser grazes
_LEAST_SIGNAL = 0.028  # of what white returns
_HAIR_RETURN = 0.55  # hair scatters the line away from the cameras
_SD_MM, _EYE_SD_MM, _HAIR_SD_MM = 0.12, 1.1, 1.4
QUANTUM_MM = 0.1


@dataclass(frozen=True, eq=False)
class CylinderScan:
    """A head's range and colour over a cylinder.

    The point of row i, column j is ``(r sin θj, hi, r cos θj)`` in the scan frame.

    Attributes
    ----------
    range_mm : (512, 512) float64, mm
        From the axis, quantised; NaN in voids.
    colour : (512, 512, 3) uint8, sRGB
        Under the scanner's own lamps; black where the scanner meets nothing.
    angle_rad : (512,) float64
        Of the columns: −π to π, 0 in the face's direction, growing to the subject's left.
    height_mm : (512,) float64
        Of the rows, falling.
    exact_mm : (512, 512) float64, mm
        The true range of all that a ray towards the axis meets, NaN where it meets nothing.
    scan_from_head : Rigid
    """

    range_mm: Floats
    colour: NDArray[np.uint8]
    angle_rad: Floats
    height_mm: Floats
    exact_mm: Floats
    scan_from_head: Rigid

    def __post_init__(self) -> None:
        n = CYLINDER_SIZE
        for name, shape in (
            ("range_mm", (n, n)), ("angle_rad", (n,)), ("height_mm", (n,)), ("exact_mm", (n, n))
        ):  # fmt: skip
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        colour = readonly(self.colour, (n, n, 3), "colour", np.uint8)
        object.__setattr__(self, "colour", colour)


def scan_cylinder(target: ScanTarget, seed: int) -> CylinderScan:
    """Scan a person over a cylinder.

    Parameters
    ----------
    target : ScanTarget
    seed : int
        Of the pose before the scanner and of the noise.
    """
    rng = np.random.default_rng([seed, 90])
    scan_from_head = _placed(target.head, rng)
    n = CYLINDER_SIZE
    angle = np.asarray((np.arange(n) - (n - 1) / 2) * (2 * np.pi / n), dtype=np.float64)
    top, bottom = _span(target, scan_from_head)
    height = top + (np.arange(n) + 0.5) / n * (bottom - top)
    out = np.stack([np.sin(angle), np.zeros(n), np.cos(angle)], axis=1)
    outs = np.broadcast_to(out, (n, n, 3)).reshape(-1, 3)
    up = np.repeat(height, n)[:, None] * (0.0, 1.0, 0.0)
    head_from_scan = scan_from_head.inverse()
    turn = head_from_scan.rotation
    seen = target.look(head_from_scan.apply(RADIUS_MM * outs + up), -outs @ turn.T)
    exact = RADIUS_MM - _along(scan_from_head, seen, outs, up)
    exact[~(exact > 0)] = np.nan  # beyond the axis: the far side, seen through a hole
    towards_laser = (seen.normals * (outs @ turn.T)).sum(axis=1)
    cameras = [
        head_from_scan.apply(_CAMERA_MM * _turned(outs, side * _TRIANGULATION_RAD) + up)
        for side in (-1, 1)
    ]
    received = np.max([target.cosine_from(seen, place) for place in cameras], axis=0)
    valid = _is_valid(seen, towards_laser, received, seed) & np.isfinite(exact)
    with np.errstate(invalid="ignore"):
        sd = _SD_MM / np.sqrt(np.clip(towards_laser, 0.1, 1))
    sd = np.where(seen.on_eye, _EYE_SD_MM, np.where(seen.in_hair, _HAIR_SD_MM, sd))
    measured = exact + sd * rng.standard_normal(len(sd))
    quantised: Floats = np.rint(measured / QUANTUM_MM) * QUANTUM_MM
    valid &= quantised >= QUANTUM_MM
    colour = _pictured(seen, np.nan_to_num(towards_laser), rng)
    return CylinderScan(
        np.asarray(np.where(valid, quantised, np.nan), np.float64).reshape(n, n),
        colour.reshape(n, n, 3),
        angle,
        height,
        exact.reshape(n, n),
        scan_from_head,
    )


def _placed(head: Head, rng: np.random.Generator) -> Rigid:
    """Scan from head: the subject sits a little askew about the axis."""
    R = random_tilt(rng, _TILT_RAD)
    shift = rng.normal(0, _SHIFT_MM, 3) + (0, 0, _AXIS_BEHIND_MM)
    return Rigid.from_rotation(R, shift)


def _span(target: ScanTarget, scan_from_head: Rigid) -> tuple[float, float]:
    """Heights of the scan's upper and lower edge."""
    head = target.head
    skin = head.mesh.vertices[head.part_vertices("skin")]
    crown = float(scan_from_head.apply(skin)[:, 1].max())
    chin = float(scan_from_head.apply(head.points["2.1"])[1])
    return crown + _ABOVE_MM, chin - _BELOW_CHIN_MM


def _along(scan_from_head: Rigid, seen: Seen, outs: Floats, up: Floats) -> Floats:
    """How far the rays ran inwards, mm; NaN where they met nothing."""
    p = scan_from_head.apply(seen.places) - up
    return np.asarray(RADIUS_MM - (p * outs).sum(axis=1))


def _turned(outs: Floats, angle: float) -> Floats:
    """Directions (N, 3) turned about the axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(outs @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]))


def _is_valid(seen: Seen, towards_laser: Floats, received: Floats, seed: int) -> NDArray[np.bool_]:
    """Where enough of the line comes back; hair's return is ragged."""
    ragged = np.zeros(len(seen.hit), np.float32)
    at = seen.places[seen.hit].astype(np.float32)
    ragged[seen.hit] = noise_at(at, 9.0, seed) + 0.7 * noise_at(at, 2.5, seed + 1)
    with np.errstate(invalid="ignore"):
        signal = seen.colour[:, 0] * np.clip(towards_laser, 0, 1) * np.sqrt(received)
        signal = signal * np.where(
            seen.in_hair, _HAIR_RETURN * np.exp(0.9 * ragged), np.exp(0.15 * ragged)
        )
        grazes = towards_laser < _LEAST_COSINE * (1 + 0.15 * ragged)
    is_seen = (received > _LEAST_RECEIVED) & (signal > _LEAST_SIGNAL)
    return np.asarray(seen.hit & ~grazes & is_seen)


def _pictured(seen: Seen, towards: Floats, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Colours (N, 3) under lamps beside the laser."""
    light = seen.colour * (0.25 + 0.85 * np.clip(towards, 0, 1) ** 0.7)[:, None].astype(np.float32)
    light[seen.hit] += 0.004 * rng.standard_normal((int(seen.hit.sum()), 3), dtype=np.float32)
    return srgb_from_linear(np.maximum(light, 0))
