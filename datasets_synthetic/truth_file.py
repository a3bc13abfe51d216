"""``truth.npz`` of any length through constant memory: blocks of rows, joined at the end."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..core.files import atomic_path


def join_truth(
    blocks: Sequence[Path], path: Path, constant: Mapping[str, NDArray[np.generic]]
) -> None:
    """Write an ``.npz`` whose arrays are those of several, one after another.

    The same blocks give the same bytes.

    Parameters
    ----------
    blocks : sequence of Path
        ``.npz`` files with the same names; arrays are joined along their first axis.
    path : Path
        Appears only if all went well.
    constant : mapping
        Arrays that are written as they are.
    """
    with np.load(blocks[0], allow_pickle=False) as first:
        names = list(first.files)
    with atomic_path(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as out:
        for name, array in constant.items():
            with _member(out, name) as stream:
                np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
        for name in names:
            with _member(out, name) as stream:
                _write_joined(stream, name, blocks)


def _write_joined(stream: IO[bytes], name: str, blocks: Sequence[Path]) -> None:
    shapes, kind = [], np.dtype(np.float64)
    for block in blocks:
        shape, kind = _shape_in(block, name)
        shapes.append(shape)
    assert len({s[1:] for s in shapes}) == 1, f"{name}: blocks of unlike rows"
    header: dict[str, Any] = {
        "descr": np.lib.format.dtype_to_descr(kind),
        "fortran_order": False,
        "shape": (sum(s[0] for s in shapes), *shapes[0][1:]),
    }
    np.lib.format.write_array_header_1_0(stream, header)
    for block in blocks:
        with np.load(block, allow_pickle=False) as z:
            stream.write(np.ascontiguousarray(z[name]).tobytes())


def _shape_in(block: Path, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array in an ``.npz``, by its header alone."""
    with zipfile.ZipFile(block) as z, z.open(f"{name}.npy") as stream:
        np.lib.format.read_magic(stream)
        shape, _, kind = np.lib.format.read_array_header_1_0(stream)
    return shape, kind


def _member(out: zipfile.ZipFile, name: str) -> IO[bytes]:
    # a ZipInfo of its own has the same date for ever
    info = zipfile.ZipInfo(f"{name}.npy")
    info.compress_type = zipfile.ZIP_DEFLATED
    return out.open(info, "w", force_zip64=True)
