"""How sure a calibrated rig is where the face is, in millimetres: over a face, and over a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from .rig_uncertainty import SPOT_SD_PX, TriangulationSd, triangulation_sd_mm
from .rig_world import head_from_world
from .rigs import RigCalibration

Floats = NDArray[np.float64]
#: Width, height and depth of the front of a face, mm.
FACE_MM = (150.0, 220.0, 100.0)
_LEAST_LENGTH = 0.05  # of a mean of unit vectors, to have a direction


@dataclass(frozen=True, eq=False)
class PlaneUncertainty:
    """Uncertainties over a plane that faces the cameras.

    Attributes
    ----------
    world_from_plane : Rigid
        The plane's x goes right and y up as one looks at it from the cameras; z towards them.
    x_mm, y_mm : (W,), (H,) float64
        Columns from the left, rows from the top.
    calibration_mm, noise_mm : (H, W) float64
        As in `TriangulationSd`; NaN where fewer than two cameras see.
    n_cameras : (H, W) int64
    """

    world_from_plane: Rigid
    x_mm: Floats
    y_mm: Floats
    calibration_mm: Floats
    noise_mm: Floats
    n_cameras: NDArray[np.int64]


def face_uncertainty(
    found: RigCalibration, *, world_from_face: Rigid | None = None, spot_sd_px: float = SPOT_SD_PX
) -> TriangulationSd:
    """`triangulation_sd_mm` for points over the front of a face, relative to that face.

    Parameters
    ----------
    found : RigCalibration
    world_from_face : Rigid, optional
        Where the face is, x to the subject's left, y up, z out of it; by default
        `place_of_face`.
    spot_sd_px : float
        As in `triangulation_sd_mm`.

    Raises
    ------
    InputError
        If two cameras or more see fewer than three of its points.
    """
    place = place_of_face(found) if world_from_face is None else world_from_face
    return triangulation_sd_mm(found, place.apply(face_points()), spot_sd_px=spot_sd_px)


def plane_uncertainty(
    found: RigCalibration,
    *,
    distance_mm: float | None = None,
    size_mm: tuple[float, float] = (400.0, 400.0),
    shape: tuple[int, int] = (15, 15),
    spot_sd_px: float = SPOT_SD_PX,
) -> PlaneUncertainty:
    """Uncertainties over a plane before the cameras, relative to a face in its middle.

    Parameters
    ----------
    found : RigCalibration
    distance_mm : float, optional
        From the cameras' mean place, along their mean direction; by default the plane goes
        through the `place_of_face`.
    size_mm : (width, height)
    shape : (rows, columns)
    spot_sd_px : float
        As in `triangulation_sd_mm`.

    Raises
    ------
    InputError
        If two cameras or more see fewer than three points of a face there.
    """
    place = place_of_face(found) if distance_mm is None else facing_frame(found.rig, distance_mm)
    rows, columns = shape
    x = np.asarray((np.arange(columns) + 0.5 - columns / 2) * (size_mm[0] / columns), np.float64)
    y = np.asarray((rows / 2 - 0.5 - np.arange(rows)) * (size_mm[1] / rows), np.float64)
    grid = np.stack([*np.meshgrid(x, y), np.zeros(shape)], axis=-1)
    sd = triangulation_sd_mm(
        found,
        place.apply(grid.reshape(-1, 3)),
        spot_sd_px=spot_sd_px,
        relative_to=place.apply(face_points()),
    )
    return PlaneUncertainty(
        place,
        x,
        y,
        sd.calibration_mm.reshape(shape),
        sd.noise_mm.reshape(shape),
        sd.n_cameras.reshape(shape),
    )


def face_points() -> Floats:
    """Points spread evenly over the front of a face, (32, 3) mm; its middle is the origin.

    x to the subject's left, y up, z out of the face: the front half of an ellipsoid of `FACE_MM`.
    """
    n = 64
    k = np.arange(n) + 0.5
    height, turn = 1 - 2 * k / n, k * np.pi * (1 + np.sqrt(5))  # Fibonacci's sphere
    across = np.sqrt(1 - height**2)
    ball = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    front = ball[ball[:, 2] > 0] - (0, 0, 0.5)
    return np.asarray(front * (FACE_MM[0] / 2, FACE_MM[1] / 2, FACE_MM[2]))


def place_of_face(found: RigCalibration) -> Rigid:
    """World from the face that the cameras are meant for: x to its left, y up, z out of it.

    It is where the optical axes come nearest to each other (`rig_world.head_from_world`). Cameras
    whose axes do not meet before them, such as a parallel pair, look at where the targets of the
    calibration were on average: `facing_frame` at that distance.

    Raises
    ------
    InputError
        If the cameras look all ways, or their axes do not meet and there were no targets.
    """
    try:
        return head_from_world(found.rig).inverse()
    except InputError:
        if not found.view_poses:
            raise
        ahead = facing_frame(found.rig, 0.0).inverse()
        targets = np.array([ahead.apply(pose.translation) for pose in found.view_poses.values()])
        return facing_frame(found.rig, -float(np.median(targets[:, 2])))


def facing_frame(rig: Rig, distance_mm: float) -> Rigid:
    """World from a frame that faces the cameras: x right, y up for them, z towards them.

    Parameters
    ----------
    rig : Rig
    distance_mm : float
        Of its origin from the cameras' mean place, along their mean direction.

    Raises
    ------
    InputError
        If the cameras look all ways.
    """
    cameras = list(rig.cameras.values())
    towards = -np.mean([c.camera_from_world.rotation[2] for c in cameras], axis=0)
    up = -np.mean([c.camera_from_world.rotation[1] for c in cameras], axis=0)
    x = np.cross(up, towards)
    if min(np.linalg.norm(towards), np.linalg.norm(x)) < _LEAST_LENGTH:
        raise InputError("the cameras look all ways: where the face is must be said")
    z = towards / np.linalg.norm(towards)
    x /= np.linalg.norm(x)
    eye = np.mean([c.position for c in cameras], axis=0)
    return Rigid.from_rotation(np.stack([x, np.cross(z, x), z], axis=1), eye - distance_mm * z)
