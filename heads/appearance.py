"""What a head looks like: skin, eyes, hair and mouth painted into textures.

Colours are functions of the place on the template at rest, so that they stick under every identity
and expression. Sizes below are millimetres on the template, colours sRGB 0 to 255 unless named
otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..core.arrays import readonly
from .raycast import RayScene
from .template import Template, template_feature_points

Rgb = tuple[float, float, float]
Floats = NDArray[np.float32]

SKIN_PX, FIELD_PX, ROUGHNESS_PX, EYE_PX, DETAILS_PX = 2048, 512, 1024, 512, 512
CUTS = ("bald", "shaved", "fade", "buzz")
#: Skin from the least to the most melanin.
_SKIN = np.array(
    [
        (241, 208, 189),
        (231, 188, 162),
        (212, 161, 129),
        (178, 124, 92),
        (132, 88, 64),
        (86, 57, 45),
    ]
)
#: What a unit of blood takes from red, green, blue (log reflectance); less seen through melanin.
_BLOOD = np.array([0.06, 0.62, 0.52])
#: What a unit of mottling by melanin takes.
_MELANIN = np.array([0.7, 1.0, 1.15])
_HAIR = {
    "black": (26, 22, 21),
    "dark brown": (48, 34, 26),
    "brown": (80, 56, 38),
    "blond": (150, 116, 74),
    "red": (126, 66, 36),
    "grey": (148, 140, 131),
}
_IRIS = {
    "dark": (62, 36, 20),
    "brown": (98, 60, 30),
    "hazel": (116, 92, 50),
    "green": (98, 112, 76),
    "blue": (94, 126, 152),
    "grey": (116, 128, 134),
}
_IRIS_RAD, _PUPIL_SHARE = 0.395, 0.40
_EYE_FRONT_RAD, _EYE_FRONT_SHARE = 1.2, 0.86  # most of the eye's texture shows its front
#: Hairline: azimuth from the front and elevation, degrees, seen from `_SKULL_CENTRE`.
_SKULL_CENTRE = np.array([0.0, 20.0, -70.0], dtype=np.float32)
_HAIRLINE_AZIMUTH = (0.0, 20.0, 33.0, 47.0, 60.0, 70.0, 79.0, 90.0, 112.0, 140.0, 180.0)
_HAIRLINE_ELEVATION = (34.0, 34.0, 30.5, 24.0, 8.0, -9.0, -25.0, -26.0, -29.0, -40.0, -45.0)
_BROW_PX_PER_MM = 16
_BROW_BOX = (0.0, 66.0, 2.0, 40.0)  # x0, x1, y0, y1


@dataclass(frozen=True)
class AppearanceTraits:
    """What a person looks like; the defaults make a pleasant average one.

    Attributes
    ----------
    seed : int
        Where moles, single hairs, veins and mottling lie.
    melanin : float
        0 very light to 1 very dark skin.
    ruddiness : float
        0 pale to 1 flushed cheeks, nose and ears.
    lip_redness : float
        0 as the skin to 1 strongly coloured.
    hair, brow, iris : sRGB, 0 to 255
    cut : str
        One of `CUTS`: shaved smooth, shaved, a fade, a buzz cut.
    recession_mm : float
        How far the hairline has gone back, most at the temples.
    brow_thickness, brow_density : float
        1 is average.
    brow_arch_mm : float
        Added to the height of the arch.
    stubble : float
        0 none to 1 a three-day beard.
    freckles : float
        0 none to 1 many.
    n_moles : int
    weathering : float
        0 even to 1 blotchy skin.
    """

    seed: int = 0
    melanin: float = 0.3
    ruddiness: float = 0.45
    lip_redness: float = 0.5
    hair: Rgb = _HAIR["dark brown"]
    brow: Rgb = (52, 38, 30)
    iris: Rgb = _IRIS["brown"]
    cut: str = "buzz"
    recession_mm: float = 0.0
    brow_thickness: float = 1.0
    brow_density: float = 1.0
    brow_arch_mm: float = 0.0
    stubble: float = 0.0
    freckles: float = 0.0
    n_moles: int = 3
    weathering: float = 0.3

    def __post_init__(self) -> None:
        if self.cut not in CUTS:
            raise ValueError(f"cut must be one of {', '.join(CUTS)}, not {self.cut}")
        for name in ("melanin", "ruddiness", "lip_redness", "stubble", "freckles", "weathering"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie in 0..1, got {getattr(self, name)}")

    @classmethod
    def random(
        cls,
        rng: np.random.Generator,
        *,
        ancestry: Mapping[str, float],
        age: float,
        female: float,
    ) -> AppearanceTraits:
        """Draw traits that go with a phenotype (as of `Identity`)."""
        names = ("african", "asian", "caucasian")
        shares = np.array([max(ancestry.get(n, 0.0), 0.0) for n in names])
        shares = shares / shares.sum() if shares.sum() > 0 else np.full(3, 1 / 3)
        origin = names[rng.choice(3, p=shares)]
        melanin = float(shares @ (0.82, 0.34, 0.20) + rng.normal(0, 0.06))
        if melanin > 0.38 and origin == "caucasian":  # light eyes and hair go with light skin
            origin = "african"
        hair_name = _drawn_hair(rng, origin)
        hair = np.array(_HAIR[hair_name]) * rng.uniform(0.85, 1.15)
        brow = hair * 0.8 + np.array((6.0, 4, 3)) if hair_name != "blond" else hair * 0.68
        grey = float(np.clip((age - 0.62) * 3.5 + rng.normal(0, 0.15), 0, 0.95))
        hair = hair * (1 - grey) + np.array(_HAIR["grey"]) * grey
        brow = brow * (1 - 0.45 * grey) + np.array(_HAIR["grey"]) * 0.45 * grey
        male = female < 0.5
        iris = np.array(_IRIS[_drawn_iris(rng, origin)]) * rng.uniform(0.9, 1.1)
        cut = str(rng.choice(CUTS, p=(0.12, 0.22, 0.3, 0.36) if male else (0.04, 0.16, 0.2, 0.6)))
        recession = max(0.0, rng.normal(3 + 22 * (age - 0.5), 4)) if male else 0.0
        freckles = rng.random() ** 2 * (0.9 if origin == "caucasian" and melanin < 0.3 else 0.15)
        return cls(
            seed=int(rng.integers(2**31)),
            melanin=float(np.clip(melanin, 0.03, 0.97)),
            ruddiness=float(rng.uniform(0.25, 0.65)),
            lip_redness=float(np.clip(rng.normal(0.45 + 0.12 * (not male), 0.12), 0.2, 0.85)),
            hair=_rgb(hair),
            brow=_rgb(brow),
            iris=_rgb(iris),
            cut=cut,
            recession_mm=float(recession),
            brow_thickness=float(np.clip(rng.normal(1.12 if male else 0.85, 0.14), 0.6, 1.5)),
            brow_density=float(np.clip(rng.normal(1.0, 0.12), 0.7, 1.3)),
            brow_arch_mm=float(rng.normal(-0.2 if male else 0.5, 0.6)),
            stubble=float(rng.choice([0.08, 0.3, 0.65]) * rng.uniform(0.8, 1.2)) if male else 0.0,
            freckles=float(freckles),
            n_moles=int(rng.poisson(4)),
            weathering=float(np.clip(0.15 + 0.6 * (age - 0.4) + rng.normal(0, 0.08), 0, 1)),
        )


def _rgb(colour: NDArray[Any]) -> Rgb:
    r, g, b = np.clip(colour, 0, 255)
    return float(r), float(g), float(b)


def _drawn_hair(rng: np.random.Generator, origin: str) -> str:
    if origin != "caucasian":
        return str(rng.choice(["black", "dark brown"], p=[0.75, 0.25]))
    return str(
        rng.choice(["black", "dark brown", "brown", "blond", "red"], p=[0.1, 0.3, 0.3, 0.22, 0.08])
    )


def _drawn_iris(rng: np.random.Generator, origin: str) -> str:
    if origin != "caucasian":
        return str(rng.choice(["dark", "brown"], p=[0.7, 0.3]))
    return str(
        rng.choice(
            ["dark", "brown", "hazel", "green", "blue", "grey"],
            p=[0.1, 0.28, 0.14, 0.12, 0.26, 0.1],
        )
    )


@dataclass(frozen=True, eq=False)
class Appearance:
    """Textures of a head and the coordinates that lay them on.

    Attributes
    ----------
    skin : (H, W, 3) uint8, sRGB
        Albedo of the skin, with brows and hair, lips and the inside of the mouth.
    roughness : (H, W) uint8 or None
        Of the skin, 0 mirror to 255 matt, over the same coordinates.
    eye : (H, W, 3) uint8, sRGB, or None
        The eyeball seen along its axis: iris in the middle. Both eyes share it.
    details : (H, W, 4) uint8, sRGB and alpha, or None
        Teeth, tongue and lashes; only the lashes are not opaque.
    uv : (U, 2) float64 in [0, 1], or None
        Replaces the rows of the mesh's `uv`: origin at the bottom left, each row within the
        texture of the part that uses it. None: the mesh's own, with `skin` on all parts.
    """

    skin: NDArray[np.uint8]
    roughness: NDArray[np.uint8] | None = None
    eye: NDArray[np.uint8] | None = None
    details: NDArray[np.uint8] | None = None
    uv: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "skin", readonly(self.skin, (None, None, 3), "skin", np.uint8))
        if self.roughness is not None:
            r = readonly(self.roughness, (None, None), "roughness", np.uint8)
            set_field(self, "roughness", r)
        if self.eye is not None:
            set_field(self, "eye", readonly(self.eye, (None, None, 3), "eye", np.uint8))
        if self.details is not None:
            d = readonly(self.details, (None, None, 4), "details", np.uint8)
            set_field(self, "details", d)
        if self.uv is not None:
            set_field(self, "uv", readonly(self.uv, (None, 2), "uv"))

    def texture_of(self, part: str) -> NDArray[np.uint8]:
        """The texture that a part of the mesh uses."""
        if part.startswith("eye_") and self.eye is not None:
            return self.eye
        if part in ("lashes", "teeth_upper", "teeth_lower", "tongue") and self.details is not None:
            return self.details
        return self.skin

    def mean_skin(self) -> Rgb:
        """Mean sRGB of the skin's texture, for what can show one colour only."""
        r, g, b = self.skin.reshape(-1, 3).mean(axis=0)
        return float(r), float(g), float(b)


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """A grey, RGB or RGBA picture as a PNG file."""
    return _encoded(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 6])


