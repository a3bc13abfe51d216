"""Edge loops of the template's skin: rings about the eyes and the mouth."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from .template import load_template
from .template_from_anny import PART_NAMES

Ints = NDArray[np.int64]


class SkinQuads:
    """The quads of the template's skin, and walks along their edges."""

    def __init__(self) -> None:
        template = load_template()
        t = template.triangles
        quads = np.stack([t[0::2, 0], t[0::2, 1], t[0::2, 2], t[1::2, 2]], axis=1)
        self.quads = quads[template.part_of_triangle[::2] == PART_NAMES.index("skin")]
        self._n = len(template.vertices)
        self._neighbours: dict[int, set[int]] = {}
        self._quads_of: dict[int, set[int]] = {}
        for i, quad in enumerate(self.quads.tolist()):
            for k in range(4):
                self._neighbours.setdefault(quad[k], set()).update((quad[k - 1], quad[(k + 1) % 4]))
                self._quads_of.setdefault(quad[k], set()).add(i)

    def neighbours(self, vertex: int) -> list[int]:
        """Vertices at the other ends of a vertex's edges, in ascending order."""
        return sorted(self._neighbours[vertex])

    def _across(self, a: int, b: int) -> list[int]:
        """Neighbours of b that share no quad with the edge from a to b."""
        beside = {
            int(v) for q in self._quads_of[a] & self._quads_of[b] for v in self.quads[q].tolist()
        }
        return [v for v in self.neighbours(b) if v not in beside]

    def closed_loop(self, first: int, second: int) -> Ints | None:
        """The edge loop that goes straight on through every vertex; None if it does not close."""
        found = [first, second]
        while True:
            a, b = found[-2:]
            onward = self._across(a, b) if len(self._neighbours[b]) == 4 else []
            if len(onward) != 1:
                return None
            if onward[0] == first:
                return np.array(found, dtype=np.int64)
            if onward[0] in found:
                return None
            found.append(onward[0])

    def beside_loop(self, loop: Ints, inner: int) -> tuple[NDArray[np.float64], Ints]:
        """Steps from a loop, negative on the side of the vertex `inner`; nearest place on it.

        Returns
        -------
        (V,) float64
            inf off the skin.
        (V,) int64
            Index into `loop`, −1 off the skin.
        """
        q = self.quads
        e = np.concatenate([q[:, [0, 1]], q[:, [1, 2]], q[:, [2, 3]], q[:, [3, 0]]])
        links = sparse.csr_matrix((np.ones(len(e)), (e[:, 0], e[:, 1])), (self._n, self._n))
        steps, _, source = dijkstra(
            links,
            directed=False,
            indices=loop,
            unweighted=True,
            min_only=True,
            return_predecessors=True,
        )
        on_loop = np.isin(e, loop).any(axis=1)
        cut = sparse.csr_matrix(
            (np.ones((~on_loop).sum()), (e[~on_loop, 0], e[~on_loop, 1])), (self._n, self._n)
        )
        _, label = connected_components(cut, directed=False)
        steps = np.where(label == label[inner], -steps, steps)
        place = np.full(self._n, -1, dtype=np.int64)
        position = {int(v): i for i, v in enumerate(loop)}
        known = np.flatnonzero(source >= 0)
        place[known] = [position[int(s)] for s in source[known]]
        return steps, place


@cache
def skin_quads() -> SkinQuads:
    """The template's."""
    return SkinQuads()
