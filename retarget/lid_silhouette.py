"""Where the edge of a lid is seen, by rays from the front."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import gaussian_filter1d
from scipy.sparse.csgraph import dijkstra

from ..heads.raycast import RayScene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_AROUND_MM, _STEP_MM = 1.6, 0.04
_SMOOTH_MM = 0.25
#: What is seen further off is another part of the lid, as happens in corners.
_TRUST_MM = 0.7
_FAR_MM = 500.0


class LidSilhouette:
    """The visible edge of one lid, with nothing before it but itself.

    Parameters
    ----------
    lid, eyeball : (F, 3) int32
        Triangles.
    columns : (C,) float64, mm
        Places x, evenly spaced.
    is_upper : bool
        Whether the edge is the lid's lower end.
    """

    def __init__(
        self, lid: NDArray[np.int32], eyeball: NDArray[np.int32], columns: Floats, is_upper: bool
    ) -> None:
        self._lid_count = len(lid)
        self._triangles = np.concatenate([lid, eyeball])
        self._columns, self._is_upper = columns, is_upper

    def misses(self, vertices: Floats, wanted: Floats) -> Floats:
        """How far above the wanted heights the edge is seen, smoothed, (C,) mm.

        Parameters
        ----------
        vertices : (V, 3) float64, mm
        wanted : (C,) float64, mm
            NaN where nothing is wanted.

        Where nothing is wanted or no edge is seen, the miss is that of the columns beside.
        """
        offsets = np.arange(-_AROUND_MM, _AROUND_MM, _STEP_MM)
        ys = np.nan_to_num(wanted)[:, None] + offsets
        x = np.repeat(self._columns[:, None], len(offsets), axis=1)
        start = np.stack([x.ravel(), ys.ravel(), np.full(x.size, _FAR_MM)], axis=1)
        ahead = np.tile([0.0, 0.0, -1.0], (len(start), 1))
        _, hit, _ = RayScene(vertices, self._triangles).cast(start, ahead)
        seen = (hit < self._lid_count).reshape(ys.shape)
        if self._is_upper:
            found = offsets[np.argmax(seen, axis=1)] - _STEP_MM / 2
        else:
            found = offsets[len(offsets) - 1 - np.argmax(seen[:, ::-1], axis=1)] + _STEP_MM / 2
        is_edge = seen.any(axis=1) & (np.abs(found) < _TRUST_MM) & ~np.isnan(wanted)
        return self._smooth(found, is_edge)

    def _smooth(self, found: Floats, is_edge: NDArray[np.bool_]) -> Floats:
        """Values smoothed over the columns in which an edge is seen; 0 where none is near."""
        if not is_edge.any():
            return np.zeros_like(found)
        at = self._columns
        found = np.interp(at, at[is_edge], found[is_edge])
        width = _SMOOTH_MM / float(at[1] - at[0])
        return np.asarray(gaussian_filter1d(found, width, mode="nearest"))


def lid_triangles(
    v: Floats,
    skin: NDArray[np.int32],
    near: Ints,
    graph: sparse.csr_matrix,
    upper: Ints,
    lower: Ints,
) -> dict[bool, NDArray[np.int32]]:
    """Triangles of the upper (True) and of the lower lid: those nearer to its edge.

    Parameters
    ----------
    v : (V, 3) float64, mm
    skin : (F, 3) int32
    near : (K,) int64
        Vertices that are looked at.
    graph : (K, K) sparse
        Lengths of the edges between them.
    upper, lower : (n,) int64
        Edges of the lids, as indices into `near`.
    """
    away = [dijkstra(graph, indices=edge, min_only=True) for edge in (upper, lower)]
    found = {}
    for is_upper, (own, other) in ((True, away), (False, away[::-1])):
        nearer = np.zeros(len(v), dtype=bool)
        nearer[near[own < other]] = True
        found[is_upper] = skin[nearer[skin].all(axis=1)]
    return found
