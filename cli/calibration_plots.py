"""Pictures of a calibration: residuals, coverage, uncertainty, cameras in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..core.rig import Rig
from ..core.rigid import Rigid
from .drawing import ACCENT, ALARM, FAINT, INK, PAPER, SERIES, Drawing

if TYPE_CHECKING:
    from ..capture.rig_face import PlaneUncertainty

Floats = NDArray[np.float64]
_WIDTH = 620.0
_MARGIN = 12.0
_HEAD, _FOOT = 24.0, 22.0
_MOST_ARROWS = 3000
#: From sure to unsure: light to dark, one hue to another, readable without colour too.
_MAP = ((255, 247, 217), (249, 196, 107), (226, 110, 70), (140, 35, 90), (45, 10, 60))


class _Frame:
    """A picture's rectangle in a drawing."""

    def __init__(self, title: str, image_size: tuple[int, int]) -> None:
        w, h = image_size
        self.scale = (_WIDTH - 2 * _MARGIN) / w
        self.size = w * self.scale, h * self.scale
        self.drawing = Drawing(_WIDTH, self.size[1] + _HEAD + _FOOT)
        self.drawing.words(_MARGIN, _HEAD - 8, title, size=13)
        self.drawing.box(_MARGIN, _HEAD, *self.size, fill="#f6f8fa", outline=FAINT)

    def at(self, pixel: Floats) -> tuple[float, float]:
        x, y = (np.asarray(pixel) + 0.5) * self.scale + (_MARGIN, _HEAD)
        return float(x), float(y)

    def foot(self, text: str) -> None:
        self.drawing.words(_MARGIN, _HEAD + self.size[1] + 15, text, size=11)


