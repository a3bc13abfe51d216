"""Meshes as a structured-light scanner makes them: holes, islands, noise and uneven edges.

A projector and a camera look at the subject from a few sides. A place is measured where both see
it, where light comes back (dark hair, pupils and brows return little) and where neither grazes: so
holes open at hair, ears, nostrils and brows, their edges fray, and tufts of hair stay behind as
islands (Kähler, Haber, Yamauchi & Seidel 2002, figure 3). The views are fused into one surface, or
stay patches that overlap and are not quite registered.

Scan frame: the scanner's own, anywhere about the head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..core.arrays import readonly
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..core.rigid import Rigid
from ..heads.srgb import srgb_from_linear
from ..heads.texture_noise import noise_at
from .scan_target import Floats, ScanTarget, Seen, random_tilt

TRIANGLES = (2_000, 300_000)
_DISTANCE_MM, _BASELINE_MM = 850.0, 230.0
_YAWS_DEG = (0.0, 52.0, -52.0, 98.0, -98.0)
_BELOW_CHIN_MM = 75.0
_AXIS_BEHIND_MM = 70.0
_LEAST_COSINE, _LEAST_SIGNAL = 0.24, 0.034
_SD_MM, _EYE_SD_MM, _HAIR_SD_MM = 0.10, 0.8, 1.2
_RIPPLE_MM, _RIPPLE_PERIOD_MM = 0.07, 9.0  # what is left of the projected fringes
_LONGEST_STEPS = 5.0  # of an edge, in steps of the grid; longer ones bridge a gap
_PATCH_TURN_RAD, _PATCH_SHIFT_MM = np.radians(0.08), 0.15  # what registration leaves
_N_ISLANDS = (5, 12)
_SHARE_MESHED = 0.65  # of a grid's triangles that are left: where the search begins
_CLOSE_ENOUGH, _SEARCH_STEPS = 0.90, 8  # of the number of triangles asked for


@dataclass(frozen=True, eq=False)
class MeshScan:
    """A scanned surface.

    Attributes
    ----------
    mesh : Mesh
        Scan frame.
    colour : (V, 3) uint8, sRGB
    exact : (V, 3) float64, mm, scan frame
        Where on the true surface each vertex was measured; NaN on stray islands off the surface.
    patch : (V,) int32
        View that each vertex is of; all 0 where they are fused.
    scan_from_head : Rigid
    """

    mesh: Mesh
    colour: NDArray[np.uint8]
    exact: Floats
    patch: NDArray[np.int32]
    scan_from_head: Rigid

    def __post_init__(self) -> None:
        n = len(self.mesh.vertices)
        set_field = object.__setattr__
        set_field(self, "colour", readonly(self.colour, (n, 3), "colour", np.uint8))
        set_field(self, "exact", readonly(self.exact, (n, 3), "exact"))
        set_field(self, "patch", readonly(self.patch, (n,), "patch", np.int32))


@dataclass(frozen=True, eq=False)
class _View:
    """Projector and camera of one view, head frame."""

    camera: Floats
    projector: Floats
    forward: Floats
    right: Floats


def scan_mesh(
    target: ScanTarget, seed: int, *, triangles: int = 120_000, patches: bool = False
) -> MeshScan:
    """Scan a person by structured light.

    Parameters
    ----------
    target : ScanTarget
    seed : int
        Of the scanner's place, the noise and the islands.
    triangles : int
        About as many, never more; 2,000 to 300,000.
    patches : bool
        Keep the views apart.

    Raises
    ------
    InputError
        If the number of triangles is out of range.
    """
    if not TRIANGLES[0] <= triangles <= TRIANGLES[1]:
        raise InputError(f"triangles must lie in {TRIANGLES[0]} to {TRIANGLES[1]}, got {triangles}")
    rng = np.random.default_rng([seed, 91])
    turn = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    scan_from_head = Rigid.from_rotation(turn, rng.uniform(-400, 400, 3))
    views = [_view(target, rng, np.radians(yaw)) for yaw in _YAWS_DEG]
    wanted = triangles / _SHARE_MESHED
    for step in range(_SEARCH_STEPS):
        parts = _parts(target, views, wanted, seed, patches=patches)
        found = sum(len(part.triangles) for part in parts)
        if _CLOSE_ENOUGH * triangles <= found <= triangles:
            break
        # ever more careful not to overshoot: steps of a grid are whole numbers
        wanted *= (0.97 - 0.01 * step) * triangles / max(found, 1)
    assert found <= triangles, "a coarser grid has fewer triangles"
    return _joined(parts, scan_from_head, rng, is_moved=patches)


def _parts(
    target: ScanTarget, views: list[_View], wanted: float, seed: int, *, patches: bool
) -> list[_Patch]:
    """What is measured on grids of about `wanted` triangles in all, holes included."""
    if not patches:
        rng = np.random.default_rng([seed, 92])
        return [_measured(target, views, *_around_grid(target, wanted), rng, seed)]
    found = []
    for number, view in enumerate(views):
        rng = np.random.default_rng([seed, 92, number])
        grid = _view_grid(target, view, wanted / len(views))
        found.append(_measured(target, [view], *grid, rng, seed))
    return found


@dataclass(frozen=True, eq=False)
class _Patch:
    """A grid's measured places, head frame, and its triangles."""

    places: Floats
    exact: Floats
    colour: NDArray[np.uint8]
    triangles: NDArray[np.int32]


