"""The binary chunk of a .glb file that is written: its views and accessors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pygltflib as gltf
from numpy.typing import NDArray

_U16_LIMIT = 65535  # this index itself would restart the primitive (glTF 2.0, 3.7.2.1)


class Packer:
    """Collects the binary chunk, its views and accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[gltf.BufferView] = []
        self.accessors: list[gltf.Accessor] = []

    def view(self, data: bytes, target: int | None = None) -> int:
        self.data.extend(bytes(-len(self.data) % 4))
        view = gltf.BufferView(
            buffer=0, byteOffset=len(self.data), byteLength=len(data), target=target
        )
        self.views.append(view)
        self.data.extend(data)
        return len(self.views) - 1

    def array(
        self, values: NDArray[np.float64], kind: str, *, target: int | None = None, bounds: bool
    ) -> int:
        """An accessor of float32 values, (n, k) or (n,)."""
        a = np.ascontiguousarray(values, dtype="<f4")
        accessor = gltf.Accessor(
            bufferView=self.view(a.tobytes(), target),
            componentType=gltf.FLOAT,
            count=len(a),
            type=kind,
        )
        if bounds:
            rows = a.reshape(len(a), -1)
            accessor.min, accessor.max = numbers_of(rows.min(axis=0)), numbers_of(rows.max(axis=0))
        return self._add(accessor)

    def bytes4(self, row: tuple[int, int, int, int], count: int, *, normalized: bool) -> int:
        """An accessor of `count` equal vectors of four bytes."""
        view = self.view(bytes(row) * count, gltf.ARRAY_BUFFER)
        return self._add(
            gltf.Accessor(
                bufferView=view,
                componentType=gltf.UNSIGNED_BYTE,
                normalized=normalized,
                count=count,
                type=gltf.VEC4,
            )
        )

    def indices(self, triangles: NDArray[np.int32], n_vertices: int) -> int:
        kind, dtype = _index_type(n_vertices, _U16_LIMIT)
        view = self.view(triangles.astype(dtype).tobytes(), gltf.ELEMENT_ARRAY_BUFFER)
        return self._add(
            gltf.Accessor(
                bufferView=view, componentType=kind, count=triangles.size, type=gltf.SCALAR
            )
        )

    def sparse(self, values: NDArray[np.float64], row_view: int, count: int) -> int:
        """An accessor of `count` 3-vectors, zero except in the rows whose indices are stored."""
        a = np.ascontiguousarray(values, dtype="<f4")
        seen = a if len(a) == count else np.concatenate([a, np.zeros((1, 3), "<f4")])
        indices = gltf.AccessorSparseIndices(
            bufferView=row_view, componentType=_index_type(count, _U16_LIMIT + 1)[0]
        )
        return self._add(
            gltf.Accessor(
                byteOffset=None,  # allowed only beside a buffer view
                componentType=gltf.FLOAT,
                count=count,
                type=gltf.VEC3,
                min=numbers_of(seen.min(axis=0)),
                max=numbers_of(seen.max(axis=0)),
                sparse=gltf.Sparse(
                    count=len(a),
                    indices=indices,
                    values=gltf.AccessorSparseValues(bufferView=self.view(a.tobytes())),
                ),
            )
        )

    def sparse_rows(self, rows: NDArray[np.int32], count: int) -> int:
        return self.view(rows.astype(_index_type(count, _U16_LIMIT + 1)[1]).tobytes())

    def _add(self, accessor: gltf.Accessor) -> int:
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _index_type(n_vertices: int, limit: int) -> tuple[int, str]:
    small = n_vertices <= limit
    return (gltf.UNSIGNED_SHORT, "<u2") if small else (gltf.UNSIGNED_INT, "<u4")


def numbers_of(values: NDArray[np.generic] | Sequence[float]) -> list[float]:
    """Single-precision values as JSON numbers, so that they equal what the buffers hold."""
    return [float(x) for x in np.asarray(values, dtype=np.float32)]
