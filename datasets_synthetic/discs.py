"""Markers as one camera sees them: moving discs, and their outlines in the picture.

A flat dot is a disc. A sphere looks like one too: the rays that touch it do so on a circle, whose
picture is the sphere's outline (nearer and smaller than the great circle: the bias of perspective).
Outlines are points on that circle through the camera's own projection, so nothing of the lens is
approximated; where rows are exposed one after another, each point is taken at the time of the row
it falls on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from .optics import Optics

Floats = NDArray[np.float64]

OUTLINE_POINTS = 64
#: Each step shrinks the error in a row's time by how far things move in it, rows per row.
_MOST_ROW_STEPS, _ROW_TOLERANCE_PX = 60, 1e-9


@dataclass(frozen=True, eq=False)
class Course:
    """Points (..., 3) that move along parabolas around a frame's time.

    Attributes
    ----------
    middle, slope, bend : (..., 3) float64
        ``middle + slope s + bend s²`` with s the time from the frame's in units of `half_s`.
    half_s : float, s
        0 for points that stand still.
    """

    middle: Floats
    slope: Floats
    bend: Floats
    half_s: float

    @classmethod
    def through(cls, before: Floats, middle: Floats, after: Floats, half_s: float) -> Course:
        """Through three instants, `half_s` apart."""
        return cls(middle, (after - before) / 2, (after + before) / 2 - middle, half_s)

    @classmethod
    def still(cls, points: Floats) -> Course:
        """Points that do not move."""
        none = np.zeros_like(points)
        return cls(points, none, none, 0.0)

    @property
    def is_still(self) -> bool:
        """Whether nothing moves."""
        return self.half_s == 0

    def at(self, late_s: Floats | float) -> Floats:
        """At times after the frame's, s, broadcast against the leading axes."""
        if self.is_still:
            return self.middle
        s = np.asarray(late_s)[..., None] / self.half_s
        return np.asarray(self.middle + s * (self.slope + s * self.bend))

    def turned(self, rotation: Floats, translation: Floats | float = 0.0) -> Course:
        """In another frame."""
        return Course(
            self.middle @ rotation.T + translation,
            self.slope @ rotation.T,
            self.bend @ rotation.T,
            self.half_s,
        )

    def minus(self, other: Course) -> Course:
        """Differences to points that move over the same time."""
        return Course(
            self.middle - other.middle,
            self.slope - other.slope,
            self.bend - other.bend,
            self.half_s,
        )

    def rows(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Course:
        """Some of the points."""
        return Course(self.middle[which], self.slope[which], self.bend[which], self.half_s)

    def with_axes(self, count: int) -> Course:
        """The same with `count` axes of length 1 before the last."""
        shape = (*self.middle.shape[:-1], *(1,) * count, 3)
        return Course(
            self.middle.reshape(shape),
            self.slope.reshape(shape),
            self.bend.reshape(shape),
            self.half_s,
        )


def join_courses(courses: list[Course]) -> Course:
    """Points of several courses, one after another."""
    return Course(
        np.concatenate([c.middle for c in courses]),
        np.concatenate([c.slope for c in courses]),
        np.concatenate([c.bend for c in courses]),
        max(c.half_s for c in courses),
    )


@dataclass(frozen=True, eq=False)
class Discs:
    """Markers around a frame's time, in one camera's frame.

    Attributes
    ----------
    centres : Course of (M, 3), mm, camera frame
    normals : Course of (M, 3)
        Of dots; what it holds for spheres is not used.
    radius_mm : (M,) float64
    is_sphere : (M,) bool
    """

    centres: Course
    normals: Course
    radius_mm: Floats
    is_sphere: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.radius_mm)

    def rows(self, which: NDArray[np.int64]) -> Discs:
        """Some of the markers."""
        return Discs(
            self.centres.rows(which),
            self.normals.rows(which),
            self.radius_mm[which],
            self.is_sphere[which],
        )

    def facing(self) -> Floats:
        """(M,) cosine between a dot's normal and the ray to the camera; 1 for spheres."""
        c = self.centres.middle
        cosine = -np.einsum("mx,mx->m", self.normals.middle, c)
        cosine /= np.linalg.norm(c, axis=1) * np.linalg.norm(self.normals.middle, axis=1)
        return np.where(self.is_sphere, 1.0, cosine)

    def points(self, spots: Floats, late_s: Floats) -> Floats:
        """Places on the discs.

        Parameters
        ----------
        spots : (P, 2) float, in radii
            On the disc; the rim is at length 1.
        late_s : (M, N, P) or what broadcasts to it, s

        Returns
        -------
        (M, N, P, 3) float64, mm, camera frame
            NaN for a sphere around the camera.
        """
        c = self.centres.with_axes(2).at(late_s)
        n = self.normals.with_axes(2).at(late_s)
        radius, sphere = self.radius_mm[:, None, None], self.is_sphere[:, None, None, None]
        distance2 = (c * c).sum(axis=-1)
        with np.errstate(invalid="ignore"):
            shrink2 = 1 - radius**2 / distance2
            shrink = np.sqrt(np.where(shrink2 > 0, shrink2, np.nan))
        n = np.where(sphere, -c, n)
        middle = np.where(sphere, c * (shrink**2)[..., None], c)
        radius = radius * np.where(sphere[..., 0], shrink, 1.0)
        n = n / np.linalg.norm(n, axis=-1, keepdims=True)
        a, b = _axes(n, self._reference())
        u, v = spots[:, 0, None], spots[:, 1, None]
        return np.asarray(middle + radius[..., None] * (u * a + v * b))

    def _reference(self) -> Floats:
        """(M, 1, 1, 3): an axis of the camera's that is far from each disc's normal."""
        n = np.where(self.is_sphere[:, None], self.centres.middle, self.normals.middle)
        return np.asarray(np.eye(3)[np.abs(n).argmin(axis=1)][:, None, None])