def _view(target: ScanTarget, rng: np.random.Generator, yaw: float) -> _View:
    yaw = yaw + float(rng.normal(0, 0.06))
    pitch = float(rng.normal(-0.03, 0.05))
    away = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    aim = np.array([0.0, -25.0, -_AXIS_BEHIND_MM])
    camera = aim + _DISTANCE_MM * away
    side = float(rng.choice((-1.0, 1.0)))
    return _View(camera, camera + side * _BASELINE_MM * right, -away, right)


def _around_grid(target: ScanTarget, wanted: float) -> tuple[Floats, Floats]:
    """Rays (rows, columns, 3) from all around inwards: of a cylinder with a dome."""
    low, high = _heights(target)
    axis_z = -_AXIS_BEHIND_MM
    dome_mm = 100.0  # the crown is met from above
    length = (high - dome_mm - low) + dome_mm * np.pi / 2
    girth = 2 * np.pi * dome_mm
    columns = max(int(np.sqrt(wanted / 2 * girth / length)), 8)
    rows = max(int(wanted / 2 / columns), 8)
    s = (np.arange(rows) + 0.5) / rows * length
    climb = np.clip((s - (high - dome_mm - low)) / dome_mm, 0, np.pi / 2)[::-1, None]
    centre_y = (low + np.minimum(s, high - dome_mm - low))[::-1, None]
    theta = (np.arange(columns) / columns * 2 * np.pi - np.pi)[None, :]
    out = np.stack(
        [
            np.cos(climb) * np.sin(theta),
            np.sin(climb) + 0 * theta,
            np.cos(climb) * np.cos(theta),
        ],
        axis=-1,
    )
    centre = np.stack([0 * centre_y, centre_y, axis_z + 0 * centre_y], axis=-1)
    return centre + 320.0 * out, -out


def _view_grid(target: ScanTarget, view: _View, wanted: float) -> tuple[Floats, Floats]:
    """Rays (rows, columns, 3) of a camera's pixels."""
    low, high = _heights(target)
    half_h = 0.56 * (high - low)
    half_w = 0.85 * half_h
    columns = max(int(np.sqrt(wanted / 2 * half_w / half_h)), 8)
    rows = max(int(wanted / 2 / columns), 8)
    x = np.linspace(-half_w, half_w, columns)[None, :, None]
    y = np.linspace(half_h, -half_h, rows)[:, None, None]
    up = np.cross(view.right, view.forward)
    centre = np.array([0.0, (low + high) / 2, -_AXIS_BEHIND_MM])
    goal = centre + x * view.right + y * up
    way = goal - view.camera
    way = way / np.linalg.norm(way, axis=-1, keepdims=True)
    return np.broadcast_to(view.camera, way.shape), way


def _heights(target: ScanTarget) -> tuple[float, float]:
    head = target.head
    skin = head.mesh.vertices[head.part_vertices("skin")]
    return float(head.points["2.1"][1]) - _BELOW_CHIN_MM, float(skin[:, 1].max())


