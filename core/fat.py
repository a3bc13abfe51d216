"""Facial animation tables: what each FAP alone does to a mesh, piecewise linear in its value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import readonly
from .mpeg4 import fap_by_name


@dataclass(frozen=True, eq=False)
class FapTable:
    """What one FAP does: displacements at some of its values, linear between, held beyond.

    Attributes
    ----------
    fap : str
    knots : (K,) float64, table units
        Strictly increasing, 0 among them.
    vertices : (n,) int32
        Which vertices it moves; strictly increasing.
    offsets : (K, n, 3) float32, mm
        Their displacements at the knots; 0 at 0.
    """

    fap: str
    knots: NDArray[np.float64]
    vertices: NDArray[np.int32]
    offsets: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.fap not in fap_by_name():
            raise ValueError(f"no FAP {self.fap!r}")
        knots = readonly(self.knots, (None,), "knots")
        vertices = readonly(self.vertices, (None,), "vertices", np.int32)
        wanted = (len(knots), len(vertices), 3)
        offsets = readonly(self.offsets, wanted, "offsets", np.float32)
        if not np.isfinite(knots).all() or (np.diff(knots) <= 0).any():
            raise ValueError(f"knots of {self.fap} must increase")
        if (np.diff(vertices) <= 0).any() or (len(vertices) and vertices[0] < 0):
            raise ValueError(f"vertices of {self.fap} must increase from 0 or more")
        if not np.isfinite(offsets).all():
            raise ValueError(f"offsets of {self.fap} must be finite")
        rest = np.flatnonzero(knots == 0.0)
        if not len(rest) or offsets[rest[0]].any():
            raise ValueError(f"{self.fap} must have a knot at 0, where nothing moves")
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "offsets", offsets)

    @property
    def n_intervals(self) -> int:
        """How many straight pieces it has."""
        return len(self.knots) - 1

    def weights(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """How much each knot counts at values (...,), (..., K); 1 in sum."""
        return np.stack(
            [np.interp(values, self.knots, unit) for unit in np.eye(len(self.knots))], -1
        )

    def at(self, value: float) -> NDArray[np.float64]:
        """Displacements of `vertices` at a value of the FAP, (n, 3) float64 mm."""
        counts = self.weights(np.array(value, dtype=np.float64))
        return np.asarray(np.einsum("k,kna->na", counts, self.offsets.astype(np.float64)))


@dataclass(frozen=True, eq=False)
class FacialTables:
    """The tables of all FAPs that move a mesh.

    Attributes
    ----------
    rest : (V, 3) float32, mm, head frame
        The neutral face that they belong to.
    max_error_mm : float
        How far the pieces may be from what they were made of, in one FAP.
    tables : tuple of FapTable
    """

    rest: NDArray[np.float32]
    max_error_mm: float
    tables: tuple[FapTable, ...]

    def __post_init__(self) -> None:
        rest = readonly(self.rest, (None, 3), "rest", np.float32)
        if not np.isfinite(rest).all():
            raise ValueError("rest must be finite")
        if not (np.isfinite(self.max_error_mm) and self.max_error_mm > 0):
            raise ValueError(f"max_error_mm must be above 0, got {self.max_error_mm}")
        names = [t.fap for t in self.tables]
        if len(set(names)) != len(names):
            raise ValueError("each FAP has one table")
        for table in self.tables:
            if len(table.vertices) and table.vertices[-1] >= len(rest):
                raise ValueError(
                    f"{table.fap} moves vertex {table.vertices[-1]} of a mesh of {len(rest)}"
                )
        object.__setattr__(self, "rest", rest)
        object.__setattr__(self, "tables", tuple(self.tables))

    def of(self, fap: str) -> FapTable | None:
        """The table of one FAP; None if it moves nothing."""
        return next((t for t in self.tables if t.fap == fap), None)
