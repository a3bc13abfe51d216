"""Where the irises are, measured in the picture.

The landmark network sees where an eye looks only roughly. Within the opening between the lids a
picture has two parts, dark disc and light white; the disc's centre is where the split explains the
picture best (Chan & Vese 2001, Active contours without edges, with a disc of known size in place
of a free curve). Lids may hide any of it: only what lies in the opening counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .landmark_regions import CONTOURS, QUICK_REGIONS

Floats = NDArray[np.float64]

EYES = ("right", "left")
IRISES = tuple(QUICK_REGIONS[f"iris_{side}"] for side in EYES)  # the centre first
_LIDS = tuple(np.array(CONTOURS[f"lids_{side}"]) for side in EYES)
_CORNERS = ((33, 133), (362, 263))  # as the picture shows them, left to right
#: The eye's patch: px of the patch in the distance of the corners; what is beside and above them.
_WIDE_PX, _BESIDE, _ABOVE = 32, 0.1, 0.35
#: How far from the network's iris and in what steps it is looked for, x and y, of that distance.
_REACH, _STEP = (0.24, 0.16), (0.06, 0.08)
#: Lashes and the lid's edge are dark: share of the opening's height that is left out above, below.
_TRIM = (0.3, 0.15)
#: How far the network's iris is off, x and y: the split's share of the variance is weighed with it.
_NETWORK_SD, _NOISE_SHARE = (0.08, 0.02), 0.02
_EDGE_PX = 1.0  # of the patch: over which a disc's edge is soft
_LEAST_OPEN = 0.1  # height of the trimmed opening over its width: below, no iris is looked for
_LEAST_SPLIT = 0.4  # share of the opening's variance that the split must explain


@dataclass(frozen=True, eq=False)
class IrisFit:
    """Irises in one picture: rows right, left.

    Attributes
    ----------
    centre_px : (2, 2) float64
        NaN where the eye is closed or shows no iris.
    explained : (2,) float64
        Share of the variance within the opening that iris and white explain.
    """

    centre_px: Floats
    explained: Floats


def fit_irises(gray: NDArray[np.uint8], points_px: Floats, radius: Floats) -> IrisFit:
    """Measure both irises.

    Parameters
    ----------
    gray : (h, w) uint8
    points_px : (478, 2) float64
        The face's landmarks.
    radius : (2,) float64
        Of each iris over the distance of that eye's corners.
    """
    centre, explained = np.full((2, 2), np.nan), np.zeros(2)
    for eye in range(2):
        patch = _patch(gray, points_px, eye)
        if patch is not None:
            centre[eye], explained[eye] = _fitted(patch, float(radius[eye]))
    return IrisFit(centre, explained)


def usual_radius(points_px: Floats) -> Floats:
    """What the network says of the irises' size in some frames (T, 478, 2): see `fit_irises`."""
    found = []
    for rows, (a, b) in zip(IRISES, _CORNERS, strict=True):
        rim = points_px[:, list(rows[1:])] - points_px[:, rows[:1]]
        across = np.linalg.norm(points_px[:, b] - points_px[:, a], axis=1)
        found.append(np.nanmedian(np.linalg.norm(rim, axis=2).mean(axis=1) / across))
    return np.array(found)


@dataclass(frozen=True, eq=False)
class _Patch:
    """An eye's opening: grey levels, weights and places (n, 2) in corners' distances from the
    middle between the corners, the network's iris among them; and the way back to the picture."""

    gray: Floats
    weight: Floats
    at: Floats
    guess: Floats
    centre: Floats
    axes: Floats


