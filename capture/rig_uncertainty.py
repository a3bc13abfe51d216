"""What a rig's calibration amounts to in millimetres where the face is.

Two errors make a triangulated point uncertain. The calibration's is the same in every frame of a
take: it bends space a little, and all points share it. A spot's noise is new in every frame and
for every point. They are told apart here, to first order, from the calibration's joint covariance.

That a whole rig may be turned or shifted harms nobody: what matters is how the points of a face
lie to each other. So errors are told after the rigid motion is taken off that lays a face-sized
set of points best over its true places; shape, size and bending remain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import readonly
from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from .bundle import root_of, rotations
from .projection import camera_of, intrinsics_of, project_one, selection
from .rigs import RigCalibration

Floats = NDArray[np.float64]
#: Of a coordinate of a marker's picture, px, where the user does not say.
SPOT_SD_PX = 0.1
GAUGES = ("rigid", "similarity", "camera")
_LEAST_POINTS = 3


@dataclass(frozen=True, eq=False)
class TriangulationSd:
    """How far triangulated points lie from where they are, to first order.

    Attributes
    ----------
    points : (N, 3) float64, mm, world frame
    root : (N, 3, S) float64, mm
        The calibration's part: error = root @ z, with S independent standard normal numbers z that
        all points share, in every frame. NaN for points that fewer than two cameras see.
    noise_covariance : (N, 3, 3) float64, mm²
        A spot's part: of each point by itself, anew in every frame.
    n_cameras : (N,) int64
        That see the point.
    """

    points: Floats
    root: Floats
    noise_covariance: Floats
    n_cameras: NDArray[np.int64]

    @property
    def calibration_mm(self) -> Floats:
        """(N,) root mean square distance (in 3-D) that the calibration displaces a point by."""
        return np.asarray(np.sqrt((self.root**2).sum(axis=(1, 2))))

    @property
    def noise_mm(self) -> Floats:
        """(N,) root mean square distance (in 3-D) that a spot's noise displaces a point by."""
        return np.asarray(np.sqrt(np.trace(self.noise_covariance, axis1=1, axis2=2)))

    @property
    def total_mm(self) -> Floats:
        """(N,) both together."""
        return np.hypot(self.calibration_mm, self.noise_mm)

    def distance_sd_mm(self, a: int, b: int) -> float:
        """Standard deviation of the distance of two points that the calibration causes."""
        apart = self.points[b] - self.points[a]
        way = apart / np.linalg.norm(apart)
        return float(np.linalg.norm(way @ (self.root[b] - self.root[a])))


def triangulation_sd_mm(
    found: RigCalibration,
    points: ArrayLike,
    *,
    spot_sd_px: float = SPOT_SD_PX,
    gauge: str = "rigid",
    relative_to: ArrayLike | None = None,
    visible: ArrayLike | None = None,
) -> TriangulationSd:
    """How far points, triangulated with a calibrated rig, lie from where they are.

    Parameters
    ----------
    found : RigCalibration
        Lenses that it did not estimate count as exact.
    points : (N, 3) float, mm, world frame
    spot_sd_px : float
        Standard deviation of a coordinate of a spot's place in a picture.
    gauge : str
        What is taken off the calibration's errors: ``"rigid"``, the rigid motion that lays the
        points of `relative_to` best over their true places; ``"similarity"``, their size too;
        ``"camera"``, nothing: errors are those in the frame of the first camera, which is held.
    relative_to : (M, 3) float, mm, world frame, optional
        Three points or more; by default `points`.
    visible : (N, C) bool, optional
        Which cameras see which point, in the order of the rig; by default all in whose picture it
        lies.

    Returns
    -------
    TriangulationSd

    Raises
    ------
    InputError
        If two cameras or more see fewer than three of `relative_to`.
    ValueError
        If an array has another shape, or there is no such gauge.
    """
    if gauge not in GAUGES:
        raise ValueError(f"gauge must be one of {', '.join(GAUGES)}, not {gauge}")
    X = readonly(points, (None, 3), "points")
    seen = _in_picture(found.rig, X)
    if visible is not None:
        seen = seen & readonly(visible, seen.shape, "visible", np.bool_)
    by_state, noise = _propagated(found, X, seen, spot_sd_px)
    root = by_state @ root_of(found.joint_covariance)
    if gauge != "camera":
        if relative_to is None:
            there, moved = X, root
        else:
            there = readonly(relative_to, (None, 3), "relative_to")
            by_state, _ = _propagated(found, there, _in_picture(found.rig, there), spot_sd_px)
            moved = by_state @ root_of(found.joint_covariance)
        root = root - _fitted_motion(X, there, moved, with_size=gauge == "similarity")
    return TriangulationSd(X, root, noise, seen.sum(axis=1))


def sample_rigs(found: RigCalibration, n: int, rng: np.random.Generator) -> Iterator[Rig]:
    """Rigs as they may really be, drawn from the joint covariance: for Monte Carlo.

    Parameters
    ----------
    found : RigCalibration
    n : int
    rng : numpy Generator
    """
    draws = rng.normal(size=(n, len(found.joint_covariance))) @ root_of(found.joint_covariance).T
    for draw in draws:
        moved = {}
        for name, camera in found.rig.cameras.items():
            inner, outer = found.columns(name)
            row, model = intrinsics_of(camera)
            row = row + _free(found.parameters[name]) @ draw[inner]
            turn = rotations(draw[outer][:3]) @ camera.camera_from_world.rotation
            centre = camera.position + draw[outer][3:]
            pose = Rigid.from_rotation(turn, -turn @ centre)
            moved[name] = camera_of(row, model, camera.image_size, pose)
        yield Rig(moved)