def jpeg_bytes(image: NDArray[np.uint8], *, quality: int = 88) -> bytes:
    """A grey or RGB picture as a JPEG file."""
    return _encoded(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])


def _encoded(kind: str, image: NDArray[np.uint8], options: list[int]) -> bytes:
    order = {3: [2, 1, 0], 4: [2, 1, 0, 3]}
    swapped = image if image.ndim == 2 else image[..., order[image.shape[2]]]
    done, data = cv2.imencode(kind, np.ascontiguousarray(swapped), options)
    assert done, "OpenCV encodes every uint8 picture"
    return bytes(data)


@lru_cache(maxsize=6)
def make_appearance(template: Template, traits: AppearanceTraits) -> Appearance:
    """Paint a person's textures (about a second; the last few are kept).

    The same traits give the same bytes.
    """
    rng = np.random.default_rng(traits.seed)
    skin, roughness = _painted_skin(template, traits, rng)
    return Appearance(
        skin,
        roughness,
        _painted_eye(traits, rng),
        _painted_details(traits, rng),
        appearance_uv(template),
    )


# ---------------------------------------------------------------------------------- coordinates


@lru_cache(maxsize=2)
def appearance_uv(template: Template) -> NDArray[np.float64]:
    """Texture coordinates (U, 2) in [0, 1] that give the face most of the picture.

    Skin: the template's main island upright and stretched, its others in a strip below. Eyes:
    azimuthal about the axis. Teeth, tongue and lashes: stripes of the picture of details.
    """
    found = np.full_like(template.uv, 0.5)
    _lay_skin(template, found)
    for side in ("eye_right", "eye_left"):
        rows, v = _rows_of(template, side)
        found[rows] = _eye_uv(v)
    for part, low, high in (("teeth_upper", 0.77, 0.99), ("teeth_lower", 0.52, 0.74)):
        rows, v = _rows_of(template, part)
        s, t = _teeth_coordinates(v)
        found[rows] = np.stack([0.02 + 0.96 * s, low + (high - low) * t], axis=1)
    rows, v = _rows_of(template, "tongue")
    span = v.max(axis=0) - v.min(axis=0)
    along = (v - v.min(axis=0)) / span
    found[rows] = np.stack([0.02 + 0.96 * along[:, 0], 0.27 + 0.22 * along[:, 2]], axis=1)
    rows, v = _rows_of(template, "lashes")
    skin = template.triangles[template.groups()["skin"]]
    root, *_ = RayScene(template.vertices, skin).closest(v)
    length = np.linalg.norm(v - root, axis=1)
    s = (np.abs(v[:, 0]) - np.abs(v[:, 0]).min()) / np.ptp(np.abs(v[:, 0]))
    t = np.clip(length / np.percentile(length, 97), 0, 1)
    found[rows] = np.stack([0.02 + 0.96 * s, 0.02 + 0.21 * t], axis=1)
    found.flags.writeable = False
    return found


