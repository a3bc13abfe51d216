"""What stands at the walls of a painted room: flat paint, for what is far out of focus.

Canvases are (h, w, 3) float32, linear light, and are changed in place; places are in their pixels.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

PX_PER_MM = 0.4
_OUTSIDE_LIGHT = 1.35  # of a window by day


def furnish(rng: np.random.Generator, canvas: Floats, *, with_window: bool) -> None:
    """Fill a wall from left to right."""
    w = canvas.shape[1] / PX_PER_MM
    things: list[tuple[Callable[..., None], tuple[float, float]]] = [
        (_bookshelf, (700, 1300)),
        (_pictures, (500, 1100)),
        (_sideboard, (900, 1500)),
        (_plant, (450, 800)),
        (_lamp, (350, 550)),
        (_door, (850, 950)),
        (_pin_board, (600, 1000)),
    ]
    order = list(rng.permutation(len(things)))
    x = float(rng.uniform(-200, 200))
    window_at = float(rng.uniform(0.1, 0.6)) * w if with_window else np.inf
    while x < w - 200:
        if x >= window_at:
            thing, (low, high) = _window, (1000.0, 1700.0)
            window_at = np.inf
        else:
            if not order:
                order = list(rng.permutation(len(things)))
            thing, (low, high) = things[order.pop()]
        width = float(rng.uniform(low, high))
        thing(rng, canvas, x * PX_PER_MM, (x + width) * PX_PER_MM)
        x += width + float(rng.uniform(40, 350))


def paint_skirting(rng: np.random.Generator, canvas: Floats) -> None:
    h, w = canvas.shape[:2]
    _rect(canvas, 0, h - 90 * PX_PER_MM, w, h, np.full(3, rng.uniform(0.3, 0.7)))


def paint_floor(
    rng: np.random.Generator, size: tuple[float, float], colour: NDArray[np.float64]
) -> Floats:
    canvas = canvas_of(size, colour)
    h, w = canvas.shape[:2]
    plank = 140 * PX_PER_MM
    for x in np.arange(0, w, plank):
        shade = colour * rng.uniform(0.8, 1.2)
        _rect(canvas, x, 0, x + plank - 1, h, shade)
    if rng.random() < 0.6:  # a rug
        x0, y0 = rng.uniform(0.1, 0.4) * w, rng.uniform(0.1, 0.4) * h
        rug = random_hue(rng, 0.7) * rng.uniform(0.08, 0.3)
        _rect(canvas, x0, y0, x0 + 0.45 * w, y0 + 0.4 * h, rug)
    return lit(canvas, rng, 0.4)


def canvas_of(size_mm: tuple[float, float], colour: NDArray[np.float64]) -> Floats:
    shape = round(size_mm[1] * PX_PER_MM), round(size_mm[0] * PX_PER_MM)
    return np.tile(colour.astype(np.float32), (*shape, 1))


def random_hue(rng: np.random.Generator, saturation: float) -> NDArray[np.float64]:
    """A hue with a luminance of about 1."""
    hue = rng.uniform(0, 2 * np.pi)
    found = 1 + saturation * np.cos(hue - np.array([0.0, 2.09, 4.19]))
    return np.asarray(found / found.mean())


def lit(canvas: Floats, rng: np.random.Generator, depth: float) -> Floats:
    """Uneven light on a wall: pools and corners."""
    coarse = rng.normal(size=(5, 7)).astype(np.float32)
    h, w = canvas.shape[:2]
    soft = cv2.resize(coarse, (w, h), interpolation=cv2.INTER_CUBIC)
    y, x = np.mgrid[0:h, 0:w].astype(np.float32)
    corner = (np.abs(2 * x / w - 1) ** 4 + np.abs(2 * y / h - 1) ** 4) * 0.35
    return np.asarray(canvas * np.exp(depth * 0.45 * soft - corner)[..., None], dtype=np.float32)


def _rect(canvas: Floats, x0: float, y0: float, x1: float, y1: float, colour: object) -> None:
    h, w = canvas.shape[:2]
    i0, i1 = max(round(x0), 0), min(round(x1), w)
    j0, j1 = max(round(y0), 0), min(round(y1), h)
    if i0 < i1 and j0 < j1:
        canvas[j0:j1, i0:i1] = np.asarray(colour, dtype=np.float32)


def _shadow(canvas: Floats, x0: float, y0: float, x1: float, y1: float, spread: float) -> None:
    """Darken the wall around something that stands before it."""
    h, w = canvas.shape[:2]
    pad = round(4 * spread)
    i0, i1 = max(round(x0) - pad, 0), min(round(x1) + pad, w)
    j0, j1 = max(round(y0) - pad, 0), min(round(y1) + pad, h)
    if i0 >= i1 or j0 >= j1:
        return
    mask = np.zeros((j1 - j0, i1 - i0), np.float32)
    _r = (round(x0 + spread) - i0, round(y0 + spread) - j0, round(x1 + spread) - i0)
    mask[max(_r[1], 0) : max(round(y1 + spread) - j0, 0), max(_r[0], 0) : max(_r[2], 0)] = 1
    mask = cv2.GaussianBlur(mask, (0, 0), spread)
    canvas[j0:j1, i0:i1] *= (1 - 0.5 * mask)[..., None]


def _wood(rng: np.random.Generator) -> NDArray[np.float64]:
    woods = np.array(
        [[0.30, 0.18, 0.09], [0.12, 0.07, 0.04], [0.55, 0.44, 0.30], [0.75, 0.73, 0.7]]
    )
    return np.asarray(woods[rng.integers(len(woods))] * rng.uniform(0.7, 1.15))


def _bookshelf(rng: np.random.Generator, canvas: Floats, x0: float, x1: float) -> None:
    h = canvas.shape[0]
    top = h - rng.uniform(1500, 2200) * PX_PER_MM
    board = 22 * PX_PER_MM
    wood = _wood(rng)
    _shadow(canvas, x0, top, x1, h, 40 * PX_PER_MM)
    _rect(canvas, x0, top, x1, h, wood * 0.35)
    shelf = rng.uniform(270, 380) * PX_PER_MM
    y = top + shelf
    while y < h:
        x = x0 + board
        while x < x1 - board:
            kind = rng.random()
            if kind < 0.78:
                n = int(rng.integers(3, 14))
                for _ in range(n):
                    wide = rng.uniform(12, 48) * PX_PER_MM
                    tall = rng.uniform(0.5, 0.92) * shelf
                    if x + wide > x1 - board:
                        break
                    book = random_hue(rng, rng.uniform(0.05, 0.6)) * np.exp(rng.uniform(-3.4, -0.9))
                    _rect(canvas, x, y - tall, x + wide - 1, y, book)
                    if rng.random() < 0.5:
                        _rect(
                            canvas, x + 1, y - 0.7 * tall, x + wide - 2, y - 0.6 * tall, book * 2.2
                        )
                    x += wide
            elif kind < 0.9:
                wide = rng.uniform(80, 200) * PX_PER_MM
                box = random_hue(rng, 0.4) * rng.uniform(0.05, 0.4)
                _rect(canvas, x, y - 0.55 * shelf, min(x + wide, x1 - board), y, box)
                x += wide
            x += rng.uniform(10, 120) * PX_PER_MM
        _rect(canvas, x0, y, x1, y + board, wood)
        y += shelf + board
    _rect(canvas, x0, top, x1, top + board, wood)
    for side in (x0, x1 - board):
        _rect(canvas, side, top, side + board, h, wood * 0.9)


def _pictures(rng: np.random.Generator, canvas: Floats, x0: float, x1: float) -> None:
    h = canvas.shape[0]
    n = int(rng.integers(1, 4))
    wide = (x1 - x0) / n
    for i in range(n):
        w = wide * rng.uniform(0.6, 0.9)
        tall = w * rng.uniform(0.7, 1.5)
        left = x0 + i * wide
        top = h * rng.uniform(0.16, 0.34)
        _shadow(canvas, left, top, left + w, top + tall, 12 * PX_PER_MM)
        frame = 18 * PX_PER_MM
        _rect(canvas, left, top, left + w, top + tall, _wood(rng))
        inside = (left + frame, top + frame, left + w - frame, top + tall - frame)
        _rect(canvas, *inside, np.full(3, rng.uniform(0.5, 0.85)))
        mat = rng.uniform(0, 0.14) * w
        art = (inside[0] + mat, inside[1] + mat, inside[2] - mat, inside[3] - mat)
        _painting(rng, canvas, *art)


def _painting(
    rng: np.random.Generator, canvas: Floats, x0: float, y0: float, x1: float, y1: float
) -> None:
    """A landscape or an abstract: soft blotches in two or three colours."""
    i0, j0 = max(round(x0), 0), max(round(y0), 0)
    part = canvas[j0 : max(round(y1), 0), i0 : max(round(x1), 0)]
    if part.shape[0] < 4 or part.shape[1] < 4:
        return
    h, w = part.shape[:2]
    a, b, c = (random_hue(rng, 0.4) * np.exp(rng.uniform(-2.5, -0.4)) for _ in range(3))
    noise = [
        cv2.resize(
            rng.normal(size=(4, 4)).astype(np.float32), (w, h), interpolation=cv2.INTER_CUBIC
        )
        for _ in range(2)
    ]
    down = np.linspace(-2, 2, h, dtype=np.float32)[:, None]
    first = 1 / (1 + np.exp(-3 * (noise[0] + down)))
    second = 1 / (1 + np.exp(-4 * (noise[1] - 0.4)))
    art = a + first[..., None] * (b - a)
    part[:] = art + second[..., None] * (c - art)


def _sideboard(rng: np.random.Generator, canvas: Floats, x0: float, x1: float) -> None:
    h = canvas.shape[0]
    top = h - rng.uniform(750, 950) * PX_PER_MM
    wood = _wood(rng)
    _shadow(canvas, x0, top, x1, h, 40 * PX_PER_MM)
    _rect(canvas, x0, top, x1, h, wood * 0.8)
    _rect(canvas, x0, top, x1, top + 30 * PX_PER_MM, wood * 1.15)
    n = int(rng.integers(2, 5))
    for i in range(1, n):
        x = x0 + (x1 - x0) * i / n
        _rect(canvas, x - 1, top + 30 * PX_PER_MM, x + 1, h, wood * 0.4)
    for _ in range(int(rng.integers(2, 5))):  # what stands on it
        x = rng.uniform(x0, x1 - 60)
        wide, tall = rng.uniform(60, 260) * PX_PER_MM, rng.uniform(90, 420) * PX_PER_MM
        if rng.random() < 0.5:
            centre = (round(x + wide / 2), round(top - tall / 2))
            axes = (max(round(wide / 2), 1), max(round(tall / 2), 1))
            colour = random_hue(rng, 0.5) * rng.uniform(0.05, 0.5)
            cv2.ellipse(canvas, centre, axes, 0, 0, 360, colour.tolist(), -1)
        else:
            box = random_hue(rng, 0.4) * rng.uniform(0.03, 0.4)
            _rect(canvas, x, top - tall, x + wide, top, box)
    if rng.random() < 0.6:
        middle = (x0 + x1) / 2
        w = (x1 - x0) * 0.3
        y = h * rng.uniform(0.18, 0.3)
        _shadow(canvas, middle - w, y, middle + w, y + w, 12 * PX_PER_MM)
        _rect(canvas, middle - w, y, middle + w, y + w, _wood(rng))
        _painting(rng, canvas, middle - 0.93 * w, y + 0.07 * w, middle + 0.93 * w, y + 0.93 * w)


def _plant(rng: np.random.Generator, canvas: Floats, x0: float, x1: float) -> None:
    h = canvas.shape[0]
    foot = h - rng.uniform(0, 700) * PX_PER_MM
    middle, w = (x0 + x1) / 2, x1 - x0
    pot = rng.uniform(180, 320) * PX_PER_MM
    clay = random_hue(rng, 0.4) * rng.uniform(0.1, 0.5)
    corners = np.array(
        [
            [middle - 0.3 * w, foot - pot],
            [middle + 0.3 * w, foot - pot],
            [middle + 0.22 * w, foot],
            [middle - 0.22 * w, foot],
        ]
    )
    cv2.fillPoly(canvas, [np.rint(corners).astype(np.int32)], clay.tolist())
    reach = rng.uniform(600, 1300) * PX_PER_MM
    green = np.array([0.075, 0.125, 0.05]) * rng.uniform(0.5, 1.3)
    stems = rng.normal(0, 0.42, 9)
    for angle in stems:
        tip = middle + np.sin(angle) * reach * 0.7, foot - pot - np.cos(angle) * reach
        start, end = (round(middle), round(foot - pot)), (round(tip[0]), round(tip[1]))
        cv2.line(canvas, start, end, (green * 0.5).tolist(), max(round(9 * PX_PER_MM), 1))
    for _ in range(int(rng.integers(90, 170))):
        angle = rng.choice(stems) + rng.normal(0, 0.07)
        r = reach * rng.uniform(0.15, 1.0) ** 0.8
        at = middle + np.sin(angle) * r * 0.7, foot - pot - np.cos(angle) * r
        long, thin = rng.uniform(70, 190) * PX_PER_MM, rng.uniform(16, 48) * PX_PER_MM
        turn = np.rad2deg(angle) - 90 + rng.normal(0, 35)
        leaf = green * np.exp(rng.normal(0, 0.45))
        centre = (round(at[0]), round(at[1]))
        axes = (max(round(long / 2), 1), max(round(thin / 2), 1))
        cv2.ellipse(canvas, centre, axes, float(turn), 0, 360, leaf.tolist(), -1)


def _lamp(rng: np.random.Generator, canvas: Floats, x0: float, x1: float) -> None:
    h, w = canvas.shape[:2]
    middle = (x0 + x1) / 2
    top = h - rng.uniform(1450, 1750) * PX_PER_MM
    tall = rng.uniform(220, 320) * PX_PER_MM
    _rect(canvas, middle - 4, top + tall, middle + 4, h, np.full(3, 0.03))
    is_on = rng.random() < 0.65
    if is_on:  # its glow on the wall
        y, x = np.mgrid[0:h, 0:w].astype(np.float32)
        off = np.hypot(x - middle, y - (top + tall / 2)) / (550 * PX_PER_MM)
        warm = np.array([1.0, 0.72, 0.42], np.float32)
        canvas *= 1 + 1.3 * np.exp(-(off**2))[..., None] * warm
    shade = np.array([1.25, 0.95, 0.62]) if is_on else np.array([0.55, 0.5, 0.42])
    half = (x1 - x0) / 2
    corners = np.array(
        [
            [middle - 0.6 * half, top],
            [middle + 0.6 * half, top],
            [middle + half, top + tall],
            [middle - half, top + tall],
        ]
    )
    cv2.fillPoly(canvas, [np.rint(corners).astype(np.int32)], shade.tolist())


def _door(rng: np.random.Generator, canvas: Floats, x0: float, x1: float) -> None:
    h = canvas.shape[0]
    top = h - 2020 * PX_PER_MM
    colour = _wood(rng)
    frame = 60 * PX_PER_MM
    _rect(canvas, x0 - frame, top - frame, x1 + frame, h, np.clip(colour * 1.2, 0, 0.8))
    _rect(canvas, x0, top, x1, h, colour)
    for low, high in ((0.08, 0.45), (0.52, 0.92)):
        y0, y1 = top + low * (h - top), top + high * (h - top)
        _rect(canvas, x0 + 2 * frame, y0, x1 - 2 * frame, y1, colour * 0.82)


def _pin_board(rng: np.random.Generator, canvas: Floats, x0: float, x1: float) -> None:
    h = canvas.shape[0]
    top = h * rng.uniform(0.18, 0.3)
    tall = (x1 - x0) * rng.uniform(0.5, 0.9)
    _shadow(canvas, x0, top, x1, top + tall, 10 * PX_PER_MM)
    _rect(canvas, x0, top, x1, top + tall, np.array([0.35, 0.22, 0.11]))
    for _ in range(int(rng.integers(8, 22))):
        w, t = (rng.uniform(60, 210, 2) * PX_PER_MM).tolist()
        x, y = rng.uniform(x0, max(x1 - w, x0 + 1)), rng.uniform(top, max(top + tall - t, top + 1))
        paper = random_hue(rng, rng.choice([0.05, 0.35])) * rng.uniform(0.3, 0.85)
        _rect(canvas, x, y, x + w, y + t, paper)


def _outdoors(
    rng: np.random.Generator, canvas: Floats, x0: float, y0: float, x1: float, y1: float
) -> None:
    """Trees and houses far behind a pane: soft, pale."""
    i0, j0 = max(round(x0), 0), max(round(y0), 0)
    part = canvas[j0 : max(round(y1), 0), i0 : max(round(x1), 0)]
    h, w = part.shape[:2]
    if h < 8 or w < 8:
        return
    view = part.copy()
    skyline = h * rng.uniform(0.45, 0.8)
    for _ in range(int(rng.integers(10, 24))):
        green = np.array([0.26, 0.33, 0.22]) * rng.uniform(0.4, 1.7)
        centre = (round(rng.uniform(0, w)), round(skyline + rng.uniform(-0.1, 0.4) * h))
        radius = max(round(rng.uniform(60, 260) * PX_PER_MM), 2)
        cv2.circle(view, centre, radius, green.tolist(), -1)
    for _ in range(int(rng.integers(0, 3))):
        x, wide = rng.uniform(-0.2, 1) * w, rng.uniform(0.2, 0.5) * w
        wall = random_hue(rng, 0.1) * rng.uniform(0.4, 0.9)
        _rect(view, x, skyline - rng.uniform(0, 0.2) * h, x + wide, h, wall)
    _rect(view, 0, h * 0.93, w, h, np.array([0.3, 0.33, 0.27]))
    part[:] = cv2.GaussianBlur(view, (0, 0), 26 * PX_PER_MM, borderType=cv2.BORDER_REPLICATE)


def _window(rng: np.random.Generator, canvas: Floats, x0: float, x1: float) -> None:
    h = canvas.shape[0]
    top, foot = h * 0.12, h - rng.uniform(800, 950) * PX_PER_MM
    frame = 55 * PX_PER_MM
    white = np.full(3, 0.72)
    _rect(canvas, x0, top, x1, foot, white)
    sky = np.array([0.82, 0.92, 1.05]) * _OUTSIDE_LIGHT
    n = int(rng.integers(1, 4))
    wide = (x1 - x0 - frame) / n
    for i in range(n):
        left = x0 + frame + i * wide
        pane = (left, top + frame, left + wide - frame, foot - frame)
        _rect(canvas, *pane, sky)
        _outdoors(rng, canvas, *pane)
    if rng.random() < 0.7:
        cloth = random_hue(rng, 0.35) * rng.uniform(0.2, 0.6)
        wide = 0.17 * (x1 - x0)
        for left in (x0 - 0.6 * wide, x1 - 0.4 * wide):
            for x in np.arange(left, left + wide, 8.0):
                fold = 0.7 + 0.3 * np.sin(x * 0.35) + 0.15 * rng.normal()
                _rect(canvas, x, top - 40, x + 8, foot + 180, cloth * max(fold, 0.3))