def _free(names: tuple[str, ...]) -> Floats:
    moves = {n: ({"fx": 1.0, "fy": 1.0} if n == "f" else {n: 1.0}) for n in names}
    return selection(moves)[1]


def _in_picture(rig: Rig, points: Floats) -> NDArray[np.bool_]:
    """Which cameras have which points in their pictures, (N, C)."""
    seen = []
    for camera in rig.cameras.values():
        at, size = camera.project(points), np.array(camera.image_size)
        with np.errstate(invalid="ignore"):
            seen.append(((at > -0.5) & (at < size - 0.5)).all(axis=1))
    return np.stack(seen, axis=1)


def _propagated(
    found: RigCalibration, X: Floats, seen: NDArray[np.bool_], spot_sd_px: float
) -> tuple[Floats, Floats]:
    """Derivatives of triangulated points by the state, (N, 3, S), and their noise, (N, 3, 3).

    Points are where the sum of squared errors is least, of undistorted coordinates times the focal
    length, as `tracking.triangulation` has it. With A the error's derivative by the point and J
    that by the camera's state, a change e of the state moves the point by -(ΣA'A)⁻¹ ΣA'J e.
    """
    size = len(found.joint_covariance)
    normal, mixed = np.zeros((len(X), 3, 3)), np.zeros((len(X), 3, size))
    spread = np.zeros((len(X), 3, 3))
    for i, (name, camera) in enumerate(found.rig.cameras.items()):
        row, model = intrinsics_of(camera)
        R = camera.camera_from_world.rotation
        p = np.ascontiguousarray(camera.camera_from_world.apply(X))
        mine = np.ascontiguousarray(seen[:, i])
        by_row, by_place, to_ideal = _derivatives(row, model, camera.focal_px, p, mine)
        A = by_place @ R
        inner, outer = found.columns(name)
        J = np.zeros((len(X), 2, size))
        J[:, :, inner] = by_row @ _free(found.parameters[name])
        # p = exp(δ) R (X - C): dp = δ × p - R dC
        J[:, :, outer.start : outer.start + 3] = np.cross(p[:, None], by_place)
        J[:, :, outer.start + 3 : outer.stop] = -A
        normal += A.transpose(0, 2, 1) @ A
        mixed += A.transpose(0, 2, 1) @ J
        half = A.transpose(0, 2, 1) @ to_ideal
        spread += half @ half.transpose(0, 2, 1)
    known = seen.sum(axis=1) >= 2
    by_state, noise = np.full((len(X), 3, size), np.nan), np.full((len(X), 3, 3), np.nan)
    inverse = np.linalg.inv(normal[known])
    by_state[known] = -inverse @ mixed[known]
    noise[known] = inverse @ spread[known] @ inverse * spot_sd_px**2
    return by_state, noise


@njit(cache=True, nogil=True)
def _derivatives(row, model, focal, points, seen):  # type: ignore[no-untyped-def]
    """Of undistorted coordinates times the focal length, by intrinsics, place and pixel.

    (N, 2, 16), (N, 2, 3) and (N, 2, 2); zero where the point is not seen.
    """
    n = len(points)
    by_row, by_place = np.zeros((n, 2, 16)), np.zeros((n, 2, 3))
    to_ideal = np.zeros((n, 2, 2))
    uv, J_row, J_point = np.zeros(2), np.zeros((2, 16)), np.zeros((2, 3))
    for i in range(n):
        x, y, z = points[i]
        if not seen[i] or not project_one(row, model, x, y, z, uv, J_row, J_point):
            continue
        J = J_point[:, :2] * z
        det = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
        M = np.array([[J[1, 1], -J[0, 1]], [-J[1, 0], J[0, 0]]]) * (focal / det)
        by_row[i], by_place[i], to_ideal[i] = M @ J_row, M @ J_point, M
    return by_row, by_place, to_ideal


def _fitted_motion(X: Floats, there: Floats, moved: Floats, *, with_size: bool) -> Floats:
    """At X, the small motion that fits the errors (M, 3, S) of points `there` best, (N, 3, S)."""
    known = np.isfinite(moved).all(axis=(1, 2))
    if known.sum() < _LEAST_POINTS:
        raise InputError(
            f"two cameras or more see {int(known.sum())} of the {len(there)} points that errors "
            f"are told relative to: {_LEAST_POINTS} are the least"
        )
    middle = there[known].mean(axis=0)
    reach = float(np.abs(there[known] - middle).max()) or 1.0
    Q = _motions((there[known] - middle) / reach, with_size).reshape(3 * int(known.sum()), -1)
    fitted = np.linalg.lstsq(Q, moved[known].reshape(len(Q), -1), rcond=None)[0]
    return np.asarray(_motions((X - middle) / reach, with_size) @ fitted)


def _motions(p: Floats, with_size: bool) -> Floats:
    """How points move under small translations, rotations and growth, (N, 3, 6 or 7)."""
    found = np.zeros((len(p), 3, 7))
    found[:, :, :3] = np.eye(3)
    found[:, :, 3:6] = np.cross(np.eye(3)[None], p[:, None]).transpose(0, 2, 1)
    found[:, :, 6] = p
    return found if with_size else found[:, :, :6]
