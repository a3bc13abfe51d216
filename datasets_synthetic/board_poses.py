"""How a calibration board is held before cameras: well, or deliberately badly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid

_TRIES = 200
_EDGE_PX = 5.0  # that stay free around what is printed
_MAX_TILT_RAD = np.deg2rad(45)
_MAX_INCIDENCE_RAD = np.deg2rad(62)  # of the two cameras a view of a rig is meant for
_MAX_SEEN_RAD = np.deg2rad(80)  # a board seen more aslant counts as not seen
#: Where in the picture a view is put, by turns: 0 left or top, 1 right or bottom.
_PLACES = (
    (0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0),
    (0.5, 0.0), (0.0, 0.5), (1.0, 0.5), (0.5, 1.0),
)  # fmt: skip


def camera_poses(
    board: Board, camera: Camera, n_views: int, rng: np.random.Generator, *, poor: bool = False
) -> tuple[Rigid, ...]:
    """Poses (world from board) before one camera, what is printed whole in each picture.

    Parameters
    ----------
    board : Board
    camera : Camera
    n_views : int
    rng : numpy Generator
    poor : bool
        All frontal, in the middle, at one distance: what calibrations fail on. Otherwise tilted by
        up to 45° any way, rolled, near and far, in all parts of the picture.

    Raises
    ------
    InputError
        If the board fits into the picture in no way.
    """
    return tuple(_before_camera(board, camera, view, rng, poor) for view in range(n_views))


def rig_poses(
    board: Board, rig: Rig, n_views: int, rng: np.random.Generator, *, poor: bool = False
) -> tuple[Rigid, ...]:
    """Poses (world from board) before several cameras.

    Each view is meant for two neighbours, by turns, and both see it whole: so that every camera is
    tied to all others. (`poor`: all views for the first two, held still in the middle.)

    Raises
    ------
    InputError
        If two neighbours cannot both see the board.
    """
    cameras = list(rig.cameras.values())
    if len(cameras) == 1:
        return camera_poses(board, cameras[0], n_views, rng, poor=poor)
    pairs = [cameras[i : i + 2] for i in range(len(cameras) - 1)]
    middle = _middle(cameras)
    return tuple(
        _before_pair(board, pairs[0 if poor else view % len(pairs)], middle, rng, poor)
        for view in range(n_views)
    )


def sees(camera: Camera, world_from_board: Rigid, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points of a board, (N, 3) mm, a camera sees: in the picture, and from the front."""
    world = world_from_board.apply(points)
    at = camera.project(world)
    width, height = camera.image_size
    with np.errstate(invalid="ignore"):
        inside = ((at > -0.5) & (at < (width - 0.5, height - 0.5))).all(axis=1)
    rays = world - camera.position
    away = world_from_board.rotation[:, 2]  # the board's z, away from who looks at its front
    slant = rays @ away / np.linalg.norm(rays, axis=1)
    return np.asarray(inside & (slant > np.cos(_MAX_SEEN_RAD)))


def _before_camera(
    board: Board, camera: Camera, view: int, rng: np.random.Generator, poor: bool
) -> Rigid:
    for attempt in range(_TRIES):
        ease = 0.97**attempt  # smaller and less tilted, until it fits
        if poor:
            R = _turned(rng, 0.0, np.deg2rad(2.0), np.deg2rad(2.0))
            share, place = rng.uniform(0.46, 0.5), rng.uniform(0.46, 0.54, 2)
        else:
            roll = np.deg2rad(25.0) + (np.pi / 2 if view % 5 == 4 else 0)
            R = _turned(rng, np.deg2rad(12.0) * ease, _MAX_TILT_RAD * ease, roll)
            share = rng.uniform(0.45, 1.05)
            place = np.clip(_PLACES[view % len(_PLACES)] + rng.normal(0, 0.08, 2), 0, 1)
        pose = _placed(board, camera, R, share * ease, place)
        if pose is not None:
            return pose
    raise InputError(f"the board {board} does not fit into a {camera.image_size} picture")


def _turned(
    rng: np.random.Generator, least_rad: float, most_rad: float, roll_rad: float
) -> NDArray[np.float64]:
    """A rotation: tilted by some amount any way, and rolled by up to `roll_rad`."""
    from scipy.spatial.transform import Rotation

    way, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(least_rad, most_rad)
    tilted = Rotation.from_rotvec(tilt * np.array([np.cos(way), np.sin(way), 0]))
    rolled = Rotation.from_rotvec([0, 0, rng.uniform(-roll_rad, roll_rad)])
    return np.asarray((tilted * rolled).as_matrix())


