"""What nobody can see of a rig: where its world is, how it is turned, and how large it is.

Cameras that only see points of unknown place are determined up to a similarity of the world (the
gauge). Changes of a pose are told as (δrotation, shift of the centre), both along the camera's own
axes, rad and mm: R → exp(δ) R, C → C + Rᵀ e. In these a change is the same in every world of the
same size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from .bundle import rotations
from .rays import Pose

Floats = NDArray[np.float64]
_STEPS = 20
_SMALL = 1e-13


def centre_of(pose: Pose) -> Floats:
    """(3,) mm, world: a camera's centre."""
    R, t = pose
    return np.asarray(-R.T @ t)


def change_from_step(poses: Sequence[Pose]) -> Floats:
    """(6 C, 6 C): from a solver's (δrotation, translation) to changes (δrotation, shift)."""
    found = np.eye(6 * len(poses))
    for c, (_, t) in enumerate(poses):
        # C = -R't: R dC = -(dt + t × δ)
        rows = slice(6 * c + 3, 6 * c + 6)
        found[rows, 6 * c : 6 * c + 3] = -_cross(t)
        found[rows, rows] = -np.eye(3)
    return found


def _cross(v: Floats) -> Floats:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def gauge_directions(poses: Sequence[Pose]) -> Floats:
    """How poses change with the world: (6 C, 7) by its rotation, rad, shift, mm, and growth."""
    found = np.zeros((6 * len(poses), 7))
    for c, pose in enumerate(poses):
        R, C = pose[0], centre_of(pose)
        found[6 * c : 6 * c + 3, :3] = -R
        found[6 * c + 3 : 6 * c + 6, :3] = -R @ _cross(C)
        found[6 * c + 3 : 6 * c + 6, 3:6] = R
        found[6 * c + 3 : 6 * c + 6, 6] = R @ C
    return found


def deviation(new: Sequence[Pose], old: Sequence[Pose]) -> Floats:
    """(6 C,): the changes from `old` to `new`."""
    rows = []
    for a, b in zip(new, old, strict=True):
        rows += [Rotation.from_matrix(a[0] @ b[0].T).as_rotvec()]
        rows += [a[0] @ (centre_of(a) - centre_of(b))]
    return np.concatenate(rows)


def changed(pose: Pose, change: Floats) -> Pose:
    """A pose after a change (6,)."""
    centre = centre_of(pose) + pose[0].T @ change[3:]
    R = rotations(change[:3]) @ pose[0]
    return R, -R @ centre


def aligned(new: Sequence[Pose], old: Sequence[Pose], weights: Floats) -> list[Pose]:
    """`new` in the world in which it differs least from `old`.

    Parameters
    ----------
    new, old : C poses
    weights : (6 C,) float64
        Of the squared changes whose sum is made least; 0 for cameras that do not count.
    """
    found = list(new)
    for _ in range(_STEPS):
        N = gauge_directions(found)
        root = np.sqrt(weights)
        step = -np.linalg.lstsq(root[:, None] * N, root * deviation(found, old))[0]
        found = _moved_world(found, np.asarray(step, dtype=np.float64))
        if np.abs(step[[0, 1, 2, 6]]).max() < _SMALL and np.abs(step[3:6]).max() < 1e-9:
            break
    return found


def _moved_world(poses: Sequence[Pose], step: Floats) -> list[Pose]:
    """Poses after a step (7,) of the world along `gauge_directions`, exactly."""
    Q, q, s = rotations(step[:3]), step[3:6], float(np.exp(step[6]))
    found = []
    for pose in poses:
        R = pose[0] @ Q.T
        found.append((R, -R @ (s * Q @ centre_of(pose) + q)))
    return found


def scaled_to(poses: Sequence[Pose], old: Sequence[Pose], steady: Sequence[int]) -> list[Pose]:
    """Poses whose steady cameras' centres are as far apart, on average, as the old ones."""
    rows = list(steady)
    centres = np.stack([centre_of(p) for p in poses])
    wanted = _mean_distance(np.stack([centre_of(old[c]) for c in rows]))
    factor = wanted / _mean_distance(centres[rows])
    middle = centres[rows].mean(axis=0)
    moved = middle + factor * (centres - middle)
    return [(R, -R @ centre) for (R, _), centre in zip(poses, moved, strict=True)]


def _mean_distance(points: Floats) -> float:
    i, j = np.triu_indices(len(points), 1)
    return float(np.linalg.norm(points[i] - points[j], axis=1).mean())


def covariance_in_gauge(
    information: Floats, poses: Sequence[Pose], steady: Sequence[int]
) -> Floats:
    """Covariance of poses, the first camera and the steady ones' mean distance held.

    Parameters
    ----------
    information : (6 C, 6 C) float64
        Of the changes of all poses; the gauge is undetermined in it.
    poses : C poses
    steady : rows of two cameras or more
        The mean distance between their centres is taken as known: the scale.

    Returns
    -------
    (6 C, 6 C) float64
        Of each camera's δrotation and centre (world axes); zero for the first camera.
    """
    held = np.zeros((7, 6 * len(poses)))
    held[:6, :6] = np.eye(6)
    held[6] = _distance_row(poses, steady)
    # rad and mm differ by orders
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    B = null_space(held * scale / np.linalg.norm(held * scale, axis=1, keepdims=True))
    inner = B.T @ (information * np.outer(scale, scale)) @ B
    root = scale[:, None] * B
    found = root @ np.linalg.inv((inner + inner.T) / 2) @ root.T
    to_world = np.eye(6 * len(poses))
    for c, (R, _) in enumerate(poses):
        rows = slice(6 * c + 3, 6 * c + 6)
        to_world[rows, rows] = R.T
    found = to_world @ found @ to_world.T
    found[:6], found[:, :6] = 0.0, 0.0  # but for rounding they are
    return np.asarray(found)


def _distance_row(poses: Sequence[Pose], steady: Sequence[int]) -> Floats:
    """Derivative of the sum of the steady cameras' distances by all changes."""
    row = np.zeros(6 * len(poses))
    for a in steady:
        for b in steady:
            if a < b:
                apart = centre_of(poses[a]) - centre_of(poses[b])
                way = apart / np.linalg.norm(apart)
                row[6 * a + 3 : 6 * a + 6] += poses[a][0] @ way
                row[6 * b + 3 : 6 * b + 6] -= poses[b][0] @ way
    return row
