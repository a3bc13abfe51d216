"""Shots of a calibration board by one camera or several, with their exact truth.

A folder of shots holds ``rig.json`` (the true cameras), ``board.toml`` (what was simulated),
``truth.npz`` and, for each camera, ``CAM/view_000.png`` and so on or ``CAM.mp4``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.boards import Board
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.files import atomic_path, atomic_write
from ..core.formats.rig_json import write_rig
from ..core.rig import Rig
from ..core.rigid import Rigid
from ..core.video_writer import VideoWriter
from .board_pictures import BoardPictures, bow_height, bow_terms
from .board_poses import camera_poses, rig_poses, sees
from .optics import Sensor
from .rigs import face_rig
from .sensor import develop

MAX_CAMERAS = 8
FRAMES_PER_POSE = 12  # of a video: from one way of holding the board to the next
RATE_HZ = 30.0
_CRF = 14
_BLACK, _WHITE = 0.04, 0.75  # reflectances of ink and paper
_CLUTTER_LIGHT = 0.22
_FOCAL_PX_PER_WIDTH = 0.95  # of the single camera: 55° across
_DECENT_SENSOR = Sensor(full_well_e=9000.0, read_noise_e=10.0)
_N_RIM = 180  # points on a dot's rim, for the centroid of its picture

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class BoardLook:
    """What makes a shot real; the defaults are a decent camera in a room.

    Attributes
    ----------
    uneven_light : float
        How much darker the dark side of the picture is, 0 to 1.
    blur_px : float, px
        Standard deviation of the lens's blur.
    sensor : Sensor
    has_background : bool
        Clutter behind the board, else plain grey.
    """

    uneven_light: float = 0.35
    blur_px: float = 0.6
    sensor: Sensor = _DECENT_SENSOR
    has_background: bool = True


#: No blur, no noise, even light: for judging exactness.
IDEAL_LOOK = BoardLook(0.0, 0.0, Sensor(full_well_e=float("inf"), read_noise_e=0.0), False)


@dataclass(frozen=True, eq=False)
class BoardShots:
    """Everything about shots of a board but the pictures, which `board_picture` makes.

    Attributes
    ----------
    board : Board
    rig : Rig
    world_from_board : tuple of Rigid, length V
    bow_mm : (x, y) floats, mm
        See `board_pictures.BoardPictures`.
    look : BoardLook
    seed : int
    """

    board: Board
    rig: Rig
    world_from_board: tuple[Rigid, ...]
    bow_mm: tuple[float, float]
    look: BoardLook
    seed: int

    @property
    def points(self) -> NDArray[np.float64]:
        """(N, 3) float64, mm, board frame: where the board's points are, its bow included."""
        flat = self.board.object_points()
        z = bow_height(bow_terms(self.board, self.bow_mm), flat[:, :2])
        return readonly(flat + np.stack([0 * z, 0 * z, z], axis=1), (None, 3), "points")


def make_board_shots(
    board: Board,
    seed: int,
    *,
    n_cameras: int = 1,
    n_views: int = 20,
    poor: bool = False,
    moving: bool = False,
    image_size: tuple[int, int] = (1280, 720),
    bow_mm: tuple[float, float] = (0.0, 0.0),
    look: BoardLook | None = None,
) -> BoardShots:
    """Draw cameras and the ways a board is held before them.

    Parameters
    ----------
    board : Board
    seed : int
    n_cameras : int
        1: one camera with a visible lens distortion, which is the world. More: a rig around a
        face, neighbours of which share views.
    n_views : int
    poor : bool
        Frontal views in the middle only.
    moving : bool
        The views are frames of one smooth motion, for a video, instead of single pictures.
    image_size : (width, height), px
    bow_mm : (x, y) floats, mm
        How far the middle of the board stands back.
    look : BoardLook, optional

    Raises
    ------
    InputError
        If the board does not fit before the cameras, or the numbers make no sense.
    """
    if not 1 <= n_cameras <= MAX_CAMERAS:
        raise InputError(f"shots of a board have 1 to {MAX_CAMERAS} cameras, got {n_cameras}")
    if n_views < 1:
        raise InputError(f"at least one view is needed, got {n_views}")
    rng = np.random.default_rng([seed, 40])
    rig = (
        Rig({"cam0": _lone_camera(rng, image_size)})
        if n_cameras == 1
        else face_rig(rng, n_cameras=n_cameras, image_size=image_size)
    )
    n_poses = 2 + n_views // FRAMES_PER_POSE if moving else n_views
    cameras = list(rig.cameras.values())
    poses = (
        camera_poses(board, cameras[0], n_poses, rng, poor=poor)
        if n_cameras == 1
        else rig_poses(board, rig, n_poses, rng, poor=poor)
    )
    if moving:
        poses = _smooth(poses, n_views)
    return BoardShots(board, rig, poses, bow_mm, look or BoardLook(), seed)