def _measured(
    target: ScanTarget,
    views: list[_View],
    origins: Floats,
    directions: Floats,
    rng: np.random.Generator,
    seed: int,
) -> _Patch:
    """What some views see of the places that a grid of rays meets."""
    rows, columns = directions.shape[:2]
    seen = target.look(origins.reshape(-1, 3), directions.reshape(-1, 3))
    n = len(seen.hit)
    best, sight = np.zeros(n), np.zeros((n, 3))
    least = np.zeros(n)
    for view in views:
        lit, looked = (target.cosine_from(seen, p) for p in (view.projector, view.camera))
        quality = lit * np.sqrt(looked)
        better = quality > best
        best[better] = quality[better]
        least[better] = np.minimum(lit, looked)[better]
        way = view.camera - seen.places[better]
        sight[better] = way / np.linalg.norm(way, axis=1, keepdims=True)
    valid = _is_valid(seen, best, least, seed)
    sd = _SD_MM / np.clip(least, 0.2, 1)
    sd = np.where(seen.on_eye, _EYE_SD_MM, np.where(seen.in_hair, _HAIR_SD_MM, sd))
    ripple = _RIPPLE_MM * np.sin(2 * np.pi * (seen.places @ (1.0, 0.15, 0.6)) / _RIPPLE_PERIOD_MM)
    off = sd * rng.standard_normal(n) + ripple
    places = seen.places + off[:, None] * sight
    strays = _strays(seen, rng)
    places[strays] += (seen.normals * rng.uniform(5, 14))[strays]
    exact = np.where(strays[:, None], np.nan, seen.places)
    valid |= strays
    light = seen.colour * (0.3 + 0.7 * np.sqrt(best))[:, None].astype(np.float32)
    step = _step(seen.places.reshape(rows, columns, 3))
    triangles = _triangles(places, valid, strays, rows, columns, _LONGEST_STEPS * step)
    return _Patch(places, exact, srgb_from_linear(light), triangles)


def _is_valid(seen: Seen, best: Floats, least: Floats, seed: int) -> NDArray[np.bool_]:
    ragged = np.zeros(len(seen.hit), np.float32)
    at = seen.places[seen.hit].astype(np.float32)
    ragged[seen.hit] = noise_at(at, 7.0, seed) + noise_at(at, 2.5, seed + 1)
    luminance = seen.colour @ np.array([0.3, 0.5, 0.2], np.float32)
    signal = luminance * best * np.where(seen.in_hair, np.exp(1.1 * ragged), np.exp(0.2 * ragged))
    grazes = least < _LEAST_COSINE * (1 + 0.25 * ragged)
    return np.asarray(seen.hit & ~grazes & (signal > _LEAST_SIGNAL))


def _strays(seen: Seen, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Small spots about hair that float off the surface: locks that caught the light."""
    found = np.zeros(len(seen.hit), bool)
    hair = np.flatnonzero(seen.in_hair & seen.hit)
    if not len(hair):
        return found
    for middle in rng.choice(hair, int(rng.integers(*_N_ISLANDS))):
        radius = float(rng.uniform(2.5, 7.0))
        off = np.linalg.norm(seen.places[hair] - seen.places[middle], axis=1)
        found[hair[off < radius * rng.uniform(0.6, 1.0, len(hair))]] = True
    return found


def _step(places: Floats) -> float:
    """Median distance of neighbours along a column."""
    apart = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    return float(np.nanmedian(apart))


def _triangles(
    places: Floats,
    valid: NDArray[np.bool_],
    strays: NDArray[np.bool_],
    rows: int,
    columns: int,
    longest_mm: float,
) -> NDArray[np.int32]:
    """Of a grid, row by row from above, seen from outside; all corners valid, no long edge."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    found = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])
    found = found[valid[found].all(axis=1)]
    alike = strays[found]
    found = found[alike.all(axis=1) | ~alike.any(axis=1)]
    corners = places[found]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return np.asarray(found[(edges < longest_mm).all(axis=1)], dtype=np.int32)


def _joined(
    parts: list[_Patch],
    scan_from_head: Rigid,
    rng: np.random.Generator,
    *,
    is_moved: bool,
) -> MeshScan:
    """All patches as one mesh in the scan frame, without unused vertices."""
    places, exact, colour, triangles, patch = [], [], [], [], []
    first = 0
    for number, part in enumerate(parts):
        used, inverse = np.unique(part.triangles, return_inverse=True)
        own = scan_from_head.apply(part.places[used])
        if is_moved and number:
            turn = random_tilt(rng, _PATCH_TURN_RAD)
            middle = own.mean(axis=0)
            own = (own - middle) @ turn.T + middle + rng.normal(0, _PATCH_SHIFT_MM, 3)
        places.append(own)
        exact.append(scan_from_head.apply(part.exact[used]))
        colour.append(part.colour[used])
        triangles.append(inverse.reshape(-1, 3).astype(np.int32) + np.int32(first))
        patch.append(np.full(len(used), number, np.int32))
        first += len(used)
    return MeshScan(
        Mesh(np.concatenate(places), np.concatenate(triangles)),
        np.concatenate(colour),
        np.concatenate(exact),
        np.concatenate(patch),
        scan_from_head,
    )
