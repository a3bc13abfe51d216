"""A small drawing of lines, boxes, dots and words, as SVG for a page or as pixels for a file."""

from __future__ import annotations

import html
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

INK = "#1d2733"
FAINT = "#c9d2dc"
PAPER = "#ffffff"
ACCENT = "#0b6fb8"
ALARM = "#c8442b"
#: Colours to tell cameras apart, also for the colour-blind (Okabe & Ito 2008).
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5c00", "#444444")
_OVERSAMPLING = 2


@dataclass(frozen=True)
class _Line:
    points: tuple[tuple[float, float], ...]
    colour: str
    width: float


@dataclass(frozen=True)
class _Polygon:
    points: tuple[tuple[float, float], ...]
    fill: str
    outline: str | None


@dataclass(frozen=True)
class _Dot:
    at: tuple[float, float]
    radius: float
    fill: str


@dataclass(frozen=True)
class _Words:
    at: tuple[float, float]
    text: str
    size: float
    anchor: str  # start, middle, end
    colour: str


@dataclass
class Drawing:
    """Shapes on a sheet, in the order in which they were drawn.

    Attributes
    ----------
    width, height : float, px
    """

    width: float
    height: float
    _shapes: list[_Line | _Polygon | _Dot | _Words] = field(default_factory=list)

    def line(self, *points: tuple[float, float], colour: str = INK, width: float = 1.0) -> None:
        """A line through points (x, y)."""
        self._shapes.append(_Line(tuple(points), colour, width))

    def polygon(
        self, *points: tuple[float, float], fill: str = PAPER, outline: str | None = None
    ) -> None:
        """A filled polygon."""
        self._shapes.append(_Polygon(tuple(points), fill, outline))

    def box(
        self, x: float, y: float, width: float, height: float, *,
        fill: str = PAPER, outline: str | None = None,
    ) -> None:  # fmt: skip
        """A filled rectangle by its upper left corner."""
        corners = (x, y), (x + width, y), (x + width, y + height), (x, y + height)
        self.polygon(*corners, fill=fill, outline=outline)

    def dot(self, x: float, y: float, radius: float, *, fill: str = INK) -> None:
        """A filled circle."""
        self._shapes.append(_Dot((x, y), radius, fill))

    def words(
        self, x: float, y: float, text: str, *,
        size: float = 11, anchor: str = "start", colour: str = INK,
    ) -> None:  # fmt: skip
        """A line of text; y is its base line. `anchor` is start, middle or end."""
        self._shapes.append(_Words((x, y), text, size, anchor, colour))

    def svg(self) -> str:
        """As an SVG element for a page."""
        parts = [_svg_of(shape) for shape in self._shapes]
        return (
            f'<svg viewBox="0 0 {self.width:g} {self.height:g}" width="{self.width:g}" '
            f'role="img" xmlns="http://www.w3.org/2000/svg">{"".join(parts)}</svg>'
        )

    def image(self) -> NDArray[np.uint8]:
        """As pixels, (height, width, 3) uint8 RGB, on white."""
        import numpy as np
        from PIL import Image, ImageDraw

        k = _OVERSAMPLING
        size = round(self.width), round(self.height)
        sheet = Image.new("RGB", (size[0] * k, size[1] * k), PAPER)
        pen = ImageDraw.Draw(sheet)
        for shape in self._shapes:
            _paint(pen, shape, k)
        return np.asarray(sheet.resize(size, Image.Resampling.BOX), dtype=np.uint8)


def stacked(drawings: list[Drawing]) -> Drawing:
    """Drawings one below the other on one sheet."""
    sheet = Drawing(max(d.width for d in drawings), sum(d.height for d in drawings))
    top = 0.0
    for drawing in drawings:
        sheet._shapes += [_moved(shape, top) for shape in drawing._shapes]
        top += drawing.height
    return sheet


def _moved(
    shape: _Line | _Polygon | _Dot | _Words, down: float
) -> _Line | _Polygon | _Dot | _Words:
    from dataclasses import replace

    if isinstance(shape, (_Line, _Polygon)):
        return replace(shape, points=tuple((x, y + down) for x, y in shape.points))
    return replace(shape, at=(shape.at[0], shape.at[1] + down))


def _pairs(points: tuple[tuple[float, float], ...]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _svg_of(shape: _Line | _Polygon | _Dot | _Words) -> str:
    match shape:
        case _Line(points, colour, width):
            return (
                f'<polyline points="{_pairs(points)}" fill="none" stroke="{colour}" '
                f'stroke-width="{width:g}"/>'
            )
        case _Polygon(points, fill, outline):
            edge = f' stroke="{outline}"' if outline else ""
            return f'<polygon points="{_pairs(points)}" fill="{fill}"{edge}/>'
        case _Dot((x, y), radius, fill):
            return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="{fill}"/>'
        case _Words((x, y), text, size, anchor, colour):
            return (
                f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="{anchor}" '
                f'fill="{colour}">{html.escape(text)}</text>'
            )


def _paint(pen: object, shape: _Line | _Polygon | _Dot | _Words, k: int) -> None:
    from PIL import ImageDraw, ImageFont

    assert isinstance(pen, ImageDraw.ImageDraw)
    match shape:
        case _Line(points, colour, width):
            scaled = [(x * k, y * k) for x, y in points]
            pen.line(scaled, fill=colour, width=max(1, round(width * k)), joint="curve")
        case _Polygon(points, fill, outline):
            pen.polygon([(x * k, y * k) for x, y in points], fill=fill, outline=outline, width=k)
        case _Dot((x, y), radius, fill):
            r = radius * k
            pen.ellipse((x * k - r, y * k - r, x * k + r, y * k + r), fill=fill)
        case _Words((x, y), text, size, anchor, colour):
            font = ImageFont.load_default(size * k)
            side = {"start": "l", "middle": "m", "end": "r"}[anchor]
            pen.text((x * k, y * k), text, fill=colour, font=font, anchor=f"{side}s")
