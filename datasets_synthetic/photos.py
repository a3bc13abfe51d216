"""Photographs of one person by an ordinary camera, as someone takes them who wants a texture.

Three to five stills from around the head: front, three-quarters, sides. One lens, of one zoom
setting, serves for all; distance, light, exposure, white balance and focus differ from photo to
photo unless `uniform` asks for even light. A photo session is planned here from a seed;
`photo_pictures` takes the pictures, `photo_points` marks points, `photo_files` writes the folder.

World frame: the head's, in which the mesh lies too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from ..heads.head import Head
from ..heads.stage_lights import Lamp, StageLights
from .optics import Optics

LARGEST_PX = (3040, 2008)
SMALLEST_PX = 240
COUNTS = (3, 5)
POINTS = (12, 20)
#: Yaws of the cameras, degrees, positive towards the subject's left; the front comes first.
_YAWS_DEG = {3: (0.0, 52.0, -52.0), 4: (0.0, 48.0, -48.0, 88.0), 5: (0.0, 46.0, -46.0, 88.0, -88.0)}
_YAW_SD_DEG, _PITCH_SD_DEG, _ROLL_SD_DEG = 4.0, 4.5, 2.0
_FOCAL_LONG_SIDES = (2.3, 2.9)  # focal length in long sides of the picture: 83 to 104 mm of 36 mm
_HEAD_FILLS = (0.60, 0.74)  # share of the picture's height (or width) that the head takes
_AIM_SD_MM = 7.0
_TURNED_SHARE = 0.5  # a subject asked for the other side turns half the way towards the light


@dataclass(frozen=True)
class PhotoSettings:
    """What a photo session is asked to be.

    Attributes
    ----------
    count : int
        Photographs, 3 to 5.
    size : (width, height) int, px
    mark_noise_px : float
        Standard deviation of marked points on the photographs, of each coordinate.
    mark_noise_mm : float
        The same on the mesh, along the surface, of each of two directions.
    points : int
        Points to mark on each photograph, 12 to 20; fewer where fewer are in sight.
    uniform : bool
        Even light from everywhere and neutral exposure instead of uncontrolled ones: the photo's
        colour of skin is its albedo, but where it looks into hollows or grazes.
    turned : bool
        The last photo is taken with the camera on its side, which the file's EXIF data say.

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    count: int = 4
    size: tuple[int, int] = (1520, 1004)
    mark_noise_px: float = 1.5
    mark_noise_mm: float = 0.3
    points: int = 15
    uniform: bool = False
    turned: bool = False

    def __post_init__(self) -> None:
        _check_within("count", self.count, *COUNTS)
        _check_within("points", self.points, *POINTS)
        _check_within("mark_noise_px", self.mark_noise_px, 0, 50)
        _check_within("mark_noise_mm", self.mark_noise_mm, 0, 5)
        width, height = self.size
        # upright pictures of the largest size may stand on their short side
        most = LARGEST_PX if width >= height else LARGEST_PX[::-1]
        fits = width <= most[0] and height <= most[1]
        if not fits or min(self.size) < SMALLEST_PX or max(self.size) > 3 * min(self.size):
            raise InputError(
                f"size must be {SMALLEST_PX} to {most[0]}x{most[1]} px, and at most three times as "
                f"long as wide, got {width}x{height}"
            )


@dataclass(frozen=True, eq=False)
class PhotoShot:
    """How one photograph is taken.

    Attributes
    ----------
    name : str
        Stem of its file.
    camera : Camera
        Of the picture held upright, as viewers show it.
    optics : Optics
    lights : StageLights
    stage_yaw_rad : float
        By how much the lights' frame is turned about the vertical in the head's.
    exposure_stops : float
        Above (brighter) or below what is right for the face.
    white_balance : (3,) float64
        Gains of red, green and blue between sensor and picture.
    full_well_e, read_noise_e : float
        Of the sensor, electrons; see `optics.Sensor`.
    jpeg_quality : int
    orientation : int
        EXIF's: 1 as stored, 6 to be turned by 90° clockwise for showing.
    seed : int
        Of noise and room.
    """

    name: str
    camera: Camera
    optics: Optics
    lights: StageLights
    stage_yaw_rad: float
    exposure_stops: float
    white_balance: NDArray[np.float64]
    full_well_e: float
    read_noise_e: float
    jpeg_quality: int
    orientation: int
    seed: int

    def __post_init__(self) -> None:
        wb = readonly(self.white_balance, (3,), "white_balance")
        object.__setattr__(self, "white_balance", wb)


@dataclass(frozen=True, eq=False)
class PhotoSession:
    """A person and the photographs that will be taken of them.

    Attributes
    ----------
    head : Head
    settings : PhotoSettings
    seed : int
    shots : tuple of PhotoShot
    """

    head: Head
    settings: PhotoSettings
    seed: int
    shots: tuple[PhotoShot, ...]

    @property
    def rig(self) -> Rig:
        """The true cameras, by the photos' names."""
        return Rig({shot.name: shot.camera for shot in self.shots})


def plan_photos(head: Head, settings: PhotoSettings, seed: int) -> PhotoSession:
    """Draw how the photographs of a session are taken.

    Parameters
    ----------
    head : Head
    settings : PhotoSettings
    seed : int
    """
    rng = np.random.default_rng([seed, 80])
    lens = _Lens.drawn(rng, settings.size)
    yaws = np.array(_YAWS_DEG[settings.count]) * rng.choice((-1.0, 1.0))
    shots = []
    for index, yaw_deg in enumerate(yaws):
        own = np.random.default_rng([seed, 81, index])
        turned = settings.turned and index == settings.count - 1
        shots.append(_shot(own, f"photo{index}", head, lens, float(yaw_deg), turned, settings))
    return PhotoSession(head, settings, seed, tuple(shots))


