"""Calibration boards: what is printed on them, and where.

A board's own frame has x along its rows, y down its columns as one looks at it, z away from the
one who looks; millimetres. Points, and the order they are in, are those of OpenCV's detectors.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .arrays import readonly
from .errors import InputError

KINDS = ("chessboard", "circles", "charuco")
#: A dot's radius, of the distance to its nearest neighbour.
DOT_SHARE = 0.3
#: White around the squares or dots, of a square or spacing: detectors need some.
MARGIN_SHARE = 0.8
_MAX_COUNT = 200
_MAX_MM = 10_000.0
_EXAMPLES = (
    "chessboard:9x6:25, circles:7x6:20, circles:4x11:20:asymmetric "
    "or charuco:8x5:30:22:DICT_5X5_100"
)


@dataclass(frozen=True)
class Board:
    """A flat calibration target.

    Attributes
    ----------
    kind : str
        ``"chessboard"``, ``"circles"`` or ``"charuco"``.
    columns, rows : int
        Inner corners of a chessboard, dots, or squares of a ChArUco board.
    square_mm : float
        Side of a square; distance of dots. For asymmetric circles the distance of rows, which is
        half that of the dots of one row (as OpenCV counts).
    marker_mm : float or None
        Side of a ChArUco marker.
    dictionary : str or None
        OpenCV's name of the ChArUco markers, ``"DICT_5X5_100"``.
    legacy : bool
        ChArUco as OpenCV drew it before 4.6: with an even number of rows the upper left square is
        white.
    asymmetric : bool
        Every other row of circles is shifted by half a step.

    Raises
    ------
    InputError
        If that is no board; the message says why.
    """

    kind: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float | None = None
    dictionary: str | None = None
    legacy: bool = False
    asymmetric: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"a board is one of {', '.join(KINDS)}, not {self.kind}")
        if not (2 <= self.columns <= _MAX_COUNT and 2 <= self.rows <= _MAX_COUNT):
            raise InputError(
                f"a board has 2 to {_MAX_COUNT} columns and rows, got {self.columns}x{self.rows}"
            )
        if not 0 < self.square_mm <= _MAX_MM:
            raise InputError(
                f"squares must measure above 0 and up to {_MAX_MM:g} mm, got {self.square_mm:g}"
            )
        is_charuco = self.kind == "charuco"
        if is_charuco != (self.marker_mm is not None) or is_charuco != (
            self.dictionary is not None
        ):
            raise InputError("a charuco board, and no other, has a marker size and a dictionary")
        if self.marker_mm is not None and not 0 < self.marker_mm < self.square_mm:
            raise InputError(
                f"markers must be smaller than squares ({self.square_mm:g} mm), "
                f"got {self.marker_mm:g} mm"
            )
        if self.legacy and not is_charuco:
            raise InputError("only charuco boards have a legacy pattern")
        if self.asymmetric and self.kind != "circles":
            raise InputError("only boards of circles can be asymmetric")
        if is_charuco:
            n_markers, n_known = len(self._marker_squares), len(self._marker_bits)
            if n_markers > n_known:
                raise InputError(
                    f"a {self.columns}x{self.rows} charuco board needs {n_markers} markers; "
                    f"{self.dictionary} has {n_known}"
                )

    def __str__(self) -> str:
        """As `parse_board` reads it."""
        parts = [self.kind, f"{self.columns}x{self.rows}", f"{self.square_mm:.12g}"]
        if self.marker_mm is not None and self.dictionary is not None:
            parts += [f"{self.marker_mm:.12g}", self.dictionary]
        parts += ["legacy"] * self.legacy + ["asymmetric"] * self.asymmetric
        return ":".join(parts)

    @property
    def points_size(self) -> tuple[int, int]:
        """Columns and rows of the points: corners for ChArUco, which counts squares."""
        less = 1 if self.kind == "charuco" else 0
        return self.columns - less, self.rows - less

    def object_points(self) -> NDArray[np.float64]:
        """The points a detector finds, (N, 3) float64, mm, board frame, z = 0.

        Row by row. The origin is the first point, or a ChArUco board's upper left corner.
        """
        columns, rows = self.points_size
        row, column = np.mgrid[0:rows, 0:columns].reshape(2, -1).astype(np.float64)
        if self.kind == "charuco":
            row, column = row + 1, column + 1
        if self.asymmetric:
            column = 2 * column + row % 2
        return np.stack([column, row, np.zeros_like(row)], axis=1) * self.square_mm

    @property
    def dot_radius_mm(self) -> float:
        """Radius of the dots of a board of circles as we draw it."""
        nearest = self.square_mm * (math.sqrt(2) if self.asymmetric else 1)
        return DOT_SHARE * nearest

    @property
    def printed_box(self) -> NDArray[np.float64]:
        """x0, y0, x1, y1 of what is printed: the squares, or the dots. (4,) float64, mm."""
        points = self.object_points()[:, :2]
        low, high = points.min(axis=0), points.max(axis=0)
        reach = self.dot_radius_mm if self.kind == "circles" else self.square_mm
        return np.concatenate([low - reach, high + reach])

    @property
    def sheet_box(self) -> NDArray[np.float64]:
        """x0, y0, x1, y1 of the white sheet, (4,) float64, mm."""
        margin = MARGIN_SHARE * self.square_mm
        return self.printed_box + margin * np.array([-1, -1, 1, 1])

    @cached_property
    def cells(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """What is black, exactly: a chessboard or ChArUco sheet as rectangles.

        Returns
        -------
        x_edges : (n + 1,) float64, mm, growing
        y_edges : (m + 1,) float64, mm, growing
            Together they cover the sheet and no more.
        is_black : (m, n) bool

        Raises
        ------
        ValueError
            For a board of circles, which is `object_points` with `dot_radius_mm`.
        """
        if self.kind == "circles":
            raise ValueError("a board of circles has dots and no cells")
        black = self._black_boxes()
        sheet = self.sheet_box
        x_edges = _distinct(np.concatenate([sheet[[0, 2]], black[:, 0], black[:, 2]]))
        y_edges = _distinct(np.concatenate([sheet[[1, 3]], black[:, 1], black[:, 3]]))
        is_black = np.zeros((len(y_edges) - 1, len(x_edges) - 1), bool)
        for x0, y0, x1, y1 in black:
            columns = slice(_index(x_edges, x0), _index(x_edges, x1))
            is_black[_index(y_edges, y0) : _index(y_edges, y1), columns] = True
        return (
            readonly(x_edges, (None,), "x_edges"),
            readonly(y_edges, (None,), "y_edges"),
            readonly(is_black, (None, None), "is_black", np.bool_),
        )

    def is_black(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether there is ink at places of the board, (..., 2) float mm → (...) bool."""
        p = np.asarray(points, dtype=np.float64)
        if p.shape[-1:] != (2,):
            raise ValueError(f"points must have shape (..., 2), got {p.shape}")
        if self.kind == "circles":
            from scipy.spatial import cKDTree

            distance, _ = cKDTree(self.object_points()[:, :2]).query(p)
            return np.asarray(distance < self.dot_radius_mm)
        x_edges, y_edges, black = self.cells
        column = np.searchsorted(x_edges, p[..., 0], side="right") - 1
        row = np.searchsorted(y_edges, p[..., 1], side="right") - 1
        on_sheet = (column >= 0) & (column < black.shape[1]) & (row >= 0) & (row < black.shape[0])
        found = black[row.clip(0, black.shape[0] - 1), column.clip(0, black.shape[1] - 1)]
        return np.asarray(found & on_sheet)

    def _black_boxes(self) -> NDArray[np.float64]:
        """x0, y0, x1, y1 of black rectangles, (n, 4) mm, which do not overlap."""
        x0, y0, x1, y1 = self.printed_box
        columns, rows = round((x1 - x0) / self.square_mm), round((y1 - y0) / self.square_mm)
        row, column = np.mgrid[0:rows, 0:columns].reshape(2, -1)
        dark = (row + column) % 2 == (1 if self._is_upper_left_white else 0)
        corner = np.stack([column[dark], row[dark]], axis=1) * self.square_mm + (x0, y0)
        boxes = [np.hstack([corner, corner + self.square_mm])]
        if self.marker_mm is not None:
            boxes += [
                self._marker_boxes(int(c), int(r), bits)
                for (c, r), bits in zip(self._marker_squares, self._marker_bits, strict=False)
            ]
        return np.concatenate(boxes)

    @property
    def _is_upper_left_white(self) -> bool:
        return self.legacy and self.rows % 2 == 0

    @cached_property
    def _marker_squares(self) -> NDArray[np.intp]:
        """Column and row of the white squares, (n, 2), in the order of marker ids."""
        row, column = np.mgrid[0 : self.rows, 0 : self.columns].reshape(2, -1)
        light = (row + column) % 2 == (0 if self._is_upper_left_white else 1)
        return np.stack([column[light], row[light]], axis=1)

    @cached_property
    def _marker_bits(self) -> NDArray[np.bool_]:
        """Black cells of the dictionary's markers with their frames, (n, b + 2, b + 2)."""
        from cv2 import aruco

        code = getattr(aruco, str(self.dictionary), None)
        if not str(self.dictionary).startswith("DICT_") or not isinstance(code, int):
            raise InputError(
                f"unknown charuco dictionary {self.dictionary} (expected one like DICT_5X5_100)"
            )
        known = aruco.getPredefinedDictionary(code)
        n, size = len(known.bytesList), known.markerSize
        marks = [known.generateImageMarker(i, size + 2, borderBits=1) for i in range(n)]
        return np.array(marks) < 128

    def _marker_boxes(self, column: int, row: int, black: NDArray[np.bool_]) -> NDArray[np.float64]:
        assert self.marker_mm is not None
        bit = self.marker_mm / len(black)
        inset = (self.square_mm - self.marker_mm) / 2
        y, x = np.nonzero(black)
        corner = np.stack([column * self.square_mm + inset, row * self.square_mm + inset])
        low = corner + np.stack([x, y], axis=1) * bit
        high = corner + np.stack([x + 1, y + 1], axis=1) * bit
        return np.hstack([low, high])


