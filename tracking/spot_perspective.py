"""Where a marker's centre is, given the centre of its picture.

A sphere and a slanted disc are pictured as ellipses, and the middle of such an ellipse is not
where the marker's centre is projected to: a sphere of 5 mm radius, 0.5 m away and 25° off the axis
of a lens of 1500 px, is 0.085 px off.
Lens distortion moves the middle of the picture a little more. Both are undone here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.camera import Camera

Floats = NDArray[np.float64]

_ROUNDS = 6  # each shrinks what is left by the share of the shift in the distance: over 100 fold
_RINGS, _SECTORS = 4, 12  # of an ellipse, to average over the lens's distortion


def sphere_centre(
    camera: Camera, spots: ArrayLike, radius_mm: ArrayLike, distance_mm: ArrayLike
) -> Floats:
    """Where the centres of spheres are projected to, given the middles of their pictures.

    Parameters
    ----------
    camera : Camera
    spots : (..., 2) float, px
        Middles of the pictures' ellipses (centroids of their light).
    radius_mm : float or (...,)
    distance_mm : float or (...,)
        From the camera to the sphere's centre. It need not be exact: 1 % off changes the
        correction by 2 %.

    Returns
    -------
    (..., 2) float64, px
        NaN where a spot is NaN or the camera is inside the sphere.
    """
    radius = np.asarray(radius_mm, dtype=np.float64)
    return _undone(camera, spots, distance_mm, lambda p: sphere_spot(camera, p, radius))


def disc_centre(
    camera: Camera,
    spots: ArrayLike,
    radius_mm: ArrayLike,
    distance_mm: ArrayLike,
    normals: ArrayLike,
) -> Floats:
    """Where the centres of flat discs are projected to, given the middles of their pictures.

    Parameters
    ----------
    camera, spots, radius_mm, distance_mm
        As for `sphere_centre`.
    normals : (..., 3) float, world frame
        Of the discs; either side, any length but zero.

    Returns
    -------
    (..., 2) float64, px
    """
    radius = np.asarray(radius_mm, dtype=np.float64)
    return _undone(camera, spots, distance_mm, lambda p: disc_spot(camera, p, radius, normals))


def sphere_spot(camera: Camera, centres: ArrayLike, radius_mm: ArrayLike) -> Floats:
    """The middles of the pictures of spheres.

    The rays that touch a sphere of radius r at distance D do so on a circle, of radius
    r √(1 - r²/D²), a share 1 - r²/D² of the way to the centre: the sphere is pictured as the disc
    in it.

    Parameters
    ----------
    camera : Camera
    centres : (..., 3) float, mm, world frame
    radius_mm : float or (...,)

    Returns
    -------
    (..., 2) float64, px
        The centroid of the ellipse, exact for a pinhole; with distortion, of its distorted area.
        NaN where the sphere is not wholly before the camera.
    """
    c = camera.camera_from_world.apply(centres)
    radius = np.asarray(radius_mm, dtype=np.float64)
    distance = np.linalg.norm(c, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        seen = 1 - (radius / distance) ** 2
        shrink = np.sqrt(np.where(seen > 0, seen, np.nan))
        normals = c / distance[..., None]
    return _disc_in_camera(camera, c * (shrink**2)[..., None], radius * shrink, normals)


def disc_spot(
    camera: Camera, centres: ArrayLike, radius_mm: ArrayLike, normals: ArrayLike
) -> Floats:
    """The middles of the pictures of flat discs, as of `sphere_spot`.

    Parameters
    ----------
    camera : Camera
    centres : (..., 3) float, mm, world frame
    radius_mm : float or (...,)
    normals : (..., 3) float, world frame
        Of any length but zero.

    Returns
    -------
    (..., 2) float64, px
    """
    c = camera.camera_from_world.apply(centres)
    n = np.asarray(normals, dtype=np.float64) @ camera.camera_from_world.rotation.T
    n = n / np.linalg.norm(n, axis=-1, keepdims=True)
    return _disc_in_camera(camera, c, np.asarray(radius_mm, dtype=np.float64), n)


def _disc_in_camera(camera: Camera, c: Floats, radius: Floats, n: Floats) -> Floats:
    """The middle of a disc's picture.

    The disc's rim is M (cos φ, sin φ, 1) with M = [r a, r b, c], its picture's dual conic
    M diag(1, 1, -1) Mᵀ = r² (1 - n nᵀ) - c cᵀ, and the pole of the line at infinity its middle
    (Hartley & Zisserman 2004, section 2.2).
    """
    r2 = (radius**2)[..., None, None]
    dual = c[..., :, None] * c[..., None, :] - r2 * (np.eye(3) - n[..., :, None] * n[..., None, :])
    depth2 = np.where((dual[..., 2, 2] > 0) & (c[..., 2] > 0), dual[..., 2, 2], np.nan)
    middle = dual[..., :2, 2] / depth2[..., None]
    if camera.distortion_model == "none" or not len(camera.distortion):
        return camera.pixel_from_normalised(middle)
    # the ellipse's matrix of squared half axes: its dual conic about its middle
    spread = (
        middle[..., :, None] * middle[..., None, :] - dual[..., :2, :2] / depth2[..., None, None]
    )
    return _distorted_middle(camera, middle, spread)


def _distorted_middle(camera: Camera, middle: Floats, spread: Floats) -> Floats:
    """Centroid of an ellipse's distorted area: both integrals over the undistorted one."""
    xx, xy, yy = spread[..., 0, 0], spread[..., 0, 1], spread[..., 1, 1]
    with np.errstate(invalid="ignore"):
        a = np.sqrt(xx)
        b = xy / a
        d = np.sqrt(np.maximum(yy - b * b, 0))
    square, weight = np.polynomial.legendre.leggauss(_RINGS)
    rho = np.sqrt((square + 1) / 2)  # equal steps of ρ² are equal areas
    angle = 2 * np.pi * (np.arange(_SECTORS) + 0.5) / _SECTORS
    u = (rho[:, None] * np.cos(angle)).ravel()
    v = (rho[:, None] * np.sin(angle)).ravel()
    x = middle[..., 0, None] + a[..., None] * u
    y = middle[..., 1, None] + b[..., None] * u + d[..., None] * v
    points = np.stack([x, y], axis=-1)
    h = 1e-5
    pixels = camera.pixel_from_normalised(camera.distort(points))
    right = camera.pixel_from_normalised(camera.distort(points + (h, 0.0)))
    below = camera.pixel_from_normalised(camera.distort(points + (0.0, h)))
    dx, dy = (right - pixels) / h, (below - pixels) / h
    area = np.repeat(weight, _SECTORS) * np.abs(dx[..., 0] * dy[..., 1] - dx[..., 1] * dy[..., 0])
    return np.asarray((area[..., None] * pixels).sum(axis=-2) / area.sum(axis=-1)[..., None])


def _undone(
    camera: Camera, spots: ArrayLike, distance_mm: ArrayLike, spot_of: Callable[[Floats], Floats]
) -> Floats:
    """The pixel whose point at the distance is pictured with its middle at the spot."""
    seen = np.asarray(spots, dtype=np.float64)
    distance = np.asarray(distance_mm, dtype=np.float64)[..., None]
    centre = seen
    for _ in range(_ROUNDS):
        points = camera.position + distance * camera.ray(centre)
        centre = centre + (seen - spot_of(points))
    return centre