def _placed(
    board: Board, camera: Camera, R: NDArray[np.float64], share: float, place: NDArray[np.float64]
) -> Rigid | None:
    """A pose with what is printed at a place (0..1) of the picture, so far that its longer side
    fills a share of the picture's height; None where it does not fit."""
    width, height = camera.image_size
    outline = _outline(board)
    middle = outline.mean(axis=0)
    longer = float(np.ptp(outline[:, :2], axis=0).max())
    depth = camera.focal_px * longer / (share * height)
    aim = np.array([(width - 1) / 2, (height - 1) / 2])
    room = np.array([width - 1, height - 1])
    for _ in range(8):
        ray = np.append(camera.undistort(aim), 1.0)
        if not np.isfinite(ray).all():
            return None
        pose = Rigid.from_rotation(R, depth * ray - R @ middle)
        in_world = camera.camera_from_world.inverse() @ pose
        at = camera.project(in_world.apply(outline))
        if not np.isfinite(at).all():
            return None
        low, high = at.min(axis=0), at.max(axis=0)
        slack = room - 2 * _EDGE_PX - (high - low)
        if (slack < 0).any():
            return None
        wanted = _EDGE_PX + place * slack
        if np.abs(wanted - low).max() < 1.0:
            return in_world
        aim = aim + (wanted - low)
    return in_world if (low > 0).all() and (high < room).all() else None


def _before_pair(
    board: Board,
    pair: Sequence[Camera],
    middle: NDArray[np.float64],
    rng: np.random.Generator,
    poor: bool,
) -> Rigid:
    outline = _outline(board)
    between = (pair[0].position + pair[1].position) / 2
    distance = float(np.linalg.norm(middle - between))
    spread = distance * (0.01 if poor else 0.12)
    for attempt in range(_TRIES):
        ease = 0.98**attempt
        target = middle + rng.normal(0, spread * ease, 3)
        R = _facing(between - target) @ (
            _turned(rng, 0.0, np.deg2rad(2.0), np.deg2rad(2.0))
            if poor
            else _turned(rng, 0.0, np.deg2rad(35.0) * ease, np.deg2rad(40.0))
        )
        pose = Rigid.from_rotation(R, target - R @ outline.mean(axis=0))
        if all(_is_whole(camera, pose, outline) for camera in pair):
            return pose
    raise InputError(
        f"the board {board} is too large for what two neighbouring cameras both see: "
        "take a board of smaller squares, or of fewer"
    )


def _facing(towards: NDArray[np.float64]) -> NDArray[np.float64]:
    """World from board axes: z away from `towards`, y down (world y is up)."""
    z = -towards / np.linalg.norm(towards)
    x = np.cross((0.0, -1.0, 0.0), z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _is_whole(camera: Camera, pose: Rigid, outline: NDArray[np.float64]) -> bool:
    at = camera.project(pose.apply(outline))
    size = np.array(camera.image_size)
    if not np.isfinite(at).all() or (at < _EDGE_PX).any() or (at > size - 1 - _EDGE_PX).any():
        return False
    ray = pose.apply(outline.mean(axis=0)) - camera.position
    slant = ray @ pose.rotation[:, 2] / np.linalg.norm(ray)
    return bool(slant > np.cos(_MAX_INCIDENCE_RAD))


def _outline(board: Board) -> NDArray[np.float64]:
    """Points along the edge of what is printed, (n, 3) mm."""
    x0, y0, x1, y1 = board.printed_box
    s = np.linspace(0, 1, 9)[:-1]
    x = np.concatenate([x0 + (x1 - x0) * s, 0 * s + x1, x1 - (x1 - x0) * s, 0 * s + x0])
    y = np.concatenate([0 * s + y0, y0 + (y1 - y0) * s, 0 * s + y1, y1 - (y1 - y0) * s])
    return np.stack([x, y, 0 * x], axis=1)


def _middle(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """The point nearest to all optical axes, (3,) mm."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        axis = camera.camera_from_world.rotation[2]
        across = np.eye(3) - np.outer(axis, axis)
        A, b = A + across, b + across @ camera.position
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0])
