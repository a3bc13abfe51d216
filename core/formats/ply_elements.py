"""The lower half of ``.ply``: a header, and the columns of numbers that it promises."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError

MAX_FILE_BYTES = 2 * 1024**3
_MAX_HEADER_BYTES = 64 * 1024
_MAX_ROWS = 50_000_000
_LARGEST = 2**32  # no whole number of the format is this large
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, eq=False)
class Column:
    """One property of all rows of an element.

    Attributes
    ----------
    values : (n,) numbers
        Of lists: all lists, one after another.
    counts : (rows,) int64 or None
        Lengths of the lists; None where the property is one number.
    """

    values: NDArray[np.generic]
    counts: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str  # of numpy, without byte order
    count_kind: str | None = None


@dataclass(frozen=True)
class _Element:
    name: str
    n_rows: int
    properties: tuple[_Property, ...]


def read_elements(path: Path) -> tuple[dict[str, Mapping[str, Column]], tuple[str, ...]]:
    """All elements by name, each with its columns by name; and the comments.

    Raises
    ------
    FileFormatError
        If the header is none, promises more than the file holds, or the numbers are damaged.
    OSError
        If the file cannot be read.
    """
    size = path.stat().st_size
    if size > MAX_FILE_BYTES:
        raise FileFormatError(path, "file", f"at most {MAX_FILE_BYTES} bytes", f"{size} bytes")
    data = path.read_bytes()
    lines, start = _header_lines(path, data)
    order, elements, comments = _parse_header(path, lines)
    least = sum(e.n_rows * _least_bytes(e, order) for e in elements)
    if least > len(data) - start + 1:  # text may end without a line break
        raise FileFormatError(
            path, "file", f"at least {least} bytes after the header", f"{len(data) - start}"
        )
    if order == "ascii":
        return _read_text(path, data[start:], len(lines), elements), comments
    found: dict[str, Mapping[str, Column]] = {}
    at = start
    for element in elements:
        found[element.name], at = _read_binary(path, data, at, element, _ORDERS[order])
    return found, comments


def _header_lines(path: Path, data: bytes) -> tuple[list[str], int]:
    head = data[:_MAX_HEADER_BYTES]
    if not head.startswith((b"ply\n", b"ply\r")):
        found = "an empty file" if not data else repr(head[:8].decode("utf-8", "replace"))
        raise FileFormatError(path, "line 1", "ply", found)
    end = head.find(b"end_header")
    stop = head.find(b"\n", end)
    if end < 0 or stop < 0:
        raise FileFormatError(
            path, "header", f"end_header within {_MAX_HEADER_BYTES} bytes", "none"
        )
    return head[:stop].decode("utf-8", "replace").splitlines(), stop + 1


def _parse_header(path: Path, lines: list[str]) -> tuple[str, list[_Element], tuple[str, ...]]:
    order = ""
    elements: list[_Element] = []
    comments = []
    for number, line in enumerate(lines[1:], start=2):
        words = line.split()
        if not words or words[0] in ("obj_info", "end_header"):
            continue
        if words[0] == "comment":
            comments.append(line.partition("comment")[2].strip())
        elif words[0] == "format":
            if len(words) < 2 or words[1] not in _ORDERS:
                raise FileFormatError(path, f"line {number}", f"one of {', '.join(_ORDERS)}", line)
            order = words[1]
        elif words[0] == "element":
            elements.append(_element(path, number, words, elements))
        elif words[0] == "property" and elements:
            last = elements[-1]
            added = _property(path, number, words, last)
            elements[-1] = _Element(last.name, last.n_rows, (*last.properties, added))
        else:
            raise FileFormatError(
                path, f"line {number}", "format, element, property or comment", line
            )
    if not order:
        raise FileFormatError(path, "header", "a line format", "none")
    return order, elements, tuple(comments)


def _element(path: Path, number: int, words: list[str], before: list[_Element]) -> _Element:
    if len(words) != 3 or not (words[2].isascii() and words[2].isdigit()):
        raise FileFormatError(path, f"line {number}", "element NAME COUNT", " ".join(words))
    if len(words[2]) > 10 or int(words[2]) > _MAX_ROWS:
        raise FileFormatError(path, f"line {number}", f"at most {_MAX_ROWS} rows", words[2])
    if words[1] in (e.name for e in before):
        raise FileFormatError(path, f"line {number}", f"one element {words[1]}", "a second")
    return _Element(words[1], int(words[2]), ())


def _property(path: Path, number: int, words: list[str], element: _Element) -> _Property:
    is_list = len(words) == 5 and words[1] == "list"
    kinds = words[2:4] if is_list else words[1:2]
    wrong = [k for k in kinds if k not in _TYPES]
    if (not is_list and len(words) != 3) or wrong or (is_list and _TYPES[words[2]][0] == "f"):
        raise FileFormatError(
            path, f"line {number}", "property TYPE NAME or property list TYPE TYPE NAME",
            " ".join(words),
        )  # fmt: skip
    if words[-1] in (p.name for p in element.properties):
        raise FileFormatError(path, f"line {number}", f"one property {words[-1]}", "a second")
    if is_list:
        return _Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
    return _Property(words[2], _TYPES[words[1]])


def _least_bytes(element: _Element, order: str) -> int:
    """Of one row: empty lists, or digits and blanks."""
    if order == "ascii":
        return 2 * len(element.properties)
    return sum(np.dtype(p.count_kind or p.kind).itemsize for p in element.properties)


def _read_binary(
    path: Path, data: bytes, at: int, element: _Element, order: str
) -> tuple[dict[str, Column], int]:
    """The columns of an element that begins at a byte; and where the next one does."""
    n, properties = element.n_rows, element.properties
    if not n or not properties:
        return {p.name: _empty(p) for p in properties}, at
    # a guess that scanners' files fulfil: all rows have lists as long as the first row's
    lengths = _row_lengths(path, data, at, element, order, 0)[0]
    fields = []
    for k, (p, length) in enumerate(zip(properties, lengths, strict=True)):
        if p.count_kind is not None:
            fields.append((f"n{k}", order + p.count_kind))
        fields.append((f"v{k}", order + p.kind, (length,)))  # type: ignore[arg-type]
    row = np.dtype(fields)
    if at + n * row.itemsize <= len(data):
        rows = np.frombuffer(data, row, n, at)
        lists = [k for k, p in enumerate(properties) if p.count_kind is not None]
        if all((rows[f"n{k}"] == lengths[k]).all() for k in lists):
            found = {}
            for k, p in enumerate(properties):
                counts = np.full(n, lengths[k], np.int64) if k in lists else None
                values = np.ascontiguousarray(rows[f"v{k}"]).reshape(-1)
                found[p.name] = Column(values.astype(p.kind), counts)
            return found, at + n * row.itemsize
    return _read_uneven(path, data, at, element, order)


def _row_lengths(
    path: Path, data: bytes, at: int, element: _Element, order: str, row: int
) -> tuple[list[int], list[int], int]:
    """Lengths and places of the values of one row; and the byte after it."""
    lengths, places = [], []
    for p in element.properties:
        length = 1
        if p.count_kind is not None:
            kind = np.dtype(order + p.count_kind)
            if at + kind.itemsize > len(data):
                raise _cut_off(path, element, row)
            length = int(np.frombuffer(data, kind, 1, at)[0])
            at += kind.itemsize
        lengths.append(length)
        places.append(at)
        at += length * np.dtype(p.kind).itemsize
        if length < 0 or at > len(data):
            raise _cut_off(path, element, row)
    return lengths, places, at


def _read_uneven(
    path: Path, data: bytes, at: int, element: _Element, order: str
) -> tuple[dict[str, Column], int]:
    """Row by row, where lists differ in length."""
    properties = element.properties
    parts: list[list[NDArray[np.generic]]] = [[] for _ in properties]
    counts = np.zeros((element.n_rows, len(properties)), np.int64)
    for row in range(element.n_rows):
        lengths, places, at = _row_lengths(path, data, at, element, order, row)
        counts[row] = lengths
        for part, p, length, place in zip(parts, properties, lengths, places, strict=True):
            part.append(np.frombuffer(data, order + p.kind, length, place))
    found = {}
    for k, (p, part) in enumerate(zip(properties, parts, strict=True)):
        values = np.concatenate(part).astype(p.kind)
        found[p.name] = Column(values, None if p.count_kind is None else counts[:, k])
    return found, at


def _read_text(
    path: Path, body: bytes, n_header_lines: int, elements: list[_Element]
) -> dict[str, Mapping[str, Column]]:
    lines = body.decode("utf-8", "replace").splitlines()
    found: dict[str, Mapping[str, Column]] = {}
    at = 0
    for element in elements:
        parts: list[list[float]] = [[] for _ in element.properties]
        counts: list[list[int]] = [[] for _ in element.properties]
        for row in range(element.n_rows):
            if at >= len(lines):
                raise _cut_off(path, element, row)
            _read_line(path, lines[at], n_header_lines + at + 1, element, parts, counts)
            at += 1
        columns = {}
        for p, part, count in zip(element.properties, parts, counts, strict=True):
            values = np.array(part, dtype="f8" if p.kind[0] == "f" else "i8")
            is_list = p.count_kind is not None
            columns[p.name] = Column(values, np.array(count, np.int64) if is_list else None)
        found[element.name] = columns
    return found


def _read_line(
    path: Path,
    line: str,
    number: int,
    element: _Element,
    parts: list[list[float]],
    counts: list[list[int]],
) -> None:
    """Add the numbers of one line to the columns."""
    words = line.split()
    at = 0
    try:
        for p, part, count in zip(element.properties, parts, counts, strict=True):
            length = 1
            if p.count_kind is not None:
                length = int(words[at])
                at += 1
            if length < 0 or at + length > len(words):
                raise IndexError
            kind = float if p.kind[0] == "f" else int
            numbers = [kind(word) for word in words[at : at + length]]
            if kind is int and any(abs(number) >= _LARGEST for number in numbers):
                raise ValueError
            part.extend(numbers)
            count.append(length)
            at += length
        if at != len(words):
            raise IndexError
    except (ValueError, IndexError):
        names = " ".join(p.name for p in element.properties)
        found = line[:60] if line else "an empty line"
        raise FileFormatError(
            path, f"line {number}", f"the numbers of a {element.name} ({names})", found
        ) from None


def _empty(p: _Property) -> Column:
    counts = None if p.count_kind is None else np.zeros(0, np.int64)
    return Column(np.zeros(0, p.kind), counts)


def _cut_off(path: Path, element: _Element, row: int) -> FileFormatError:
    return FileFormatError(
        path, f"{element.name} {row}", f"{element.n_rows} rows of {element.name}", "the file's end"
    )
