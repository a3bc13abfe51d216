"""Points whose displacements follow from those of others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.arrays import readonly
from ..core.mesh import SurfacePoints
from .auxiliary_points import AuxiliaryModel

Floats = NDArray[np.float64]
#: Smaller factors are dropped, a tenth of a millimetre for a motion of 10 mm: exported shapes then
#: touch a third fewer vertices.
NEGLIGIBLE_FACTOR = 0.01


@dataclass(frozen=True, eq=False)
class Followers:
    """Components of points' displacements that follow linearly from other components.

    Component ``3 n + axis`` is the axis of point n.

    Attributes
    ----------
    rows : (F,) int64
        Components that follow.
    sources : (S,) int64
        Components that they follow; none of `rows`.
    factors : (F, S) float64
    """

    rows: NDArray[np.int64]
    sources: NDArray[np.int64]
    factors: Floats

    def __post_init__(self) -> None:
        for name in ("rows", "sources"):
            value = readonly(getattr(self, name), (None,), name, np.int64)
            object.__setattr__(self, name, value)
        shape = (len(self.rows), len(self.sources))
        object.__setattr__(self, "factors", readonly(self.factors, shape, "factors"))
        if np.isin(self.rows, self.sources).any():
            raise ValueError("a component cannot both follow and be followed")

    @classmethod
    def of(cls, model: AuxiliaryModel, points: SurfacePoints) -> Followers:
        """What the model says of those of its points that are there."""
        inputs, outputs, factors = model.regression(points.names, points.names)
        index = {name: 3 * i for i, name in enumerate(points.names)}
        rows = np.array([index[name] + axis for name, axis in outputs], np.int64)
        sources = np.array([index[name] + axis for name, axis in inputs], np.int64)
        return cls(rows, sources, np.where(np.abs(factors) < NEGLIGIBLE_FACTOR, 0.0, factors))

    def follow(self, displacements: Floats) -> Floats:
        """Displacements with what follows from them added.

        Parameters
        ----------
        displacements : (T, N, 3) float64, mm
            Of followers: what they move besides.

        Returns
        -------
        (T, N, 3) float64, mm
        """
        flat = displacements.reshape(len(displacements), -1).copy()
        flat[:, self.rows] += flat[:, self.sources] @ self.factors.T
        return flat.reshape(displacements.shape)

    def matrix(self, n_points: int) -> sparse.csr_matrix:
        """`follow` as a matrix, (3 N, 3 N)."""
        rows = np.repeat(self.rows, len(self.sources))
        columns = np.tile(self.sources, len(self.rows))
        size = (3 * n_points, 3 * n_points)
        following = sparse.csr_matrix((self.factors.ravel(), (rows, columns)), size)
        following.eliminate_zeros()
        return (sparse.identity(3 * n_points) + following).tocsr()