def board_views(shots: BoardShots, camera: str) -> Iterator[NDArray[np.uint8]]:
    """The pictures of one camera, (h, w) uint8, view by view."""
    pictures = BoardPictures(shots.board, shots.rig[camera], shots.bow_mm)
    number = shots.rig.names.index(camera)
    look = shots.look
    background, light = _surroundings(shots, shots.rig[camera], number)
    for view, pose in enumerate(shots.world_from_board):
        sheet, white = pictures.cover(pose)
        seen = _BLACK * sheet + (_WHITE - _BLACK) * white + (1 - sheet) * background
        seen *= light
        if look.blur_px > 0:
            seen = cv2.GaussianBlur(seen, (0, 0), look.blur_px)
        rng = np.random.default_rng([shots.seed, 41, number, view])
        yield develop(seen.astype(np.float32), look.sensor, rng)


def board_truth(shots: BoardShots) -> dict[str, NDArray[Any]]:
    """What ``truth.npz`` holds.

    Returns
    -------
    dict
        ``ids`` (N,); ``object_points`` (N, 3) mm as a flat board has them, ``points`` (N, 3) mm as
        they are; ``board_quaternion`` (V, 4) wxyz and ``board_translation`` (V, 3) mm, world from
        board; ``pixels`` (C, V, N, 2) px, NaN where a point cannot be projected; ``visible``
        (C, V, N); for circles ``centroids`` (C, V, N, 2) px of the dots' pictures, which lie
        beside the pictures of their middles; ``camera_names`` (C,).
    """
    points, board = shots.points, shots.board
    cameras = list(shots.rig.cameras.values())
    world = [pose.apply(points) for pose in shots.world_from_board]
    truth = {
        "camera_names": np.array(shots.rig.names),
        "ids": np.arange(len(points)),
        "object_points": board.object_points(),
        "points": points,
        "board_quaternion": np.array([p.quaternion for p in shots.world_from_board]),
        "board_translation": np.array([p.translation for p in shots.world_from_board]),
        "pixels": np.array([[camera.project(w) for w in world] for camera in cameras]),
        "visible": np.array(
            [[sees(camera, p, points) for p in shots.world_from_board] for camera in cameras]
        ),
    }
    if board.kind == "circles":
        truth["centroids"] = np.array(
            [[_centroids(shots, camera, p) for p in shots.world_from_board] for camera in cameras]
        )
    return truth


def shoot_board(
    shots: BoardShots,
    folder: Path,
    *,
    video: bool = False,
    on_picture: Callable[[int], None] | None = None,
) -> None:
    """Write shots into a folder that exists; files appear when all are whole.

    Parameters
    ----------
    shots : BoardShots
    folder : Path
    video : bool
        One H.264 video a camera instead of lossless pictures.
    on_picture : callable, optional
        Told how many pictures are done.
    """
    with tempfile.TemporaryDirectory(prefix=".shooting-", dir=folder) as scratch:
        done = 0
        for name in shots.rig:
            with ExitStack() as stack:
                keep = _keeper(stack, Path(scratch), shots, name, video)
                for view, picture in enumerate(board_views(shots, name)):
                    keep(view, picture)
                    done += 1
                    if on_picture is not None:
                        on_picture(done)
        write_rig(Path(scratch) / "rig.json", shots.rig)
        _write_settings(Path(scratch) / "board.toml", shots)
        with open(Path(scratch) / "truth.npz", "wb") as stream:
            np.savez_compressed(stream, **board_truth(shots))  # type: ignore[arg-type]
        for path in sorted(Path(scratch).iterdir()):
            _move(path, folder / path.name)


def _keeper(
    stack: ExitStack, folder: Path, shots: BoardShots, name: str, video: bool
) -> Callable[[int, NDArray[np.uint8]], None]:
    """What stores one picture of a camera."""
    if video:
        size = shots.rig[name].image_size
        reel = VideoWriter(folder / f"{name}.mp4", size, RATE_HZ, crf=_CRF, reproducible=True)
        writer = stack.enter_context(reel)
        return lambda _, picture: writer.write(picture)
    pictures = folder / name
    pictures.mkdir()

    def keep(view: int, picture: NDArray[np.uint8]) -> None:
        from PIL import Image

        with atomic_path(pictures / f"view_{view:03d}.png") as part:
            Image.fromarray(picture).save(part, format="PNG")

    return keep


def _move(path: Path, to: Path) -> None:
    """Put a file in its place, or a folder's files in theirs."""
    if not path.is_dir():
        path.replace(to)
        return
    to.mkdir(exist_ok=True)
    for file in sorted(path.iterdir()):
        file.replace(to / file.name)


