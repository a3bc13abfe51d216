"""How boards that look alike when turned were held: the same for all cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.camera import Camera
from .grid_order import look_alikes
from .lens import BoardView, board_pose, unusable

Floats = NDArray[np.float64]
Pose = tuple[Floats, Floats]
Key = tuple[str, str]


def alternatives(view: BoardView, board: Board) -> list[BoardView]:
    """The view under every way the board may have been held that looks the same; itself first."""
    points = board.object_points()
    index = np.abs(points[None] - view.points[:, None]).max(axis=2).argmin(axis=1)
    found = []
    for order in look_alikes(board):
        to = order[index]
        rows = np.argsort(to)
        found.append(replace(view, points=points[to[rows]], pixels=view.pixels[rows]))
    return found


def agree_on_turns(
    views: Mapping[str, Sequence[BoardView]], lenses: Mapping[str, Camera], board: Board
) -> tuple[dict[str, list[BoardView]], int]:
    """Let all cameras take a board that looks alike when turned to be held the same way.

    Cameras are taken along the pairs that share most views. What the relative pose of two is, is
    tried from each shared view under each turn; the pose that explains the others best says how
    the board was held in each.

    Parameters
    ----------
    views : mapping from camera to its views
        Views of the same name were taken at the same moment.
    lenses : mapping from camera to Camera
    board : Board

    Returns
    -------
    views : dict
        The same views, some of them with the board turned.
    n_turned : int
    """
    settled = {camera: list(seen) for camera, seen in views.items()}
    if len(look_alikes(board)) == 1:
        return settled, 0
    poses = {
        (camera, view.name): _poses(view, lenses[camera], board)
        for camera, seen in views.items()
        for view in seen
        if not unusable(view)
    }
    seen_by = {c: {v for camera, v in poses if camera == c} for c in views}
    cameras = [c for c in views if seen_by[c]]
    choice: dict[tuple[str, str], int] = {}
    while cameras:
        choice |= _component(cameras, seen_by, poses)
        done = {camera for camera, _ in choice}
        cameras = [c for c in cameras if c not in done]
    for (camera, name), turn in choice.items():
        if turn:
            i = next(i for i, v in enumerate(settled[camera]) if v.name == name)
            settled[camera][i] = alternatives(settled[camera][i], board)[turn]
    return settled, sum(turn > 0 for turn in choice.values())


def _poses(view: BoardView, lens: Camera, board: Board) -> list[Pose]:
    return [board_pose(v, lens) for v in alternatives(view, board)]


def _component(
    cameras: Sequence[str], seen_by: Mapping[str, set[str]], poses: Mapping[Key, list[Pose]]
) -> dict[Key, int]:
    """The turn of every view of the cameras that are connected with the first of these."""
    first = cameras[0]
    from_first: dict[str, Pose] = {first: (np.eye(3), np.zeros(3))}
    board_in_first = {v: poses[first, v][0] for v in seen_by[first]}
    choice = {(first, v): 0 for v in seen_by[first]}
    while True:
        left = [c for c in cameras if c not in from_first]
        shared = {c: [v for v in sorted(seen_by[c]) if v in board_in_first] for c in left}
        best = max(left, key=lambda c: len(shared[c]), default=None)
        if best is None or not shared[best]:
            return choice
        known = [board_in_first[v] for v in shared[best]]
        R, t = _best_relative(known, [poses[best, v] for v in shared[best]])
        from_first[best] = R, t
        for v in seen_by[best]:
            placed = [(R.T @ Rb, R.T @ (tb - t)) for Rb, tb in poses[best, v]]
            turn = 0
            if v in board_in_first:
                turn = int(np.argmin([_distance(p, board_in_first[v]) for p in placed]))
            else:
                board_in_first[v] = placed[0]
            choice[best, v] = turn


def _best_relative(known: Sequence[Pose], candidates: Sequence[Sequence[Pose]]) -> Pose:
    """Camera from first, of all those that a view and a turn give."""
    trials = []
    for (Ra, ta), turned in zip(known, candidates, strict=True):
        for Rb, tb in turned:
            R = Rb @ Ra.T
            trials.append((R, tb - R @ ta))
    turns, shifts = np.stack([t[0] for t in trials]), np.stack([t[1] for t in trials])
    cosine = (np.einsum("aij,bij->ab", turns, turns) - 1) / 2
    size = max(float(np.median(np.linalg.norm(shifts, axis=1))), 1e-9)
    apart = np.linalg.norm(shifts[:, None] - shifts[None], axis=2) / size
    off = np.arccos(np.clip(cosine, -1, 1)) + apart
    nearest = off.reshape(len(trials), len(known), -1).min(axis=2)  # the best turn of each view
    return trials[int(np.argmin(np.median(nearest, axis=1)))]


def _distance(a: Pose, b: Pose) -> float:
    """Of two poses: radians, and the shift over the distance."""
    cosine = (float(np.einsum("ij,ij->", a[0], b[0])) - 1) / 2
    size = max(float(np.linalg.norm(b[1])), 1e-9)
    return float(np.arccos(np.clip(cosine, -1, 1)) + np.linalg.norm(a[1] - b[1]) / size)
