"""What moves an animated head, as blendshapes and their weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.errors import InputError
from .animation import HeadAnimation
from .shape_solver import ShapeDeformer

#: More shapes than this in one file are refused.
MAX_FRAME_SHAPES = 600
#: A motion below this, mm, is none.
STILL_MM = 1e-6
#: Curves this alike (in parts of their largest value) become one blendshape.
_ALIKE = 1e-6


@dataclass(frozen=True, eq=False)
class MotionCurves:
    """What moves the deformer's points, as blendshapes and weights.

    Attributes
    ----------
    names : tuple of str, length K
    weights : (T, K) float64, in [0, 1]
    amounts : (3 N, K) sparse float64, mm
        Displacements of all points at weight 1, row ``3 n + axis``.
    """

    names: tuple[str, ...]
    weights: NDArray[np.float64]
    amounts: sparse.csc_matrix


def motion_curves(animation: HeadAnimation) -> MotionCurves:
    """One curve for each point and axis that moves; proportional ones are joined.

    A curve is named after its point and axis, ``fp_8.3_x``, joined ones after the first and how
    many more there are, ``fp_8.3_x+1``. One that also goes the other way has a second shape for
    that, ``fp_8.3_x_back``, because many programs cut off weights below 0. Curves of a head's own
    shapes (`ShapeDeformer`) are never joined, bear the shapes' names, and are the shapes at
    weight 1.
    """
    n_shapes = len(_shape_names(animation))
    moved = animation.displacements.reshape(len(animation), -1)
    peak_at = np.abs(moved).argmax(axis=0)
    peak = moved[peak_at, np.arange(moved.shape[1])]
    used = np.flatnonzero(np.abs(peak) > STILL_MM)
    of_points = used[used >= 3 * n_shapes]
    of_shapes = used[(used < 3 * n_shapes) & (used % 3 == 0)]
    points = _joined_curves(animation.point_names, moved, peak, of_points)
    return _behind_shapes(animation, moved, of_shapes, points)


def _shape_names(animation: HeadAnimation) -> tuple[str, ...]:
    deformer = animation.deformer
    return deformer.shape_names if isinstance(deformer, ShapeDeformer) else ()


def _behind_shapes(
    animation: HeadAnimation,
    moved: NDArray[np.float64],
    used: NDArray[np.intp],
    points: MotionCurves,
) -> MotionCurves:
    """Curves of the shapes in use, then those of the points."""
    if not len(used):
        return points
    names = _shape_names(animation)
    place = (used, np.arange(len(used)))
    ones = sparse.csc_matrix((np.ones(len(used)), place), (moved.shape[1], len(used)))
    return MotionCurves(
        tuple(names[i // 3] for i in used) + points.names,
        np.concatenate([moved[:, used], points.weights], axis=1),
        sparse.hstack([ones, points.amounts]).tocsc(),
    )


def _joined_curves(
    point_names: tuple[str, ...],
    moved: NDArray[np.float64],
    peak: NDArray[np.float64],
    used: NDArray[np.intp],
) -> MotionCurves:
    curves = moved[:, used] / peak[used]
    members: list[list[int]] = []
    firsts: list[NDArray[np.float64]] = []
    for i, curve in enumerate(curves.T):
        for group, first in zip(members, firsts, strict=True):
            if np.abs(curve - first).max() < _ALIKE:
                group.append(i)
                break
        else:
            members.append([i])
            firsts.append(curve)
    return _one_way(point_names, used, peak, members, firsts, len(moved), moved.shape[1])


def _one_way(
    point_names: tuple[str, ...],
    used: NDArray[np.intp],
    peak: NDArray[np.float64],
    members: list[list[int]],
    firsts: list[NDArray[np.float64]],
    n_frames: int,
    n_rows: int,
) -> MotionCurves:
    """A blendshape for each way that a curve goes, so that no weight is below 0.

    Between keys the two together are linear as well.
    """
    names: list[str] = []
    weights: list[NDArray[np.float64]] = []
    amounts: list[sparse.coo_matrix] = []
    for group, curve in zip(members, firsts, strict=True):
        rows = used[np.array(group)]
        for way, ending in ((1.0, ""), (-1.0, "_back")):
            largest = float((way * curve).max())
            if largest > _ALIKE:
                names.append(_curve_name(point_names, rows) + ending)
                weights.append(np.maximum(way * curve, 0.0) / largest)
                place = (rows, np.zeros(len(rows), dtype=np.int64))
                amounts.append(sparse.coo_matrix((way * largest * peak[rows], place), (n_rows, 1)))
    if not names:
        return MotionCurves((), np.zeros((n_frames, 0)), sparse.csc_matrix((n_rows, 0)))
    return MotionCurves(tuple(names), np.stack(weights, axis=1), sparse.hstack(amounts).tocsc())


def frame_curves(animation: HeadAnimation) -> MotionCurves:
    """One blendshape for each frame that differs from rest and from those before.

    At a key one weight at most is not 0, between two keys two: vertex animation, for programs that
    bear few shapes at a time. Named after the first frame that has the shape: ``frame_12``.

    Raises
    ------
    InputError
        If there were more than `MAX_FRAME_SHAPES`.
    """
    moved = animation.displacements.reshape(len(animation), -1)
    poses, first, pose_of_frame = np.unique(
        np.round(moved / STILL_MM), axis=0, return_index=True, return_inverse=True
    )
    shown = [k for k in np.argsort(first) if np.abs(poses[k]).max(initial=0.0) > 0]
    if len(shown) > MAX_FRAME_SHAPES:
        raise InputError(
            f"vertex animation makes a shape of every frame: {len(shown)} of them, more than "
            f"{MAX_FRAME_SHAPES}; take a lower rate, a shorter clip, or shapes of the points"
        )
    weights = (pose_of_frame.reshape(-1, 1) == np.array(shown, dtype=np.int64)).astype(np.float64)
    amounts = sparse.csc_matrix(moved[first[shown]].T)
    return MotionCurves(tuple(f"frame_{first[k]}" for k in shown), weights, amounts)


def _curve_name(point_names: tuple[str, ...], rows: NDArray[np.int64]) -> str:
    first = f"fp_{point_names[rows[0] // 3]}_{'xyz'[rows[0] % 3]}"
    return first if len(rows) == 1 else f"{first}+{len(rows) - 1}"