def even_lights() -> StageLights:
    """Light of the same strength from everywhere: what is white and open is white in a picture."""
    none = Lamp(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.5)
    return StageLights(none, none, none, np.ones(3), np.ones(3))


@dataclass(frozen=True, eq=False)
class _Lens:
    """The one lens of a session; (0, 0) of `off_px` is the sensor's middle."""

    sensor_px: tuple[int, int]
    focal_px: float
    off_px: NDArray[np.float64]
    k1: float
    k2: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, size: tuple[int, int]) -> _Lens:
        focal = max(size) * float(rng.uniform(*_FOCAL_LONG_SIDES))
        off = rng.normal(0, 0.006, 2) * max(size)
        # barrel at most: 0.3 to 1 % of the radius at the picture's corner
        corner2 = (np.hypot(*size) / 2 / focal) ** 2
        k1 = -float(rng.uniform(0.003, 0.010)) / corner2
        return cls(size, focal, off, k1, float(rng.normal(0, 0.001)) / corner2**2)

    def camera(self, pose: Rigid, *, turned: bool) -> Camera:
        """The camera of an upright picture; its distortion is radial and does not turn with it."""
        width, height = self.sensor_px
        cx, cy = (np.array(self.sensor_px) - 1) / 2 + self.off_px
        if turned:  # the file is to be turned clockwise: its bottom left comes to the top left
            width, height = height, width
            cx, cy = width - 1 - cy, cx
        K = [[self.focal_px, 0, cx], [0, self.focal_px, cy], [0, 0, 1]]
        coefficients = np.array([self.k1, self.k2, 0.0, 0.0, 0.0])
        return Camera((width, height), np.array(K), pose, "opencv", coefficients)


def _shot(
    rng: np.random.Generator,
    name: str,
    head: Head,
    lens: _Lens,
    yaw_deg: float,
    turned: bool,
    settings: PhotoSettings,
) -> PhotoShot:
    yaw = np.radians(yaw_deg + rng.normal(0, _YAW_SD_DEG))
    pitch = np.radians(np.clip(rng.normal(2, _PITCH_SD_DEG), -9, 12))
    roll = np.radians(np.clip(rng.normal(0, _ROLL_SD_DEG), -5, 5))
    upright = lens.sensor_px[::-1] if turned else lens.sensor_px
    target, extent_mm = _target(head)
    fills = float(rng.uniform(*_HEAD_FILLS))
    distance = lens.focal_px * extent_mm / (fills * min(upright))
    aim = target + np.clip(rng.normal(0, _AIM_SD_MM, 3), -14, 14)
    pose = _looking_at(aim, distance, yaw, pitch, roll)
    camera = lens.camera(pose, turned=turned)
    focus = float(camera.camera_from_world.apply(head.points["9.3"])[2] + rng.normal(8, 10))
    pupil = float(rng.uniform(2.0, 5.0))
    sharp = max(settings.size) / LARGEST_PX[0]  # a small picture is a large one made smaller
    if settings.uniform:
        optics = Optics(pupil_mm=min(pupil, 2.5), focus_mm=focus, psf_px=0.35 + 0.2 * sharp)
        lights, stage_yaw = even_lights(), 0.0
        stops, tint = 0.0, np.ones(3)
        full_well, read, quality = 40000.0, 6.0, 97
    else:
        optics = Optics(
            pupil_mm=pupil,
            focus_mm=focus,
            psf_px=0.35 + float(rng.uniform(0.2, 0.6)) * sharp,
            vignetting=float(rng.uniform(0.05, 0.25)),
        )
        lights = StageLights.random(rng)
        stage_yaw = _TURNED_SHARE * float(yaw) + float(rng.normal(0, 0.2))
        stops = float(np.clip(rng.normal(0, 0.30), -0.6, 0.6))
        warm, green = rng.normal(0, 0.07), rng.normal(0, 0.02)
        tint = np.exp([warm, green, -warm])
        full_well = float(rng.choice((30000.0, 15000.0, 7500.0)))  # ISO 100 to 400
        read, quality = 9.0, int(rng.integers(90, 97))
    seed = int(rng.integers(2**31))
    orientation = 6 if turned else 1
    return PhotoShot(
        name, camera, optics, lights, stage_yaw, stops, tint, full_well, read, quality,
        orientation, seed,
    )  # fmt: skip


def _target(head: Head) -> tuple[NDArray[np.float64], float]:
    """What a photographer aims at, and the height from chin to crown, mm."""
    skin = head.mesh.vertices[head.part_vertices("skin")]
    chin, crown = float(head.points["2.1"][1]), float(skin[:, 1].max())
    ears = skin[np.abs(skin[:, 1]) < 30]
    depth = float(0.35 * ears[:, 2].min() + 0.65 * ears[:, 2].max()) - 40
    return np.array([0.0, 0.5 * (chin + crown) - 12, depth]), crown - chin


def _looking_at(
    aim: NDArray[np.float64], distance: float, yaw: float, pitch: float, roll: float
) -> Rigid:
    """Camera from world of a camera about `aim`; yaw grows to the subject's left, pitch upwards."""
    away = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    R = np.stack([right, np.cross(-away, right), -away])
    c, s = np.cos(roll), np.sin(roll)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    return Rigid.from_rotation(R, -R @ (aim + distance * away))


def _check_within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(f"{name} must lie in {low:g} to {high:g}, got {value:g}")