def _rows_of(template: Template, part: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Rows of uv that a part uses, and their places on the template."""
    triangles = template.groups()[part]
    rows, first = np.unique(template.uv_triangles[triangles], return_index=True)
    return rows.astype(np.int64), template.vertices[template.triangles[triangles].ravel()[first]]


def _lay_skin(template: Template, found: NDArray[np.float64]) -> None:
    rows = template.uv_triangles[template.groups()["skin"]]
    a, b = rows.ravel(), np.roll(rows, 1, axis=1).ravel()
    graph = coo_matrix((np.ones(len(a)), (a, b)), (len(found), len(found)))
    _, label = connected_components(graph, directed=False)
    names, counts = np.unique(label[np.unique(rows)], return_counts=True)
    order = names[np.argsort(-counts, kind="stable")]
    uv = template.uv
    main = label == order[0]
    found[main, 0] = 0.004 + 0.992 * _stretched(uv[main, 1], 0.483, 0.115, 1.75)
    found[main, 1] = 0.998 - 0.778 * _stretched(uv[main, 0], 0.885, 0.105, 0.9)
    # inside of the mouth, the eye sockets, the neck
    x = 0.01
    for island, width in zip(order[1:5], (0.22, 0.11, 0.11, 0.50), strict=True):
        at = label == island
        low, high = uv[at].min(axis=0), uv[at].max(axis=0)
        found[at] = (uv[at] - low) / (high - low) * (width, 0.19) + (x, 0.01)
        x += width + 0.01


def _stretched(
    x: NDArray[np.float64], centre: float, half: float, gain: float
) -> NDArray[np.float64]:
    """`x` over its range as 0 to 1, with `1 + gain` times the room around `centre`."""
    grid = np.linspace(x.min(), x.max(), 2001)
    room = np.cumsum(1 + gain * np.exp(-(((grid - centre) / half) ** 4)))
    return np.asarray(np.interp(x, grid, (room - room[0]) / (room[-1] - room[0])))


def _eye_uv(v: NDArray[np.float64]) -> NDArray[np.float64]:
    centre = (v.min(axis=0) + v.max(axis=0)) / 2
    d = (v - centre) / np.linalg.norm(v - centre, axis=1, keepdims=True)
    front = d[np.argsort(-d[:, 2])[:8]].mean(axis=0)
    front /= np.linalg.norm(front)
    right = np.cross((0.0, 1.0, 0.0), front)
    right /= np.linalg.norm(right)
    across = np.stack([d @ right, d @ np.cross(front, right)], axis=1)
    angle = np.arccos(np.clip(d @ front, -1, 1))
    radius = np.interp(angle, (0, _EYE_FRONT_RAD, np.pi), (0, _EYE_FRONT_SHARE, 1.0)) / 2
    length = np.linalg.norm(across, axis=1)
    return np.asarray(0.5 + 0.98 * across * (radius / np.maximum(length, 1e-9))[:, None])


def _teeth_coordinates(
    v: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place along the arch, 0 right to 1 left by length, and height, 0 low to 1 high."""
    centre_z = v[:, 2].min() + 0.25 * np.ptp(v[:, 2])
    angle = np.arctan2(v[:, 0], v[:, 2] - centre_z)
    grid = np.linspace(angle.min(), angle.max(), 33)
    near = np.abs(angle[None] - grid[:, None]) < 0.12
    radius = np.array([np.hypot(v[n, 0], v[n, 2] - centre_z).max() for n in near])
    step = np.hypot(np.diff(radius * np.sin(grid)), np.diff(radius * np.cos(grid)))
    s = np.interp(angle, grid, np.concatenate([[0], np.cumsum(step)]) / step.sum())
    low = np.interp(angle, grid, [v[n, 1].min() for n in near])
    high = np.interp(angle, grid, [v[n, 1].max() for n in near])
    return s, np.clip((v[:, 1] - low) / (high - low), 0, 1)


# --------------------------------------------------------------------------------------- canvas


@dataclass(frozen=True, eq=False)
class _Canvas:
    """A square picture over the skin's coordinates.

    Attributes
    ----------
    texels : (N,) int64, flat indices that skin covers
    places : (N, 3) float32, mm on the template
    masks : mapping from name to (N,) float32
    nearest : (size²,) int64
        Row of `texels` nearest to every texel, to fill what skin does not cover.
    """

    size: int
    texels: NDArray[np.int64]
    places: Floats
    masks: Mapping[str, Floats]
    nearest: NDArray[np.int64]

    def filled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (N, ...) as a picture (size, size, ...) without holes."""
        return values[self.nearest].reshape(self.size, self.size, *values.shape[1:])


@lru_cache(maxsize=4)
def _canvas(template: Template, size: int) -> _Canvas:
    rows = template.groups()["skin"]
    uv = appearance_uv(template)
    at = np.stack([uv[:, 0] * size - 0.5, (1 - uv[:, 1]) * size - 0.5], axis=1)
    uv_triangles = template.uv_triangles[rows]
    triangle, weights = _rasterised(at, uv_triangles, size)
    texels = np.flatnonzero(triangle.ravel() >= 0)
    hit, b = triangle.ravel()[texels], weights.reshape(-1, 3)[texels]
    corners = template.vertices[template.triangles[rows]].astype(np.float32)[hit]
    places = np.einsum("nc,ncx->nx", b, corners)
    masks = {}
    if size == FIELD_PX:  # only the smooth fields need them
        for name, mask in template.masks.items():
            masks[name] = np.einsum("nc,nc->n", b, mask.astype(np.float32)[uv_triangles[hit]])
    empty = (triangle < 0).astype(np.uint8)
    _, labels = cv2.distanceTransformWithLabels(
        empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    row_of_label = np.zeros(labels.max() + 1, dtype=np.int64)
    row_of_label[labels.ravel()[texels]] = np.arange(len(texels))
    return _Canvas(size, texels, places, masks, row_of_label[labels.ravel()])


@njit(cache=True)
def _rasterised(at, triangles, size):  # type: ignore[no-untyped-def]
    """Triangle (−1: none) and barycentric weights at the middle of every texel."""
    found = np.full((size, size), -1, np.int32)
    weights = np.zeros((size, size, 3), np.float32)
    for f in range(len(triangles)):
        a, b, c = at[triangles[f, 0]], at[triangles[f, 1]], at[triangles[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0.0:
            continue
        x0 = max(0, int(np.ceil(min(a[0], b[0], c[0]))))
        x1 = min(size - 1, int(np.floor(max(a[0], b[0], c[0]))))
        y0 = max(0, int(np.ceil(min(a[1], b[1], c[1]))))
        y1 = min(size - 1, int(np.floor(max(a[1], b[1], c[1]))))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                wb = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
                wc = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
                if wb >= -1e-6 and wc >= -1e-6 and wb + wc <= 1 + 1e-6:
                    found[y, x] = f
                    weights[y, x, 0] = 1 - wb - wc
                    weights[y, x, 1] = wb
                    weights[y, x, 2] = wc
    return found, weights


@njit(cache=True)
def _hashed(x, y, z, seed):  # type: ignore[no-untyped-def]
    """A number in [0, 1) for a lattice point."""
    h = np.uint32(x * 374761393 + y * 668265263 + z * 2147483647 + seed * 1274126177)
    h = np.uint32((h ^ (h >> np.uint32(13))) * np.uint32(1274126177))
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(2246822519))
    return np.float32(h ^ (h >> np.uint32(15))) * np.float32(2.3283064e-10)


@njit(cache=True, nogil=True)
def _noise(places, wavelength, seed, found):  # type: ignore[no-untyped-def]
    """Smooth value noise in about ±1 at (N, 3) places; `wavelength` (3,) per axis."""
    for n in range(len(places)):
        x = places[n, 0] / wavelength[0] + 1000.0
        y = places[n, 1] / wavelength[1] + 1000.0
        z = places[n, 2] / wavelength[2] + 1000.0
        i, j, k = int(x), int(y), int(z)
        u, v, w = x - i, y - j, z - k
        u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
        total = 0.0
        for c in range(8):
            di, dj, dk = c & 1, (c >> 1) & 1, c >> 2
            share = (u if di else 1 - u) * (v if dj else 1 - v) * (w if dk else 1 - w)
            total += share * _hashed(i + di, j + dj, k + dk, seed)
        found[n] = (total - 0.5) * 3.0


def _noise_of(places: Floats, wavelength_mm: float | Rgb, seed: int) -> Floats:
    waves = np.broadcast_to(np.asarray(wavelength_mm, dtype=np.float32), (3,)).copy()
    found = np.empty(len(places), dtype=np.float32)
    half = len(places) // 2
    with ThreadPoolExecutor(2) as pool:  # numba's own threads may warn about what is installed
        for part in (slice(0, half), slice(half, None)):
            pool.submit(_noise, places[part], waves, seed % 2**20, found[part])
    return found


def _step(low: float, high: float, x: NDArray[Any]) -> NDArray[Any]:
    """0 below `low` to 1 above `high`, smoothly (either order)."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def _blob(p: Floats, centre: Rgb, radius: float | Rgb, *, mirrored: bool = True) -> NDArray[Any]:
    """A Gaussian about a place and, unless not mirrored, its mirror image."""
    q = p.copy()
    if mirrored:
        q[:, 0] = np.abs(q[:, 0])
    d = (q - np.asarray(centre, np.float32)) / np.asarray(radius, np.float32)
    return np.asarray(np.exp(-(d * d).sum(axis=1)))


def linear_from_srgb(colour: NDArray[Any]) -> NDArray[Any]:
    """Linear light 0 to 1 of sRGB 0 to 255."""
    c = np.asarray(colour, dtype=np.float32) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def _srgb_from_linear(light: Floats) -> NDArray[np.uint8]:
    """sRGB 0 to 255 of linear light, by a table."""
    grid = np.arange(4096) / 4095
    c = np.where(grid <= 0.0031308, grid * 12.92, 1.055 * grid ** (1 / 2.4) - 0.055)
    table = np.rint(c * 255).astype(np.uint8)
    return np.asarray(table[np.clip(light * 4095 + 0.5, 0, 4095).astype(np.int32)])


# ----------------------------------------------------------------------------------------- skin


def _painted_skin(
    template: Template, traits: AppearanceTraits, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    coarse, fine = _canvas(template, FIELD_PX), _canvas(template, SKIN_PX)
    field = coarse.filled(_smooth_fields(coarse, traits))
    field = cv2.resize(field, (SKIN_PX, SKIN_PX), interpolation=cv2.INTER_LINEAR)
    field = field.reshape(-1, field.shape[2])[fine.texels]
    p, seed = fine.places, traits.seed
    pores = _noise_of(p, 0.85, seed + 1)
    fleck = _noise_of(p, 2.1, seed + 2)
    log_albedo = field[:, :3]
    strength = (0.030 * pores + 0.028 * fleck) * (1 - field[:, 3])
    log_albedo -= strength[:, None] * np.array([0.6, 1.0, 1.0], np.float32)
    _add_spots(log_albedo, p, traits, rng)
    albedo = np.exp(log_albedo, out=log_albedo)
    whiskers = _noise_of(p, (0.75, 1.3, 0.75), seed + 3)
    beard = np.clip(field[:, 5] * (0.75 + 0.85 * whiskers), 0, 0.9)
    scalp = _scalp_cover(field[:, 4], _noise_of(p, (0.8, 1.0, 1.3), seed + 4), fleck)
    hair = linear_from_srgb(np.array(traits.hair)).astype(np.float32)
    sheen = 1 + 0.22 * _noise_of(p, (1.0, 2.2, 2.6), seed + 5)
    cover = np.maximum(beard, scalp)[:, None]
    albedo += cover * (hair * sheen[:, None] - albedo)
    brow = _brow_cover(template, p, traits, rng)[:, None]
    albedo += brow * (linear_from_srgb(np.array(traits.brow)).astype(np.float32) - albedo)
    # hair scatters: rougher; pores break the highlight up
    rough = field[:, 6] + 0.07 * pores + 0.3 * np.maximum(cover, brow)[:, 0]
    small = cv2.resize(
        fine.filled((np.clip(rough, 0.05, 1) * 255).astype(np.uint8)),
        (ROUGHNESS_PX, ROUGHNESS_PX),
        interpolation=cv2.INTER_AREA,
    )
    return fine.filled(_srgb_from_linear(albedo)), np.asarray(small, dtype=np.uint8)


def _scalp_cover(density: Floats, hairs: Floats, clumps: Floats) -> Floats:
    """How much of the skin hair hides: single hairs where it is thin, all where it is dense."""
    return np.asarray(
        np.clip(density * (1.0 + (0.42 * hairs + 0.2 * clumps) * (1.05 - 0.75 * density)), 0, 0.96),
        dtype=np.float32,
    )


def _smooth_fields(canvas: _Canvas, traits: AppearanceTraits) -> Floats:
    """(N, 7): log albedo ×3, wetness, hair, beard, roughness."""
    p, m, seed = canvas.places, canvas.masks, traits.seed
    lips = _step(0.22, 0.8, m["lips"])
    inside = _step(0.25, 0.75, m["inside-mouth"])
    melanin, blood = _pigment(canvas, traits)
    grid = np.linspace(0, 1, len(_SKIN))
    tone = np.log(linear_from_srgb(_SKIN))
    log_albedo = np.stack([np.interp(melanin, grid, tone[:, c]) for c in range(3)], axis=1)
    veil = 1 - 0.55 * np.clip(melanin, 0, 1)
    log_albedo -= (blood * veil)[:, None] * _BLOOD
    # lips: thin skin over blood, as dark as the person's melanin lets them be
    redder = (0.45 + 1.0 * traits.lip_redness) * np.array([0.22, 0.62, 0.45])
    lip_log = log_albedo - redder * veil[:, None]
    lip_log -= 0.16 * _step(0.45, 0.9, np.full(1, traits.melanin)) * _MELANIN
    crease = _noise_of(p, (0.9, 3.0, 3.0), seed + 8)
    lip_log -= (0.05 * crease)[:, None]
    log_albedo += (0.88 * lips)[:, None] * (lip_log - log_albedo)
    wet = np.log(linear_from_srgb(np.array([104, 40, 39])))
    log_albedo += inside[:, None] * (wet - log_albedo)
    nostril = _blob(p, (7.5, -43.5, 27.0), (4.0, 3.6, 6.0))
    log_albedo -= nostril[:, None] * np.array([1.3, 2.0, 2.0])
    hair, beard = _hair_density(canvas, traits), _beard_density(canvas, traits)
    bare = (1 - lips) * (1 - inside)
    rough = _roughness(p, lips, inside)
    columns = [lips + inside, hair * bare, beard * bare, rough]
    return np.concatenate([log_albedo, np.stack(columns, axis=1)], axis=1).astype(np.float32)


def _pigment(canvas: _Canvas, traits: AppearanceTraits) -> tuple[NDArray[Any], NDArray[Any]]:
    """Melanin, 0 to 1 of `_SKIN`, and blood above the mean, at every texel."""
    p, m, seed = canvas.places, canvas.masks, traits.seed
    broad, middle = _noise_of(p, 22.0, seed + 6), _noise_of(p, 7.0, seed + 7)
    fine = _noise_of(p, 3.2, seed + 9)
    blotch = 0.45 + traits.weathering
    lids = _step(0.3, 0.9, m["eyelids"])
    under_eye = _blob(p, (30, -12.5, 13), (13, 4.5, 9))
    beard_zone = _blob(p, (26, -82, 12), (30, 26, 30))
    melanin = traits.melanin + blotch * (0.015 * broad + 0.012 * middle + 0.008 * fine)
    melanin += 0.02 * _step(40, 75, p[:, 1]) - 0.02 * beard_zone
    melanin += (0.03 + 0.04 * traits.weathering) * under_eye + 0.03 * lids
    melanin -= 0.035 * _blob(p, (0, -10, 30), (9, 26, 18), mirrored=False)  # bridge of the nose
    flush = (
        0.55 * _blob(p, (41, -30, 8), (17, 15, 24))
        + 0.50 * _blob(p, (0, -37, 42), (11, 9, 12), mirrored=False)
        + 0.45 * _blob(p, (15, -40, 28), (7, 8, 9))
        + 0.20 * _blob(p, (0, -93, 25), (14, 10, 14), mirrored=False)
        + 0.50 * _step(0.3, 0.9, m["ears"]) * _step(60, 84, np.abs(p[:, 0]))
        + 0.14 * m["ears"]
    )
    blood = (0.35 + 1.3 * traits.ruddiness) * flush
    blood += 0.22 * lids + 0.16 * under_eye + 0.10 * _blob(p, (0, -52, 28), (16, 8, 14))
    blood += 0.75 * _blob(p, (17.5, -1.8, 13), (3.0, 2.2, 6.0))  # caruncle
    blood += 0.35 * _blob(p, (31, -4.6, 15.0), (13.0, 1.3, 3.0))  # rim of the lower lid
    blood += blotch * (0.07 * broad + 0.07 * middle + 0.055 * fine)
    blood -= 0.10 * _blob(p, (0, 48, 15), (40, 25, 40), mirrored=False)
    blood += 0.35 * _step(-100, -140, p[:, 1]) * 0.3
    return np.clip(melanin, 0, 1), blood


def _roughness(p: Floats, lips: NDArray[Any], inside: NDArray[Any]) -> NDArray[Any]:
    oily = (
        0.09 * _blob(p, (0, 45, 15), (30, 24, 30), mirrored=False)
        + 0.15 * _blob(p, (0, -28, 38), (12, 18, 16), mirrored=False)
        + 0.05 * _blob(p, (0, -93, 25), (12, 10, 14), mirrored=False)
        + 0.04 * _blob(p, (40, -22, 10), (16, 12, 20))
    )
    rough = 0.56 - oily
    rough += lips * (0.36 - rough)
    return np.asarray(rough + inside * (0.42 - rough))


def _hair_density(canvas: _Canvas, traits: AppearanceTraits) -> NDArray[Any]:
    p = canvas.places
    q = p - _SKULL_CENTRE
    distance = np.linalg.norm(q, axis=1)
    azimuth = np.degrees(np.arctan2(np.abs(q[:, 0]), q[:, 2]))
    elevation = np.degrees(np.arcsin(q[:, 1] / distance))
    line = PchipInterpolator(_HAIRLINE_AZIMUTH, _HAIRLINE_ELEVATION)(azimuth)
    temple = np.exp(-(((azimuth - 36) / 15) ** 2))
    line = line + traits.recession_mm * (0.55 + 0.75 * temple) * _step(75, 50, azimuth)
    inside_mm = np.radians(elevation - line) * distance
    ragged = 2.2 * _noise_of(p, 5.0, traits.seed + 10) + 1.6 * _noise_of(p, 1.8, traits.seed + 11)
    inside_mm = inside_mm + ragged
    front, side, nape = (np.interp(azimuth, (20, 55, 90, 180), w) for w in _HAIR_FADE[traits.cut])
    fade = _step(-1.0, 1.0, (inside_mm - front) / np.maximum(side, 1.0))
    most = _HAIR_DENSITY[traits.cut]
    sides = 1 - nape * _step(62.0, -5.0, p[:, 1]) * _step(35, 75, azimuth)
    off_ears = 1 - _step(0.15, 0.6, canvas.masks["ears"])
    lower = _step(-75, -50, p[:, 1])
    return np.asarray(most * fade * sides * off_ears * lower)


#: By cut: middle of the fade (mm above the hairline), its half width, and the share taken from
#: the sides, at azimuths 20, 55, 90 and 180 degrees.
_HAIR_FADE: dict[str, tuple[tuple[float, ...], ...]] = {
    "bald": ((6, 8, 8, 12), (7, 9, 10, 14), (0.0, 0.0, 0.0, 0.0)),
    "shaved": ((4, 6, 7, 12), (6, 8, 9, 14), (0.0, 0.1, 0.15, 0.2)),
    "fade": ((4, 7, 14, 22), (5, 8, 16, 24), (0.0, 0.55, 0.75, 0.75)),
    "buzz": ((4, 5, 7, 12), (5, 6, 9, 14), (0.0, 0.15, 0.25, 0.25)),
}
_HAIR_DENSITY = {"bald": 0.10, "shaved": 0.50, "fade": 0.92, "buzz": 0.90}


def _beard_density(canvas: _Canvas, traits: AppearanceTraits) -> NDArray[Any]:
    """Stubble on jaw, chin, upper lip and under the jaw."""
    p = canvas.places
    if traits.stubble == 0:
        return np.zeros(len(p))
    x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
    upper = np.interp(x, (0, 12, 22, 32, 45, 58, 70), (-48, -49, -55, -62, -60, -48, -22))
    area = _step(4, -7, y - upper) * _step(-132, -112, y) * _step(-78, -55, z)
    area = area * (1 - 0.85 * _blob(p, (14, -82, 25), (5, 6, 12)))  # bare beside the lower lip
    area = area * (1 - 0.5 * _blob(p, (0, -55, 32), (2.5, 5, 8), mirrored=False))
    off_ears = 1 - _step(0.05, 0.4, canvas.masks["ears"])
    patch = 1 + 0.25 * _noise_of(p, 6.0, traits.seed + 12)
    return np.asarray(0.55 * traits.stubble * area * off_ears * patch)


def _add_spots(
    log_albedo: Floats, p: Floats, traits: AppearanceTraits, rng: np.random.Generator
) -> None:
    """Freckles over nose and cheeks, moles anywhere on the face; in place."""
    rows = np.flatnonzero((p[:, 2] > -50) & (np.abs(p[:, 0]) < 70) & (p[:, 1] < 75))
    q = p[rows]
    picture = _drawn_spots(traits, rng)
    at = (q[:, 0] + 70) * _SPOT_PX_PER_MM, (75 - q[:, 1]) * _SPOT_PX_PER_MM
    amount = _sampled(picture, *at) / 255.0
    log_albedo[rows] -= (0.9 * amount[:, None] * _MELANIN).astype(np.float32)


_SPOT_PX_PER_MM = 8


def _drawn_spots(traits: AppearanceTraits, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Freckles and moles from the front: 70 mm to the right, 75 up, 120 down; 255 is darkest."""
    scale = _SPOT_PX_PER_MM
    picture = np.zeros((195 * scale, 140 * scale), np.float32)

    def spot(x: float, y: float, radius: float, dark: float) -> None:
        centre = round((x + 70) * scale * 16), round((75 - y) * scale * 16)
        one = np.zeros((8 * scale, 8 * scale), np.uint8)
        corner = centre[0] // 16 - 4 * scale, centre[1] // 16 - 4 * scale
        local = centre[0] - corner[0] * 16, centre[1] - corner[1] * 16
        cv2.circle(one, local, round(radius * scale * 16), 255, -1, cv2.LINE_AA, 4)
        soft = cv2.GaussianBlur(one, (0, 0), 0.3 * radius * scale).astype(np.float32)
        if corner[0] >= 0 and corner[1] >= 0:
            part = picture[corner[1] : corner[1] + 8 * scale, corner[0] : corner[0] + 8 * scale]
            np.maximum(part, dark * soft[: part.shape[0], : part.shape[1]], out=part)

    for _ in range(round(420 * traits.freckles)):
        x, y = rng.normal(0, 26), rng.normal(-20, 17)
        spot(x, y, float(rng.uniform(0.3, 0.75)), float(rng.uniform(0.12, 0.38)))
    for _ in range(traits.n_moles):
        x, y = rng.uniform(-60, 60), rng.uniform(-100, 50)
        if abs(x) > 16 or not -90 < y < -25:  # not on nose and lips
            spot(x, y, float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.45, 0.95)))
    return np.rint(np.clip(picture, 0, 255)).astype(np.uint8)


# ---------------------------------------------------------------------------------------- brows


def _brow_cover(
    template: Template, p: Floats, traits: AppearanceTraits, rng: np.random.Generator
) -> Floats:
    """How much brow hairs hide, (N,): single strokes along a curve, each side drawn anew."""
    found = np.zeros(len(p), dtype=np.float32)
    x0, x1, y0, y1 = _BROW_BOX
    inside = (np.abs(p[:, 0]) < x1) & (p[:, 1] > y0) & (p[:, 1] < y1) & (p[:, 2] > -25)
    middle = template_feature_points().select(("4.1", "4.3", "4.5")).at(template.vertices)
    for sign in (-1, 1):
        picture = _drawn_brow(middle, traits, rng)
        rows = np.flatnonzero(inside & (sign * p[:, 0] > x0))
        q = p[rows]
        at_x = (sign * q[:, 0] - x0) * _BROW_PX_PER_MM
        at_y = (y1 - q[:, 1]) * _BROW_PX_PER_MM
        values = _sampled(picture, at_x, at_y)
        found[rows] = values / 255.0
    return found


def _sampled(picture: NDArray[np.uint8], x: Floats, y: Floats) -> Floats:
    """Bilinear values; in rows of 4096, which OpenCV's remap can take."""
    n = len(x)
    padded = np.zeros((2, -(-n // 4096) * 4096), dtype=np.float32)
    padded[:, :n] = x, y
    grid = padded.reshape(2, -1, 4096)
    values = cv2.remap(picture, grid[0], grid[1], cv2.INTER_LINEAR).ravel()[:n]
    return np.asarray(values, dtype=np.float32)


def _drawn_brow(
    points: NDArray[np.float64], traits: AppearanceTraits, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """The left brow from the front, `_BROW_PX_PER_MM`, 255 where hidden."""
    x0, x1, y0, y1 = _BROW_BOX
    size = (round((y1 - y0) * _BROW_PX_PER_MM), round((x1 - x0) * _BROW_PX_PER_MM))
    curve, half_height = _brow_curve(points, traits)
    hairs = np.zeros(size, np.float32)
    for _ in range(round(350 * traits.brow_density)):
        s = rng.beta(1.15, 1.25)
        across = np.clip(rng.normal(0, 0.5), -1, 1)
        x, y = curve(s)
        slope = np.diff(curve(np.array([s - 0.02, min(s + 0.02, 1.0)])), axis=1).ravel()
        direction = np.arctan2(slope[1], slope[0])
        # hairs rise at the inner end, lie along the arch, and close in from above and below
        lean = np.interp(s, (0, 0.12, 0.35, 1), (0.95, 0.62, 0.34, 0.04)) - 0.30 * across
        angle = direction + lean + rng.normal(0, 0.10)
        length = np.interp(s, (0, 0.2, 0.7, 1), (4.2, 6.0, 6.0, 4.0)) * rng.uniform(0.75, 1.15)
        y += across * half_height(s) - 0.35 * length * np.sin(lean) * 0.5
        t = np.linspace(0, 1, 6)[:, None]
        bend = angle - 0.45 * t * np.sign(lean)
        step = np.concatenate([np.cos(bend), np.sin(bend)], axis=1) * length / 6
        line = np.array([x, y]) + np.cumsum(step, axis=0)
        pixels = np.stack([line[:, 0] - x0, y1 - line[:, 1]], axis=1) * _BROW_PX_PER_MM * 16
        stroke = np.zeros(size, np.uint8)
        low, high = pixels.min(axis=0) / 16 - 8, pixels.max(axis=0) / 16 + 8
        box = (
            slice(max(0, int(low[1])), max(0, int(high[1]))),
            slice(max(0, int(low[0])), max(0, int(high[0]))),
        )
        part = np.rint(pixels).astype(np.int32).reshape(-1, 1, 2)
        thick = 4 if rng.random() < 0.4 else 3
        cv2.polylines(stroke, [part], False, 255, thick, cv2.LINE_AA, shift=4)
        strength = rng.uniform(0.4, 0.75) * np.interp(s, (0, 0.18, 1), (0.55, 1.0, 0.9))
        hairs[box] += (1 - hairs[box]) * strength * (stroke[box] / 255.0)
    soft = cv2.GaussianBlur(hairs, (0, 0), 0.7 * _BROW_PX_PER_MM)
    total = 0.74 * cv2.GaussianBlur(hairs, (0, 0), 1.0) + 0.34 * soft
    return np.asarray(np.rint(np.clip(total, 0, 0.93) * 255), dtype=np.uint8)


def _brow_curve(points: NDArray[np.float64], traits: AppearanceTraits) -> tuple[Any, Any]:
    """Middle line, s in [0, 1] → (2, ...) mm, and half height of the left brow."""
    inner, arch, outer = points
    knots = np.array(
        [
            (inner[0] - 3.5, inner[1] + 1.5),
            (inner[0] + 6.0, inner[1] + 2.4),
            (arch[0] - 1.0, arch[1] - 3.2 + traits.brow_arch_mm),
            (outer[0] - 4.0, outer[1] + 1.2 + 0.6 * traits.brow_arch_mm),
            (outer[0] + 4.5, outer[1] - 3.0),
        ]
    )
    line = PchipInterpolator((0, 0.25, 0.6, 0.82, 1.0), knots.T, axis=1)
    thick = traits.brow_thickness

    def half_height(s: Any) -> Any:
        return thick * np.interp(s, (0, 0.15, 0.45, 0.75, 1), (2.1, 2.9, 2.9, 2.1, 0.5))

    return line, half_height


# ------------------------------------------------------------------------------ eyes and mouth


def _painted_eye(traits: AppearanceTraits, rng: np.random.Generator) -> NDArray[np.uint8]:
    n = EYE_PX
    y, x = (np.mgrid[0:n, 0:n] + 0.5) / n * 2 - 1
    r, angle = np.hypot(x, y) / 0.98, np.arctan2(y, x)
    theta = np.interp(r, (0, _EYE_FRONT_SHARE, 1.0), (0, _EYE_FRONT_RAD, np.pi))
    rho = theta / _IRIS_RAD  # 1 at the edge of the iris
    sclera = linear_from_srgb(np.array([232, 224, 216]))
    pink = linear_from_srgb(np.array([214, 172, 158]))
    light = sclera + _step(1.6, 3.2, rho)[..., None] * 0.6 * (pink - sclera)
    veins = _drawn_veins(rng, n)
    light = light * np.exp(-veins[..., None] * np.array([0.05, 0.42, 0.36]))
    light = light * (1 - 0.22 * np.exp(-(((rho - 1.04) / 0.16) ** 2)))[..., None]
    iris = _iris_light(traits, rng, rho, angle, y)
    edge = _step(1.06, 0.95, rho)[..., None]
    light = light + edge * (iris - light)
    pupil = _step(_PUPIL_SHARE + 0.03, _PUPIL_SHARE - 0.03, rho)[..., None]
    light = light + pupil * (0.004 - light)
    return _srgb_from_linear(light.astype(np.float32))


def _iris_light(
    traits: AppearanceTraits,
    rng: np.random.Generator,
    rho: NDArray[Any],
    angle: NDArray[Any],
    y: NDArray[Any],
) -> NDArray[Any]:
    base = linear_from_srgb(np.array(traits.iris))
    turns = (angle / (2 * np.pi)) % 1
    fibres = np.zeros_like(rho)
    for count, weight in ((60, 0.5), (110, 0.6), (190, 0.5)):
        ring = rng.normal(size=(4, count))
        column = (turns * count).astype(int) % count
        nearer = np.clip((rho * 4).astype(int), 0, 3)
        share = (turns * count) % 1
        share = share * share * (3 - 2 * share)
        fibres += weight * (
            ring[nearer, column] * (1 - share) + ring[nearer, (column + 1) % count] * share
        )
    light = base * (1.30 + 0.26 * fibres)[..., None]
    warm = linear_from_srgb(np.array([150, 98, 48])) * (0.5 + base.max())
    collar = np.exp(-(((rho - 0.52) / 0.12) ** 2))[..., None]
    light = light + 0.35 * collar * (warm - light)
    ring = 1 - 0.80 * _step(0.72, 1.02, rho)
    lens = 1 + 0.55 * _step(-0.15, 0.15, y) * _step(0.3, 0.6, rho)  # light gathers opposite
    shade = 1 - 0.35 * _step(0.02, -0.14, y)  # the lid's shade
    return np.asarray(np.clip(light, 0.004, 1) * (ring * lens * shade)[..., None])


def _drawn_veins(rng: np.random.Generator, n: int) -> NDArray[Any]:
    """Faint vessels that run from the rim towards the iris."""
    picture = np.zeros((n, n), np.uint8)
    for _ in range(26):
        angle = rng.choice([0, np.pi]) + rng.normal(0, 0.45)
        radius = rng.uniform(0.40, 0.47)
        stop, wobble = rng.uniform(0.21, 0.33), rng.normal(0, 0.05, 40).cumsum()
        path = []
        for step, turn in zip(np.linspace(radius, stop, 40), wobble, strict=True):
            a = angle + 0.5 * turn
            path.append((n / 2 + n * step * np.cos(a), n / 2 + n * step * np.sin(a)))
        points = np.rint(np.array(path) * 16).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(picture, [points], False, int(rng.integers(70, 190)), 1, cv2.LINE_AA, 4)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.9) / 255.0)


#: Widths of the teeth from the middle outwards, mm (means of adults).
_TEETH_MM = {
    "upper": (8.5, 6.6, 7.6, 7.0, 6.8, 10.0, 9.5, 8.5),
    "lower": (5.4, 5.9, 6.9, 7.0, 7.1, 11.0, 10.5, 10.0),
}


def _painted_details(traits: AppearanceTraits, rng: np.random.Generator) -> NDArray[np.uint8]:
    n = DETAILS_PX
    light = np.zeros((n, n, 4), np.float32)
    light[..., 3] = 1
    light[: n // 4, :, :3] = _teeth_light(rng, "upper")
    light[n // 4 : n // 2, :, :3] = _teeth_light(rng, "lower")[::-1]
    tongue = linear_from_srgb(np.array([168, 88, 86])).astype(np.float32)
    bumps = cv2.GaussianBlur(rng.normal(size=(n // 4, n)).astype(np.float32), (0, 0), 1.5)
    far = np.linspace(1.0, 0.25, n // 4, dtype=np.float32)[:, None]  # into the throat
    light[n // 2 : 3 * n // 4, :, :3] = tongue * ((1 + 0.2 * bumps) * far)[..., None]
    light[3 * n // 4 :, :, :3] = linear_from_srgb(np.array(traits.brow)) * 0.45
    light[3 * n // 4 :, :, 3] = _lash_alpha(rng, n // 4, n)
    found = np.empty((n, n, 4), np.uint8)
    found[..., :3] = _srgb_from_linear(light[..., :3])
    found[..., 3] = np.rint(light[..., 3] * 255)
    return found


def _teeth_light(rng: np.random.Generator, row: str) -> NDArray[Any]:
    """A row of teeth seen from outside; gums at the top."""
    height, width = DETAILS_PX // 4, DETAILS_PX
    widths = np.array(_TEETH_MM[row])
    edges = np.concatenate([[0], np.cumsum(widths)])
    edges = edges / edges[-1]
    x = np.abs((np.arange(width) + 0.5) / width * 2 - 1.0)
    tooth = np.clip(np.searchsorted(edges, x) - 1, 0, len(widths) - 1)
    within = (x - edges[tooth]) / (edges[tooth + 1] - edges[tooth])  # 0..1 across a tooth
    from_edge = np.minimum(within, 1 - within) * widths[tooth]  # mm
    t = np.linspace(0, 1, height)[:, None]
    enamel = linear_from_srgb(np.array([226, 214, 192]))
    neck = linear_from_srgb(np.array([206, 182, 142]))
    tone = rng.normal(1, 0.02, size=(2, len(widths)))[np.arange(width) * 2 // width, tooth]
    light = enamel + _step(0.55, 0.12, t)[..., None] * 0.55 * (neck - enamel)
    light = np.broadcast_to(light, (height, width, 3)) * tone[None, :, None]
    gap = np.exp(-((from_edge / 0.32) ** 2))
    light = light * (1 - 0.62 * gap)[None, :, None]
    scallop = 0.16 + 0.10 * (np.abs(2 * within - 1) ** 2)
    gum = _step(0.03, -0.03, t - scallop[None])[..., None]
    return np.asarray(light + gum * (linear_from_srgb(np.array([176, 98, 94])) - light))


def _lash_alpha(rng: np.random.Generator, height: int, width: int) -> NDArray[Any]:
    """Hairs from the root (bottom) to the tip (top)."""
    picture = np.zeros((height, width), np.uint8)
    for _ in range(130):
        root = rng.uniform(0, width)
        lean = (root / width - 0.35) * 60 + rng.normal(0, 10)
        length = rng.uniform(0.55, 1.0) * height
        line = np.array([[root, height + 2], [root + lean, height - length]])
        points = np.rint(line * 16).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(picture, [points], False, 255, 3, cv2.LINE_AA, 4)
    fade = np.linspace(0.25, 1.0, height)[:, None]
    inner = np.interp(np.arange(width), (0, 0.25 * width), (0.25, 1.0))
    return np.asarray(picture / 255.0 * fade * inner * 0.95)