def residual_field(
    title: str, image_size: tuple[int, int], pixels: Floats, residuals: Floats
) -> Drawing:
    """Residuals as lines from the points, over the picture.

    A good calibration shows hair in every direction; a pattern (all outwards, a whirl, one corner)
    shows what the model does not explain.

    Parameters
    ----------
    title : str
    image_size : (width, height), px
    pixels, residuals : (N, 2) float, px
        Where the points were seen, and seen minus projected.
    """
    frame = _Frame(title, image_size)
    rms = float(np.sqrt((residuals**2).sum(axis=1).mean()))
    longest = 0.04 * image_size[0]
    zoom = _round_down(longest / max(2 * rms, 1e-9))
    step = max(1, len(pixels) // _MOST_ARROWS)
    large = 3 * rms
    for pixel, residual in zip(pixels[::step], residuals[::step], strict=True):
        size = float(np.linalg.norm(residual))
        colour = ALARM if size > large else ACCENT
        end = pixel + residual * min(zoom, 2 * longest / max(size, 1e-12))
        frame.drawing.line(frame.at(pixel), frame.at(end), colour=colour, width=0.9)
        frame.drawing.dot(*frame.at(pixel), 1.0, fill=INK)
    told = f"{len(pixels)} points; lines {zoom:g}x enlarged; red: above 3 times the RMS"
    frame.foot(f"RMS {rms:.3g} px; {told}")
    return frame.drawing


def uncertainty_map(
    title: str, image_size: tuple[int, int], mm: Floats, pixels: Floats, what: str
) -> Drawing:
    """A grid of uncertainties over the picture, with the points that it stands on.

    Parameters
    ----------
    title : str
    image_size : (width, height), px
    mm : (rows, columns) float
        NaN where it is not known.
    pixels : (N, 2) float, px
        Where points were seen.
    what : str
        Says of what it is the uncertainty.
    """
    frame = _Frame(title, image_size)
    low, high = _cells(frame.drawing, mm, (_MARGIN, _HEAD), frame.size)
    for pixel in pixels[:: max(1, len(pixels) // _MOST_ARROWS)]:
        frame.drawing.dot(*frame.at(pixel), 1.0, fill="#5c6b7a")
    _cell_words(frame.drawing, mm, (_MARGIN, _HEAD), frame.size)
    frame.foot(f"{what}, mm: {low:.2g} to {high:.2g}; dots: where points were seen")
    return frame.drawing


def uncertainty_plane(title: str, plane: PlaneUncertainty, face_mm: tuple[float, float]) -> Drawing:
    """What the calibration and a spot's noise amount to over a plane, side by side.

    Parameters
    ----------
    title : str
    plane : PlaneUncertainty
    face_mm : (width, height)
        An ellipse of this size is drawn in the middle: the face that errors are told relative to.
    """
    across, up = _reach(plane.x_mm), _reach(plane.y_mm)
    size = 300.0, 300.0 * up / across
    drawing = Drawing(2 * size[0] + 3 * _MARGIN, size[1] + 2 * _HEAD + _FOOT + 14)
    drawing.words(_MARGIN, _HEAD - 8, title, size=13)
    top = 2 * _HEAD - 6
    panels = (("the calibration: the same in every frame", plane.calibration_mm),
              ("a spot's noise: anew in every frame", plane.noise_mm))  # fmt: skip
    turn = np.linspace(0, 2 * np.pi, 73)
    for i, (what, mm) in enumerate(panels):
        left = _MARGIN + i * (size[0] + _MARGIN)
        low, high = _cells(drawing, mm, (left, top), size)
        _cell_words(drawing, mm, (left, top), size)
        x = left + size[0] * (0.5 + face_mm[0] / (2 * across) * np.cos(turn))
        y = top + size[1] * (0.5 + face_mm[1] / (2 * up) * np.sin(turn))
        ring = list(zip(x.tolist(), y.tolist(), strict=True))
        drawing.line(*ring, colour=PAPER, width=2.6)
        drawing.line(*ring, colour=INK, width=1.0)
        told = f"{what}, mm: {low:.2g} to {high:.2g}" if high > 0 else "fewer than two cameras see"
        drawing.words(left, top - 5, told, size=11)
    bar = _round_down(across / 3) / across * size[0]
    y_bar = top + size[1] + 14
    drawing.line((_MARGIN, y_bar), (_MARGIN + bar, y_bar), width=2.0)
    fewest, most = int(plane.n_cameras.min()), int(plane.n_cameras.max())
    seen = f"{most}" if fewest == most else f"{fewest} to {most}"
    told = f"{_round_down(across / 3):g} mm; seen by {seen} cameras; the ring is the face"
    drawing.words(_MARGIN + bar + 8, y_bar + 4, told, size=11)
    return drawing


def _reach(middles: Floats) -> float:
    """From edge to edge of cells with these middles."""
    return float(np.ptp(middles)) * len(middles) / max(len(middles) - 1, 1)


def _cells(
    drawing: Drawing, mm: Floats, corner: tuple[float, float], size: tuple[float, float]
) -> tuple[float, float]:
    """Colour a grid of uncertainties; the least and the largest, 0 and 0 where none is known."""
    rows, columns = mm.shape
    known = mm[np.isfinite(mm)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    w, h = size[0] / columns, size[1] / rows
    for (row, column), value in np.ndenumerate(mm):
        fill = _colour(_share(float(value), low, high)) if np.isfinite(value) else "#ffffff"
        # a little wider: no gaps between neighbours; the last ones end at the edge
        more_x, more_y = 0.4 * (column + 1 < columns), 0.4 * (row + 1 < rows)
        x, y = corner[0] + column * w, corner[1] + row * h
        drawing.box(x, y, w + more_x, h + more_y, fill=fill)
    return low, high


def _cell_words(
    drawing: Drawing, mm: Floats, corner: tuple[float, float], size: tuple[float, float]
) -> None:
    """The number of every other cell."""
    rows, columns = mm.shape
    known = mm[np.isfinite(mm)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    for row in range(1, rows, 2):
        for column in range(1, columns, 2):
            value = float(mm[row, column])
            text = f"{value:.2g}" if np.isfinite(value) else "?"
            x = corner[0] + (column + 0.5) * size[0] / columns
            y = corner[1] + (row + 0.5) * size[1] / rows + 4
            dark = np.isfinite(value) and _share(value, low, high) > 0.55
            colour = PAPER if dark else INK
            drawing.words(x, y, text, size=10, anchor="middle", colour=colour)


def bars(title: str, values: Sequence[tuple[str, float]], unit: str) -> Drawing:
    """A bar a view, in order; the median as a line."""
    shown = list(values)
    height, row = 150.0, max(2.0, min(18.0, (_WIDTH - 2 * _MARGIN - 40) / max(len(shown), 1)))
    drawing = Drawing(_WIDTH, height + _HEAD + 70)
    drawing.words(_MARGIN, _HEAD - 8, title, size=13)
    top = max((v for _, v in shown), default=1.0) or 1.0
    left, base = _MARGIN + 40, _HEAD + height
    middle = float(np.median([v for _, v in shown])) if shown else 0.0
    for share in (0.0, 0.5, 1.0):
        y = base - share * height * 0.95
        drawing.line((left, y), (_WIDTH - _MARGIN, y), colour=FAINT)
        drawing.words(left - 4, y + 4, f"{share * top:.2g}", size=10, anchor="end")
    every = max(1, int(np.ceil(14 / row)))
    for i, (name, value) in enumerate(shown):
        x, tall = left + i * row, value / top * height * 0.95
        colour = ALARM if value > 2 * middle else ACCENT
        drawing.box(x + 0.15 * row, base - tall, 0.7 * row, tall, fill=colour)
        if i % every == 0:
            short = name if len(name) <= 9 else f"…{name[-8:]}"
            drawing.words(x + row / 2, base + 14 + 12 * ((i // every) % 4), short, size=9,
                          anchor="middle")  # fmt: skip
    y = base - middle / top * height * 0.95
    drawing.line((left, y), (_WIDTH - _MARGIN, y), colour=INK, width=0.8)
    drawing.words(_WIDTH - _MARGIN, y - 3, f"median {middle:.2g} {unit}", size=10, anchor="end")
    return drawing


def cameras_in_space(
    title: str, rig: Rig, targets: Mapping[str, Rigid], target_points: Floats
) -> Drawing:
    """Cameras and targets from above, from the side and from an oblique place.

    Parameters
    ----------
    title : str
    rig : Rig
    targets : mapping from view to Rigid
        World from target.
    target_points : (N, 3) float, mm, target frame
        Its corners are drawn.
    """
    world = _level(rig)
    places = {n: world.apply(rig[n].position) for n in rig}
    low, high = target_points.min(axis=0), target_points.max(axis=0)
    corners = np.array([low, [high[0], low[1], low[2]], high, [low[0], high[1], high[2]]])
    boards = [world.apply(pose.apply(corners)) for pose in targets.values()]
    everything = np.concatenate([np.array(list(places.values())), *boards])
    # the size of a drawn camera: a tenth of the scene
    depth_mm = 0.1 * float(np.ptp(everything, axis=0).max())
    outlines = {n: world.apply(_outline(rig, n, depth_mm)) for n in rig}
    everything = np.concatenate([everything, *outlines.values()])
    panels = (
        ("from above", np.array([[1.0, 0, 0], [0, 0, -1.0]])),
        ("from the side", np.array([[0, 0, 1.0], [0, 1.0, 0]])),
        ("oblique", _oblique()),
    )
    size = 300.0
    drawing = Drawing(3 * size + 4 * _MARGIN, size + _HEAD + _FOOT + 14)
    drawing.words(_MARGIN, _HEAD - 8, title, size=13)
    span = max(float(np.ptp(everything @ axes.T, axis=0).max()) for _, axes in panels)
    scale = 0.86 * size / max(span, 1e-9)
    for i, (name, axes) in enumerate(panels):
        left = _MARGIN + i * (size + _MARGIN)
        flat = everything @ axes.T
        middle = (flat.min(axis=0) + flat.max(axis=0)) / 2
        drawing.box(left, _HEAD, size, size, fill="#f6f8fa", outline=FAINT)

        def at(
            points: Floats, axes: Floats = axes, middle: Floats = middle, left: float = left
        ) -> list[tuple[float, float]]:
            p = (np.atleast_2d(points) @ axes.T - middle) * scale
            return [(float(x + left + size / 2), float(y + _HEAD + size / 2)) for x, y in p]

        for board in boards[:: max(1, len(boards) // 40)]:
            ring = at(board)
            drawing.line(*ring, ring[0], colour="#9aa7b4", width=0.7)
        for k, camera in enumerate(rig):
            colour = SERIES[k % len(SERIES)]
            apex, *rim = at(outlines[camera])
            drawing.line(*rim, rim[0], colour=colour, width=1.2)
            for corner in rim:
                drawing.line(apex, corner, colour=colour, width=1.0)
            drawing.words(apex[0], apex[1] - 5, camera, size=11, anchor="middle", colour=colour)
        drawing.words(left + 6, _HEAD + size - 8, name, size=11)
    bar_mm = _round_down(span / 3)
    y = _HEAD + size + 16
    drawing.line((_MARGIN, y), (_MARGIN + bar_mm * scale, y), width=2.0)
    drawing.words(_MARGIN + bar_mm * scale + 8, y + 4, f"{bar_mm:g} mm", size=11)
    return drawing


def _level(rig: Rig) -> Rigid:
    """To a frame to look at it in: x right, y down, z forward, by the mean of the cameras."""
    down = np.mean([c.camera_from_world.rotation[1] for c in rig.cameras.values()], axis=0)
    forward = np.mean([c.camera_from_world.rotation[2] for c in rig.cameras.values()], axis=0)
    if np.linalg.norm(down) < 1e-6 or np.linalg.norm(np.cross(down, forward)) < 1e-6:
        return Rigid.identity()  # cameras all around: any frame serves
    y = down / np.linalg.norm(down)
    x = np.cross(y, forward)
    x /= np.linalg.norm(x)
    return Rigid.from_rotation(np.stack([x, y, np.cross(x, y)]))


def _outline(rig: Rig, name: str, depth_mm: float) -> Floats:
    """The centre and the four corners of what a camera sees at a depth, (5, 3), world."""
    camera = rig[name]
    w, h = camera.image_size
    K = camera.matrix
    rim = [[(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], 1.0]
           for x, y in ((0, 0), (w, 0), (w, h), (0, h))]  # fmt: skip
    corners = np.array([[0.0, 0.0, 0.0], *rim]) * depth_mm
    return camera.camera_from_world.inverse().apply(corners)


def _oblique() -> Floats:
    """Two axes of a sheet seen from the right and above."""
    yaw, pitch = np.deg2rad(35), np.deg2rad(25)
    right = np.array([np.cos(yaw), 0, np.sin(yaw)])
    away = np.array([-np.sin(yaw), 0, np.cos(yaw)])
    down = np.cos(pitch) * np.array([0, 1.0, 0]) - np.sin(pitch) * away
    return np.stack([right, down])


def _share(value: float, low: float, high: float) -> float:
    """Place between low and high, by ratios: uncertainties grow many times over."""
    if high <= low * 1.0001 or low <= 0:
        return 0.0
    return float(np.log(value / low) / np.log(max(high / low, 3.0)))


def _colour(share: float) -> str:
    at = min(max(share, 0.0), 1.0) * (len(_MAP) - 1)
    i = min(int(at), len(_MAP) - 2)
    mixed = [round(a + (b - a) * (at - i)) for a, b in zip(_MAP[i], _MAP[i + 1], strict=True)]
    return "#{:02x}{:02x}{:02x}".format(*mixed)


def _round_down(value: float) -> float:
    """1, 2 or 5 times a power of ten, not above a value."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    return float(max(m for m in (1, 2, 5) if m * power <= value * (1 + 1e-9)) * power)