def parse_board(text: str) -> Board:
    """The board that a text names.

    ``chessboard:COLSxROWS:MM`` and ``circles:COLSxROWS:MM[:asymmetric]`` count inner corners and
    dots; ``charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY[:legacy]`` counts squares.

    Raises
    ------
    InputError
        ``board "chessboard:9x6": expected chessboard:COLSxROWS:MM, ...``
    """
    kind, *rest = text.strip().split(":")
    forms = {
        "chessboard": "chessboard:COLSxROWS:MM",
        "circles": "circles:COLSxROWS:MM[:asymmetric]",
        "charuco": "charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY[:legacy]",
    }
    if kind not in forms:
        raise InputError(f'board "{text}": expected a board like {_EXAMPLES}')
    wanted = InputError(f'board "{text}": expected {forms[kind]}, for example {_EXAMPLES}')
    n_numbers = 4 if kind == "charuco" else 2
    size = re.fullmatch(r"(\d{1,4})x(\d{1,4})", rest[0]) if rest else None
    flag = {"circles": "asymmetric", "charuco": "legacy"}.get(kind)
    flags = rest[n_numbers:]
    if size is None or len(rest) < n_numbers or flags not in ([], [flag]):
        raise wanted
    lengths = [_length(part) for part in rest[1 : 3 if kind == "charuco" else 2]]
    if None in lengths:
        raise wanted
    marker_mm = lengths[1] if kind == "charuco" else None
    try:
        return Board(
            kind,
            int(size[1]),
            int(size[2]),
            float(lengths[0] or 0),
            marker_mm,
            rest[3] if kind == "charuco" else None,
            legacy="legacy" in flags,
            asymmetric="asymmetric" in flags,
        )
    except InputError as error:
        raise InputError(f'board "{text}": {error}') from error


def _length(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _distinct(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Growing values, those that differ by rounding only given once."""
    ordered = np.sort(values)
    is_new = np.diff(ordered, prepend=-np.inf) > 1e-9 * max(1.0, float(ordered[-1]))
    return np.asarray(ordered[is_new])


def _index(edges: NDArray[np.float64], value: float) -> int:
    return int(np.abs(edges - value).argmin())
