"""Clips as NumPy archives."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from facewright.core.clip import Clip
from facewright.core.errors import FileFormatError
from facewright.core.formats.clip_npz import read_clip_npz, write_clip_npz


def clip() -> Clip:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(20, 3))
    values[rng.random((20, 3)) < 0.3] = np.nan
    return Clip(np.cumsum(rng.uniform(0.01, 0.1, 20)), ("jawOpen", "ä", "a longer name"), values)


def members() -> dict[str, object]:
    whole = clip()
    return {
        "version": np.int64(1),
        "time_s": whole.time_s,
        "channels": np.array(whole.channels),
        "values": whole.values,
    }


@pytest.mark.parametrize("value", [clip(), Clip(np.zeros(0), (), np.zeros((0, 0)))])
def test_what_is_written_reads_back_to_the_last_bit(tmp_path: Path, value: Clip) -> None:
    write_clip_npz(tmp_path / "a.npz", value)
    found = read_clip_npz(tmp_path / "a.npz")
    assert found.channels == value.channels
    for name in ("time_s", "values", "is_set"):
        np.testing.assert_array_equal(getattr(found, name), getattr(value, name))
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_archives_by_numpy_alone_are_read(tmp_path: Path) -> None:
    values = np.asfortranarray(clip().values.astype(np.float32))
    np.savez(tmp_path / "a.npz", **{**members(), "values": values})  # type: ignore[arg-type]
    found = read_clip_npz(tmp_path / "a.npz")
    np.testing.assert_array_equal(found.values, values.astype(np.float64))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": np.int64(2)}, "version: expected 1, found 2"),
        ({"version": np.array([1, 1])}, "version: expected 1"),
        ({"values": np.array([[object()]])}, "values: expected an array of floats, found .*object"),
        ({"channels": np.array(["x", "x", "y"])}, "twice: x"),
        ({"channels": np.arange(3)}, "channels: expected an array of text"),
        ({"time_s": np.zeros(20)}, "strictly increasing"),
        ({"time_s": np.arange(20)}, "time_s: expected an array of floats"),
        ({"values": np.full((20, 3), np.inf)}, "finite"),
        ({"values": np.zeros((20, 2))}, "shape"),
    ],
)
def test_wrong_contents_are_named(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **{**members(), **changes}, allow_pickle=True)  # type: ignore[arg-type]
    with pytest.raises(FileFormatError, match=message):
        read_clip_npz(path)


def test_a_missing_array_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time_s=np.zeros(1))
    with pytest.raises(FileFormatError, match="expected an array called version, found time_s"):
        read_clip_npz(tmp_path / "a.npz")


def archive_with(path: Path, name: str, data: bytes, method: int = zipfile.ZIP_DEFLATED) -> Path:
    np.savez(path, **members())  # type: ignore[arg-type]
    with zipfile.ZipFile(path) as source:
        parts = {info.filename: source.read(info) for info in source.infolist()}
    parts[f"{name}.npy"] = data
    with zipfile.ZipFile(path, "w", method) as target:
        for part, content in parts.items():
            target.writestr(part, content)
    return path


def npy_header(shape: str, descr: str = "'<f8'") -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    "shape", ["(1000000000000, 3)", "(20, 4)", "(20, -3)", "(2,)", "(99999999999999999999,)"]
)
def test_lying_headers_take_no_memory(tmp_path: Path, shape: str) -> None:
    path = archive_with(tmp_path / "a.npz", "values", npy_header(shape) + bytes(480))
    with pytest.raises(FileFormatError, match="values: expected"):
        read_clip_npz(path)


@pytest.mark.parametrize("junk", [b"", b"hello", b"\x93NUMPY\x09\x00", npy_header("(1,", "0")])
def test_junk_in_an_archive_is_refused(tmp_path: Path, junk: bytes) -> None:
    path = archive_with(tmp_path / "a.npz", "values", junk)
    with pytest.raises(FileFormatError, match=r"values: expected an \.npy array"):
        read_clip_npz(path)


def test_bombs_are_refused_before_they_unpack(tmp_path: Path) -> None:
    huge = npy_header("(200000000,)") + bytes(50_000_000)
    path = archive_with(tmp_path / "a.npz", "values", huge, zipfile.ZIP_BZIP2)
    assert path.stat().st_size < 10_000
    with pytest.raises(FileFormatError, match="stored or deflated"):
        read_clip_npz(path)
    data = bytearray(archive_with(tmp_path / "b.npz", "values", b"x").read_bytes())
    at = data.rindex(b"PK\x01\x02")  # the directory's last entry: values
    data[at + 24 : at + 28] = (2**31).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=r"at most .* bytes unpacked"):
        read_clip_npz(path)


def test_damaged_and_cut_archives_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_clip_npz(path, clip())
    whole = path.read_bytes()
    for n in (0, 1, 10, 100, len(whole) // 2, len(whole) - 30, len(whole) - 1):
        path.write_bytes(whole[:n])
        with pytest.raises(FileFormatError):
            read_clip_npz(path)
    rng = np.random.default_rng(0)
    for _ in range(300):  # any byte may be wrong: the same clip, or an error, nothing else
        data = bytearray(whole)
        data[int(rng.integers(len(data)))] ^= int(rng.integers(1, 256))
        path.write_bytes(data)
        try:
            found = read_clip_npz(path)
        except FileFormatError:
            continue
        np.testing.assert_array_equal(found.values, clip().values)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    for data in (b"hello\n" * 100, buffer.getvalue()):
        path.write_bytes(data)
        with pytest.raises(FileFormatError, match=r"\.npz archive"):
            read_clip_npz(path)
