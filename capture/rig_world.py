"""World frames for calibrated rigs, and moving a calibration into one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from .rigs import RigCalibration

Floats = NDArray[np.float64]
#: Axes that enclose no more than this nearly never meet: their nearest point is anywhere.
_LEAST_ANGLE_RAD = np.deg2rad(2.0)
_LEAST_LENGTH = 0.05  # of a mean of unit vectors, to have a direction


def head_from_world(rig: Rig) -> Rigid:
    """The frame of a head that the cameras look at.

    Its origin is the point from which the squared distances to the cameras' optical axes are least.
    y points up, against the mean of what is down in the pictures; z, at right angles to y, towards
    the mean of the cameras' places; x is then to the left of who looks along z.

    Parameters
    ----------
    rig : Rig
        Upright cameras around a subject.

    Returns
    -------
    Rigid
        Head from the rig's present world.

    Raises
    ------
    InputError
        If the axes are nearly parallel, do not meet before the cameras, or the cameras do not
        agree what is up or stand straight above.
    """
    cameras = list(rig.cameras.values())
    origin = _nearest_to_axes(rig)
    behind = [n for n in rig if rig[n].camera_from_world.apply(origin)[2] <= 0]
    if behind:
        raise InputError(
            f"the place where the cameras' axes come nearest lies behind {', '.join(behind)}: the "
            "cameras do not look at one head; use --world camera"
        )
    up = -np.mean([c.camera_from_world.rotation[1] for c in cameras], axis=0)
    y = _direction(up, "the cameras do not agree what is up")
    apart = np.mean([c.position for c in cameras], axis=0) - origin
    level = apart - (apart @ y) * y
    told = "the cameras stand straight above or below what they look at"
    z = _direction(level / max(float(np.linalg.norm(apart)), 1e-9), told)
    R = np.stack([np.cross(y, z), y, z])
    return Rigid.from_rotation(R, -R @ origin)


def in_world(found: RigCalibration, new_from_old: Rigid) -> RigCalibration:
    """The same calibration in another world frame, which is taken to be exactly known."""
    cameras = {
        name: replace(c, camera_from_world=c.camera_from_world @ new_from_old.inverse())
        for name, c in found.rig.cameras.items()
    }
    D = np.eye(len(found.joint_covariance))
    for name in found.rig:  # δrotation is in the camera's own frame; centres turn with the world
        centre = slice(found.columns(name)[1].start + 3, found.columns(name)[1].stop)
        D[centre, centre] = new_from_old.rotation
    return replace(
        found,
        rig=Rig(cameras),
        joint_covariance=D @ found.joint_covariance @ D.T,
        view_poses={view: new_from_old @ pose for view, pose in found.view_poses.items()},
    )


def _nearest_to_axes(rig: Rig) -> Floats:
    """(3,) mm: the least squares of the distances to all optical axes."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for camera in rig.cameras.values():
        axis = camera.camera_from_world.rotation[2]
        across = np.eye(3) - np.outer(axis, axis)
        A, b = A + across, b + across @ camera.position
    # for two axes that enclose α the least eigenvalue is 1 - cos α
    if np.linalg.eigvalsh(A)[0] < len(rig) / 2 * (1 - np.cos(_LEAST_ANGLE_RAD)):
        raise InputError(
            "the cameras look in nearly the same direction: where their axes meet cannot be told; "
            "use --world camera"
        )
    return np.asarray(np.linalg.solve(A, b))


def _direction(vector: Floats, told: str) -> Floats:
    length = float(np.linalg.norm(vector))
    if length < _LEAST_LENGTH:
        raise InputError(f"{told}: there is no head's frame; use --world camera")
    return np.asarray(vector / length)
