"""The container of a .glb file: its JSON document and its numbers, checked before they are used.

Nothing in a file is believed: every index, count and length is compared with what is there before
memory is taken, and all that is decoded comes out of one budget.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError

#: No .glb of ours is larger; a larger file is refused before it is read.
MAX_GLB_BYTES = 1 << 30
#: Numbers that one file may unfold to: references are short, what they refer to is long.
MAX_NUMBERS = 1 << 28
#: Extensions that a file may require of us: they change what we do not read, or only how
#: numbers are stored (KHR_mesh_quantization: integers, which we decode anyway).
KNOWN_EXTENSIONS = frozenset(
    {"KHR_mesh_quantization", "KHR_materials_unlit", "KHR_lights_punctual"}
)

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_UNSIGNED = (5121, 5123, 5125)
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_LARGEST = 1e30  # float32 ends at 3e38; beyond this, squares overflow

Object = Mapping[str, Any]


class GlbDocument:
    """A parsed .glb file.

    Parameters
    ----------
    name : Path or str
        What messages call the file.
    data : bytes
        The whole file.

    Raises
    ------
    FileFormatError
        If it is not a complete glTF 2.0 binary with all its data inside.
    """

    def __init__(self, name: Path | str, data: bytes) -> None:
        self.name = name
        text, self._binary = self._chunks(data)
        self.root = self._parse(text)
        self._left = MAX_NUMBERS
        self._buffers: dict[int, memoryview] = {}
        self._check_header()

    def fail(self, where: str, expected: str, found: object) -> NoReturn:
        """Raise a FileFormatError."""
        text = str(found)
        raise FileFormatError(
            self.name, where, expected, text if len(text) < 80 else text[:77] + "…"
        )

    # the container

    def _chunks(self, data: bytes) -> tuple[bytes, memoryview]:
        if not data:
            self.fail("file", "contents", "an empty file")
        if data[:4] != b"glTF":
            self.fail("byte 0", "the signature glTF of a .glb file", data[:4])
        if len(data) < 20:
            self.fail("file", "a header and a chunk of JSON", f"{len(data)} bytes")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            self.fail("byte 4", "glTF version 2", version)
        if length > len(data):
            self.fail("file", f"{length} bytes as its header says", f"{len(data)}: is it cut off?")
        chunks: list[tuple[bytes, memoryview]] = []
        at = 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<I4s", data, at)
            if at + 8 + size > length:
                self.fail(f"byte {at}", f"a chunk of {size} bytes", f"{length - at - 8} are left")
            chunks.append((kind, memoryview(data)[at + 8 : at + 8 + size]))
            at += 8 + size
        if not chunks or chunks[0][0] != b"JSON":
            self.fail("byte 12", "a chunk of JSON", chunks[0][0] if chunks else "nothing")
        binary = [chunk for kind, chunk in chunks[1:] if kind == b"BIN\0"]
        return bytes(chunks[0][1]), binary[0] if binary else memoryview(b"")

    def _parse(self, text: bytes) -> Object:
        def refuse(constant: str) -> NoReturn:
            raise ValueError(f"{constant} is not JSON")

        try:
            root = json.loads(text.decode("utf-8", "replace"), parse_constant=refuse)
        except (ValueError, RecursionError) as error:
            self.fail("its JSON", "a document", str(error) or type(error).__name__)
        if not isinstance(root, dict):
            self.fail("its JSON", "an object", type(root).__name__)
        return root

    def _check_header(self) -> None:
        version = self.member(self.root, "asset", "document").get("version")
        if not isinstance(version, str) or not version.startswith("2."):
            self.fail("asset", "glTF version 2.x", version)
        unknown = [
            name
            for name in self.array(self.root, "extensionsRequired", "document")
            if name not in KNOWN_EXTENSIONS
        ]
        if unknown:
            how = "export it uncompressed"
            if "KHR_draco_mesh_compression" in unknown:
                how = "export it without Draco compression"
            self.fail(
                "extensionsRequired",
                f"a file that can be read without them ({how})",
                ", ".join(map(str, unknown)),
            )

    # the JSON document

    def array(self, holder: Object, key: str, where: str) -> Sequence[Any]:
        """An array member; empty where it is missing."""
        value = holder.get(key, [])
        if not isinstance(value, list):
            self.fail(where, f"an array {key}", value)
        return value

    def member(self, holder: Object, key: str, where: str) -> Object:
        """An object member; empty where it is missing."""
        value = holder.get(key, {})
        if not isinstance(value, dict):
            self.fail(where, f"an object {key}", value)
        return value

    def item(self, kind: str, index: object, where: str) -> Object:
        """An object of one of the document's arrays: ``item("meshes", 3, "node 1")``."""
        items = self.array(self.root, kind, "document")
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(items):
            self.fail(where, f"an index below {len(items)} into {kind}", index)
        if not isinstance(items[index], dict):
            self.fail(f"{kind} {index}", "an object", items[index])
        found: Object = items[index]
        return found

    def integer(self, holder: Object, key: str, where: str, default: int | None = None) -> int:
        """A member that is a whole number from 0 to 2³²−1."""
        value = holder.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**32:
            self.fail(where, f"a whole number {key}", value)
        return value

    def numbers(
        self, holder: Object, key: str, where: str, default: Sequence[float]
    ) -> NDArray[np.float64]:
        """An array member of as many finite numbers as `default` has."""
        values = self.array(holder, key, where) if key in holder else default
        fits = len(values) == len(default) and all(
            isinstance(x, (int, float)) and not isinstance(x, bool) and abs(x) < _LARGEST
            for x in values
        )
        if not fits:
            self.fail(where, f"{len(default)} numbers {key}", values)
        return np.array(values, dtype=np.float64)

    def number(self, holder: Object, key: str, where: str, default: float) -> float:
        """A member that is a finite number."""
        return float(self.numbers({key: [holder.get(key, default)]}, key, where, (default,))[0])

    def name_of(self, holder: Object, default: str) -> str:
        """The member `name`, where it is a text that says something."""
        value = holder.get("name")
        return value if isinstance(value, str) and value else default

    # the numbers

    def accessor(
        self,
        index: object,
        kinds: tuple[str, ...],
        where: str,
        count: int | None = None,
        *,
        integers: bool = False,
    ) -> NDArray[np.float64]:
        """The values of an accessor, (count,) for scalars, else (count, width), float64.

        Normalised integers are scaled to 0..1 or −1..1; others keep their value.
        """
        accessor, n, width = self._header(index, kinds, where, count)
        if integers:
            self.check_integers(accessor, where)
        where = f"accessor {index}"
        self.spend(n * width, where)
        if "bufferView" in accessor:
            values = self._stored(accessor, n, width, where)
        elif count is None:
            # nothing in the file says how large it may be, and no exporter leaves these out
            self.fail(where, "a buffer view", "none")
        else:
            values = np.zeros((n, width))
        if "sparse" in accessor:
            rows, replaced = self._sparse(accessor, n, width, where)
            values[rows] = replaced
        return values[:, 0] if accessor["type"] == "SCALAR" else values

    def displacements(
        self, index: object, where: str, count: int
    ) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Rows and values, (n,) and (n, 3), of 3-vectors most of which are zero."""
        accessor, n, width = self._header(index, ("VEC3",), where, count)
        where = f"accessor {index}"
        if "bufferView" in accessor:
            values = self.accessor(index, ("VEC3",), where, count)
            rows = np.flatnonzero(values.any(axis=1)).astype(np.int32)
            return rows, values[rows]
        rows, values = np.zeros(0, np.int32), np.zeros((0, 3))
        if "sparse" in accessor:
            rows, values = self._sparse(accessor, n, width, where)
            if len(rows) == 1 and not values.any():  # how nothing is stored: sparse needs a row
                rows, values = rows[:0], values[:0]
        return rows, values

    def check_integers(self, holder: Object, where: str) -> None:
        """Refuse a component type that is not a whole number without sign."""
        if holder.get("componentType") not in _UNSIGNED:
            self.fail(where, "whole numbers without sign", holder.get("componentType"))

    def view(self, index: object, where: str) -> tuple[memoryview, int]:
        """The bytes of a buffer view, and its stride (0: packed)."""
        view = self.item("bufferViews", index, where)
        where = f"buffer view {index}"
        buffer = self._buffer(self.integer(view, "buffer", where))
        start = self.integer(view, "byteOffset", where, 0)
        length = self.integer(view, "byteLength", where)
        if start + length > len(buffer):
            self.fail(where, f"an end within {len(buffer)} bytes", start + length)
        return buffer[start : start + length], self.integer(view, "byteStride", where, 0)

    def embedded(self, uri: object, where: str) -> bytes:
        """The contents of a data: address."""
        if not isinstance(uri, str) or not uri.startswith("data:") or ";base64," not in uri:
            self.fail(where, "data inside the file (export as one .glb)", f"a reference to {uri}")
        try:
            return base64.b64decode(uri.partition(";base64,")[2], validate=True)
        except (binascii.Error, ValueError) as error:
            self.fail(where, "base64", error)

    def _buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            where = f"buffer {index}"
            buffer = self.item("buffers", index, "buffer views")
            if "uri" in buffer:
                data = memoryview(self.embedded(buffer["uri"], where))
            elif index == 0:
                data = self._binary
            else:
                self.fail(where, "data inside the file", "none")
            length = self.integer(buffer, "byteLength", where)
            if length > len(data):
                self.fail(where, f"{length} bytes", f"{len(data)}: is the file cut off?")
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def _header(
        self, index: object, kinds: tuple[str, ...], where: str, count: int | None
    ) -> tuple[Object, int, int]:
        accessor = self.item("accessors", index, where)
        where = f"accessor {index} of {where}"
        if accessor.get("type") not in kinds:
            self.fail(where, " or ".join(kinds), accessor.get("type"))
        n = self.integer(accessor, "count", where)
        if n < 1 or (count is not None and n != count):
            self.fail(where, f"{count} values" if count is not None else "values", n)
        return accessor, n, _WIDTHS[accessor["type"]]

    def _stored(
        self, holder: Object, n: int, width: int, where: str, kind: int | None = None
    ) -> NDArray[np.float64]:
        """`n` rows of `width` numbers at the holder's place in its buffer view."""
        kind = self.integer(holder, "componentType", where) if kind is None else kind
        if kind not in _COMPONENTS:
            self.fail(where, "a component type of glTF 2.0", kind)
        data, stride = self.view(holder.get("bufferView"), where)
        dtype = np.dtype(_COMPONENTS[kind])
        start = self.integer(holder, "byteOffset", where, 0)
        size = width * dtype.itemsize
        stride = stride or size
        if stride < size or start + stride * (n - 1) + size > len(data):
            self.fail(where, f"{n} rows within {len(data)} bytes", start + stride * (n - 1) + size)
        raw = np.ndarray((n, width), dtype, data, start, (stride, dtype.itemsize))
        if not np.isfinite(raw).all():
            self.fail(where, "finite numbers", "NaN or infinity")
        values = raw.astype(np.float64)
        if np.abs(values).max() > _LARGEST:
            self.fail(where, f"numbers up to {_LARGEST:g}", np.abs(values).max())
        if holder.get("normalized") is True and dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(dtype).max, -1.0)  # glTF 2.0, 3.11
        return values

    def _sparse(
        self, accessor: Object, n: int, width: int, where: str
    ) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        sparse = self.member(accessor, "sparse", where)
        count = self.integer(sparse, "count", where)
        if not 0 < count <= n:
            self.fail(where, f"1 to {n} sparse values", count)
        self.spend(count * (width + 1), where)
        places = self.member(sparse, "indices", where)
        self.check_integers(places, where)
        rows = self._stored(places, count, 1, where)[:, 0]
        if rows[0] < 0 or rows[-1] >= n or not (np.diff(rows) > 0).all():
            self.fail(where, f"increasing sparse indices below {n}", "others")
        kind = self.integer(accessor, "componentType", where)
        values = self._stored(self.member(sparse, "values", where), count, width, where, kind)
        return rows.astype(np.int32), values

    def spend(self, n: int, where: str) -> None:
        """Take `n` numbers out of the file's budget before memory is taken for them."""
        self._left -= n
        if self._left < 0:
            self.fail(where, f"at most {MAX_NUMBERS} numbers in all", "more")