def _write_settings(path: Path, shots: BoardShots) -> None:
    board, look = shots.board, shots.look
    with atomic_write(path) as stream:
        stream.write(f'version = 1\nboard = "{board}"\nseed = {shots.seed}\n')
        stream.write(f"views = {len(shots.world_from_board)}\nrate_hz = {RATE_HZ!r}\n")
        stream.write(f"bow_mm = [{float(shots.bow_mm[0])!r}, {float(shots.bow_mm[1])!r}]\n")
        stream.write(f"uneven_light = {look.uneven_light!r}\nblur_px = {look.blur_px!r}\n")
        sensor = look.sensor
        stream.write(f"full_well_e = {sensor.full_well_e!r}\n")
        stream.write(f"read_noise_e = {sensor.read_noise_e!r}\n")


def _lone_camera(rng: np.random.Generator, size: tuple[int, int]) -> Camera:
    width, height = size
    f = _FOCAL_PX_PER_WIDTH * width * (1 + rng.normal(0, 0.03))
    cx, cy = (width - 1) / 2, (height - 1) / 2
    centre = np.array([cx, cy]) + rng.normal(0, 0.008 * width, 2)
    K = np.array([[f, 0, centre[0]], [0, f * (1 + rng.normal(0, 1e-3)), centre[1]], [0, 0, 1]])
    k1 = rng.uniform(-0.25, -0.08)
    k = [k1, -0.45 * k1 + rng.normal(0, 0.02), *rng.normal(0, 6e-4, 2), rng.normal(0, 0.01)]
    return Camera(size, K, Rigid.identity(), "opencv", np.array(k))


def _smooth(poses: tuple[Rigid, ...], n_views: int) -> tuple[Rigid, ...]:
    """A smooth motion through poses."""
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    at = np.arange(len(poses), dtype=np.float64) * FRAMES_PER_POSE
    time = np.arange(n_views, dtype=np.float64)
    turns = Rotation.from_quat([p.quaternion for p in poses], scalar_first=True)
    path = CubicSpline(at, np.array([p.translation for p in poses]))(time)
    matrices = RotationSpline(at, turns)(time).as_matrix()
    return tuple(Rigid.from_rotation(R, t) for R, t in zip(matrices, path, strict=True))


def _surroundings(shots: BoardShots, camera: Camera, number: int) -> tuple[Floats, Floats]:
    """Light from behind the board, and how much light falls where, both (h, w) float32."""
    rng = np.random.default_rng([shots.seed, 42, number])
    width, height = camera.image_size
    background = np.full((height, width), _CLUTTER_LIGHT, np.float32)
    if shots.look.has_background:
        for sigma, amount in ((3.0, 0.04), (12.0, 0.06), (50.0, 0.08)):
            cloud = cv2.GaussianBlur(
                rng.normal(size=(height, width)).astype(np.float32), (0, 0), sigma
            )
            background += amount * cloud / cloud.std()
        for _ in range(14):  # furniture
            corner = rng.uniform(-0.1, 1, 2) * (width, height)
            size = rng.uniform(0.03, 0.3, 2) * (width, height)
            end = np.rint(corner + size).astype(int).tolist()
            start = np.rint(corner).astype(int).tolist()
            cv2.rectangle(background, start, end, float(rng.uniform(0.05, 0.5)), -1)
        background = np.clip(cv2.GaussianBlur(background, (0, 0), 2.0), 0.01, 0.8)
    y, x = np.mgrid[0:height, 0:width]
    way = rng.uniform(0, 2 * np.pi)
    reach = (np.cos(way) * (2 * x / width - 1) + np.sin(way) * (2 * y / height - 1)) / np.sqrt(2)
    light = 1 - shots.look.uneven_light * (1 + reach) / 2
    return background, light.astype(np.float32)


def _centroids(shots: BoardShots, camera: Camera, pose: Rigid) -> NDArray[np.float64]:
    """Centres of gravity of the dots' pictures, (N, 2) px."""
    turn = np.arange(_N_RIM) * (2 * np.pi / _N_RIM)
    # a polygon of the circle's own area
    radius = shots.board.dot_radius_mm * np.sqrt(turn[1] / np.sin(turn[1]))
    rim = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    xy = shots.board.object_points()[:, None, :2] + rim
    z = bow_height(bow_terms(shots.board, shots.bow_mm), xy)[..., None]
    p = camera.project(pose.apply(np.concatenate([xy, z], axis=-1)))
    q = np.roll(p, -1, axis=1)
    origin = p[:, :1]
    a, b = p - origin, q - origin  # near the dot: no digits lost
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    weighted = ((a + b) * cross[..., None]).sum(axis=1)
    return np.asarray(origin[:, 0] + weighted / (3 * cross.sum(axis=1, keepdims=True)))