def _patch(gray: NDArray[np.uint8], points: Floats, eye: int) -> _Patch | None:
    a, b = points[list(_CORNERS[eye])]
    lids, guess = points[_LIDS[eye]], points[IRISES[eye][0]]
    if not np.isfinite(lids).all() or not np.isfinite(guess).all() or np.linalg.norm(b - a) < 4:
        return None
    x, middle = b - a, (a + b) / 2
    axes = np.column_stack([x, (-x[1], x[0])])
    inwards = np.linalg.inv(axes).T
    outline = _trimmed((lids - middle) @ inwards)
    if (outline[9:, 1][::-1] - outline[1:8, 1]).max() < _LEAST_OPEN:
        return None
    size = np.round(2 * np.array([0.5 + _BESIDE, _ABOVE]) * _WIDE_PX).astype(int)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in size)), axis=-1)
    at = (grid + 0.5 - size / 2) / _WIDE_PX
    where = (at @ axes.T + middle).astype(np.float32)
    picture = cv2.remap(gray, where[..., 0], where[..., 1], cv2.INTER_LINEAR)
    sixteenths = np.round((outline * _WIDE_PX + size / 2 - 0.5) * 16).astype(np.int32)
    opening = np.zeros(picture.shape, np.uint8)
    cv2.fillPoly(opening, [sixteenths], 255, cv2.LINE_AA, 4)
    inside = opening > 0
    weight, level = opening[inside] / 255.0, picture[inside].astype(np.float64)
    return _Patch(level, weight, at[inside], (guess - middle) @ inwards, middle, axes)


def _trimmed(lids: Floats) -> Floats:
    """The lids (16, 2), the upper ones first after the outer corner, a little closed."""
    upper, lower = lids[1:8], lids[9:][::-1]
    height = lower - upper
    closed = lids.copy()
    closed[1:8] += _TRIM[0] * height
    closed[9:] -= _TRIM[1] * height[::-1]
    return closed


def _fitted(patch: _Patch, radius: float) -> tuple[Floats, float]:
    """Centre in the picture and the share explained: a coarse grid, then a parabola each way."""
    g = _without_glints(patch.gray, patch.weight)
    g = g - (patch.weight @ g) / patch.weight.sum()
    total = max(float(patch.weight @ g**2), 1e-9)

    def score(centres: Floats) -> Floats:
        off = ((centres - patch.guess) / _NETWORK_SD) ** 2
        share = _explained(centres, patch.at, patch.weight, g, radius) / total
        return np.asarray(share - _NOISE_SHARE * off.sum(axis=1))

    ways = [np.arange(-r, r + 1e-9, s) for r, s in zip(_REACH, _STEP, strict=True)]
    tried = patch.guess + np.stack(np.meshgrid(*ways), axis=-1).reshape(-1, 2)
    best = tried[int(score(tried).argmax())]
    around = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(-1, 2)
    for share in (0.5, 0.2):
        size = share * np.array(_STEP)
        best = best + size * _top(score(best + size * around).reshape(3, 3))
    share = float(_explained(best[None], patch.at, patch.weight, g, radius)[0]) / total
    if share < _LEAST_SPLIT:
        return np.full(2, np.nan), share
    return patch.axes @ best + patch.centre, share


def _without_glints(g: Floats, w: Floats) -> Floats:
    """Grey levels no brighter than most of the white."""
    order = np.argsort(g)
    share = np.cumsum(w[order]) / w.sum()
    return np.asarray(np.minimum(g, g[order][min(int(np.searchsorted(share, 0.9)), len(g) - 1)]))


def _explained(centres: Floats, at: Floats, w: Floats, g: Floats, radius: float) -> Floats:
    """Sum of squares that a dark disc at each centre (n, 2) takes off; negative if it is light."""
    x, y = (at[:, i] - centres[:, i, None] for i in range(2))
    inside = np.clip((radius - np.sqrt(x * x + y * y)) * (_WIDE_PX / _EDGE_PX) + 0.5, 0, 1) * w
    n_in, sum_in = inside.sum(axis=1), inside @ g
    n_out = w.sum() - n_in
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = sum_in**2 * (1 / n_in + 1 / n_out)  # means weigh to zero in all
    return np.where((n_in > 0) & (n_out > 0), -np.sign(sum_in) * gain, 0.0)


def _top(score: Floats) -> Floats:
    """Where a parabola through 3 x 3 scores has its top, steps (x, y), at most 1 away."""
    found = []
    for line in (score[1], score[:, 1]):
        bend = line[0] - 2 * line[1] + line[2]
        slope = (line[2] - line[0]) / 2
        if bend < 0:
            found.append(np.clip(-slope / bend, -1, 1))
        else:
            found.append(float(np.argmax(line)) - 1)
    return np.array(found)