def _axes(n: Floats, reference: Floats) -> tuple[Floats, Floats]:
    """Two unit axes square to unit vectors."""
    a = np.cross(reference, n)
    a /= np.linalg.norm(a, axis=-1, keepdims=True)
    return a, np.cross(n, a)


def rim(count: int = OUTLINE_POINTS) -> Floats:
    """Corners of a regular polygon of the unit disc's area, (count, 2).

    Seen from anywhere it has very nearly the area and the centroid of the disc's picture.
    """
    angle = 2 * np.pi * np.arange(count) / count
    grown = np.sqrt(2 * np.pi / count / np.sin(2 * np.pi / count))
    return np.asarray(np.stack([np.cos(angle), np.sin(angle)], axis=1) * grown)


def pixels_of(camera: Camera, points: Floats) -> Floats:
    """(..., 2) px of points in the camera frame, (..., 3) mm; NaN where there is none."""
    depth = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    pixels = camera.pixel_from_normalised(camera.distort(points[..., :2] / depth[..., None]))
    return np.asarray(pixels)


def row_delay_s(camera: Camera, optics: Optics, row: Floats) -> Floats:
    """When rows are exposed, against the frame's time, s; rows outside go on evenly."""
    last = max(camera.image_size[1] - 1, 1)
    return np.asarray(optics.readout_s * (row / last - 0.5))


def pictured(
    camera: Camera, optics: Optics, discs: Discs, spots: Floats, late_s: Floats
) -> tuple[Floats, Floats]:
    """Where places on the discs are pictured, each at the time of its row.

    Parameters
    ----------
    camera : Camera
    optics : Optics
    discs : Discs
    spots : (P, 2) float, in radii
    late_s : (N,) float, s
        Instants within the exposure of a row, from its middle.

    Returns
    -------
    (M, N, P, 2) float64, px
        NaN behind the camera.
    (M, N, P, 3) float64, mm, camera frame
    """
    late = late_s[None, :, None]
    rolling = optics.readout_s > 0 and not discs.centres.is_still
    points = discs.points(spots, late)
    pixels = pixels_of(camera, points)
    for _ in range(_MOST_ROW_STEPS if rolling else 0):
        before = pixels
        points = discs.points(spots, late + row_delay_s(camera, optics, pixels[..., 1]))
        pixels = pixels_of(camera, points)
        if not (np.abs(pixels - before) > _ROW_TOLERANCE_PX).any():
            break
    return pixels, points


def pictured_course(camera: Camera, optics: Optics, course: Course) -> Floats:
    """Pixels (M, 2) of moving points (M, 3) of the camera frame, each at the time of its row."""
    pixels = pixels_of(camera, course.at(0.0))
    rolling = optics.readout_s > 0 and not course.is_still
    for _ in range(_MOST_ROW_STEPS if rolling else 0):
        before = pixels
        pixels = pixels_of(camera, course.at(row_delay_s(camera, optics, pixels[..., 1])))
        if not (np.abs(pixels - before) > _ROW_TOLERANCE_PX).any():
            break
    return pixels


def exposure_instants(exposure_s: float, count: int) -> Floats:
    """(count,) instants of an exposure, s from its middle, whose mean square is the exposure's.

    So a parabola's mean over them is its mean over the exposure.
    """
    if count < 2 or exposure_s == 0:
        return np.zeros(1)
    even = (np.arange(count) + 0.5) / count - 0.5
    return np.asarray(exposure_s * even * np.sqrt(count**2 / (count**2 - 1)))
