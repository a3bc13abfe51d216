"""The array checker, and files that appear whole or not at all."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from facewright.core.arrays import readonly
from facewright.core.errors import FileFormatError, InputError
from facewright.core.files import atomic_path, atomic_write, read_text


@pytest.mark.parametrize(
    ("shape", "given", "message"),
    [
        ((..., 3), (4, 2), "points must have shape (..., 3), got (4, 2)"),
        ((3,), (3, 1), "points must have shape (3,), got (3, 1)"),
        ((None, 3), (3,), "points must have shape (any, 3), got (3,)"),
        ((), (1,), "points must have shape (), got (1,)"),
        ((..., 3, 3), (3,), "points must have shape (..., 3, 3), got (3,)"),
    ],
)
def test_readonly_names_the_array_and_both_shapes(
    shape: tuple[int | None, ...], given: tuple[int, ...], message: str
) -> None:
    with pytest.raises(ValueError) as caught:
        readonly(np.zeros(given), shape, "points")
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("shape", "given"),
    [((..., 3), (3,)), ((..., 3), (5, 4, 3)), ((None, 3), (0, 3)), ((2,), (2,)), ((), ())],
)
def test_readonly_takes_what_fits(shape: tuple[int | None, ...], given: tuple[int, ...]) -> None:
    source = np.ones(given, dtype=np.float32)
    found = readonly(source, shape, "x")
    assert found.dtype == np.float64
    assert found.shape == given
    assert not found.flags.writeable
    assert source.flags.writeable and not np.shares_memory(source, found)


def test_atomic_write_makes_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with atomic_write(path) as stream:
        stream.write("ä\n")
        assert not path.exists()
    assert path.read_bytes() == "ä\n".encode()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_atomic_write_leaves_the_old_file_on_an_error(
    tmp_path: Path, error: type[BaseException]
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(error), atomic_write(path) as stream:
        stream.write("half of it")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_path_keeps_the_suffix(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "x.mp4") as part:
        assert part.suffix == ".mp4" and part.parent == tmp_path
        part.write_bytes(b"1")
    assert (tmp_path / "x.mp4").read_bytes() == b"1"


def test_read_text_refuses_nothing_and_too_much(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"")
    with pytest.raises(FileFormatError, match="an empty file"):
        read_text(path)
    path.write_bytes(b"12345")
    with pytest.raises(FileFormatError, match="expected at most 4 bytes, found 5 bytes"):
        read_text(path, max_bytes=4)
    path.write_bytes(b"a\xffb")
    assert read_text(path) == "a\ufffdb"


def test_file_errors_survive_a_process_pool() -> None:
    error = FileFormatError(Path("a.fap"), "line 214", "68 values", "66")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) == "a.fap, line 214: expected 68 values, found 66"
    assert isinstance(again, FileFormatError)
    assert not isinstance(error, InputError)
