"""Where the cameras of a rig roughly stand: each view's own poses, chained along shared views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from .lens import BoardView, board_pose, unusable

Floats = NDArray[np.float64]
#: Camera and view.
Key = tuple[str, str]
#: Rotation (3, 3) and translation (3,), mm.
Pose = tuple[Floats, Floats]
_MIN_SHARED = 1


def views_by_key(views: Mapping[str, Sequence[BoardView]]) -> dict[Key, BoardView]:
    """The views of all cameras by (camera, view)."""
    return {(camera, v.name): v for camera, seen in views.items() for v in seen}


def single_poses(
    views: Mapping[str, Sequence[BoardView]], lenses: Mapping[str, Camera]
) -> dict[Key, Pose]:
    """Camera from target, from each view alone."""
    found = {}
    for (camera, name), view in views_by_key(views).items():
        if not unusable(view):
            found[camera, name] = _target_pose(view, lenses[camera])
    return found


def _target_pose(view: BoardView, lens: Camera) -> Pose:
    import cv2

    if np.ptp(view.points[:, 2]) <= 1e-3 * np.ptp(view.points[:, :2]):
        return board_pose(view, lens)
    _, turn, shift = cv2.solvePnP(
        view.points, lens.undistort(view.pixels), np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
    )
    return cv2.Rodrigues(turn)[0], shift.ravel()


def chain(names: Sequence[str], single: Mapping[Key, Pose]) -> dict[str, Pose]:
    """Camera from first camera, along a spanning tree of the pairs with most shared views."""
    seen_by: dict[str, set[str]] = {n: set() for n in names}
    for camera, view in single:
        seen_by[camera].add(view)
    first = names[0]
    found: dict[str, Pose] = {first: (np.eye(3), np.zeros(3))}
    while True:
        pairs = [
            (len(seen_by[a] & seen_by[b]), a, b)
            for a in found
            for b in names
            if b not in found and len(seen_by[a] & seen_by[b]) >= _MIN_SHARED
        ]
        if not pairs:
            return found
        _, a, b = max(pairs, key=lambda p: p[0])
        R, t = _relative(a, b, sorted(seen_by[a] & seen_by[b]), single)
        Ra, ta = found[a]
        found[b] = R @ Ra, R @ ta + t


def _relative(a: str, b: str, shared: Sequence[str], single: Mapping[Key, Pose]) -> Pose:
    """b from a: the view's pose under which most of the others agree (a median of poses)."""
    candidates = []
    for view in shared:
        (Ra, ta), (Rb, tb) = single[a, view], single[b, view]
        R = Rb @ Ra.T
        candidates.append((R, tb - R @ ta))
    turns = np.stack([c[0] for c in candidates])
    shifts = np.stack([c[1] for c in candidates])
    cosine = (np.einsum("aij,bij->ab", turns, turns) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1))
    apart = np.linalg.norm(shifts[:, None] - shifts[None], axis=2)
    size = max(float(np.median(np.linalg.norm(shifts, axis=1))), 1e-9)
    best = int(np.argmin(np.median(angle + apart / size, axis=1)))
    return candidates[best]


def view_poses(
    kept: Mapping[Key, BoardView],
    single: Mapping[Key, Pose],
    poses: Mapping[str, Pose],
) -> dict[str, Pose]:
    """First camera from target, by the camera that sees most of it."""
    best: dict[str, tuple[int, Pose]] = {}
    for (camera, view), seen in kept.items():
        R, t = poses[camera]
        Rv, tv = single[camera, view]
        placed = R.T @ Rv, R.T @ (tv - t)
        if view not in best or len(seen.points) > best[view][0]:
            best[view] = len(seen.points), placed
    return {view: pose for view, (_, pose) in best.items()}
