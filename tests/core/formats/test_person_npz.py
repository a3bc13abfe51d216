"""Persons as NumPy archives."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.person_npz import read_person_npz, write_person_npz
from facewright.core.markers import HEAD, Marker, MarkerSet
from facewright.core.person import Person

_ARRAYS = ("neutral", "modes", "noise_mm", "is_known")


def person(labels: tuple[str, ...] = ("a", "ä", "a longer name", "d")) -> Person:
    rng = np.random.default_rng(0)
    M = len(labels)
    return Person(
        "lab set",
        labels,
        rng.normal(0, 60, (M, 3)),
        rng.normal(0, 3, (7, M, 3)),
        rng.uniform(0.5, 2, M),
        rng.random(M) < 0.5,
        0.07,
        1234,
    )


def members() -> dict[str, object]:
    whole = person()
    return {
        "version": np.int64(1),
        "marker_set": np.array(whole.marker_set),
        "labels": np.array(whole.labels),
        **{name: getattr(whole, name) for name in _ARRAYS},
        "log_scale_sd": np.float64(0.07),
        "n_frames": np.int64(1234),
    }


def test_what_is_written_reads_back_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_person_npz(path, person())
    found = read_person_npz(path)
    for name in ("marker_set", "labels", "log_scale_sd", "n_frames"):
        assert getattr(found, name) == getattr(person(), name)
    for name in _ARRAYS:
        np.testing.assert_array_equal(getattr(found, name), getattr(person(), name))
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": np.int64(2)}, "version: expected 1, found 2"),
        ({"version": np.array([1, 1])}, "version: expected a single value"),
        ({"neutral": np.zeros((3, 3))}, "neutral must have shape"),
        ({"neutral": np.full((4, 3), np.nan)}, "neutral must be finite"),
        ({"modes": np.zeros((7, 3, 4))}, "modes must have shape"),
        ({"modes": np.array([[object()]])}, "modes: expected an array of floats, found .*object"),
        ({"noise_mm": np.zeros(4)}, "noise_mm must lie above 0"),
        ({"labels": np.array(["a", "a", "b", "c"])}, "labels must differ"),
        ({"labels": np.arange(4)}, "labels: expected an array of text"),
        ({"log_scale_sd": np.float64(-1)}, "log_scale_sd must be 0 or more"),
        ({"n_frames": np.int64(-1)}, "n_frames must be 0 or more"),
    ],
)
def test_wrong_contents_are_named(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **{**members(), **changes}, allow_pickle=True)  # type: ignore[arg-type]
    with pytest.raises(FileFormatError, match=message):
        read_person_npz(path)


def test_a_header_that_lies_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **members())  # type: ignore[arg-type]
    with zipfile.ZipFile(path) as source:
        parts = {info.filename: source.read(info) for info in source.infolist()}
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 4, 3), }"
    parts["modes.npy"] = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
    with zipfile.ZipFile(path, "w") as target:
        for part, content in parts.items():
            target.writestr(part, content)

    with pytest.raises(FileFormatError, match=r"modes: expected .* bytes"):
        read_person_npz(path)


def test_damaged_cut_and_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_person_npz(path, person())
    whole = path.read_bytes()
    for n in (0, 1, 10, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:n])
        with pytest.raises(FileFormatError):
            read_person_npz(path)
    np.savez(path, time_s=np.zeros(1))
    with pytest.raises(FileFormatError, match="expected an array called version, found time_s"):
        read_person_npz(path)
    rng = np.random.default_rng(0)
    for _ in range(150):  # any byte may be wrong: the same person, or an error, nothing else
        data = bytearray(whole)
        data[int(rng.integers(len(data)))] ^= int(rng.integers(1, 256))
        path.write_bytes(data)
        try:
            found = read_person_npz(path)
        except FileFormatError:
            continue
        np.testing.assert_array_equal(found.modes, person().modes)


def test_a_person_who_wore_another_set_is_refused() -> None:
    places = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    same = MarkerSet("same", tuple(Marker(n, HEAD, p) for n, p in zip("dcba", places, strict=True)))
    other = MarkerSet("other", same.markers[:3])
    abcd = person(("a", "b", "c", "d"))

    abcd.check_wears(same)  # the order does not matter
    with pytest.raises(InputError, match=r"learnt with marker set lab set.* than other \(a\)"):
        abcd.check_wears(other)


def test_selecting_labels_keeps_what_belongs_together() -> None:
    found = person().select(("d", "ä"))
    assert found.labels == ("d", "ä")
    np.testing.assert_array_equal(found.neutral, person().neutral[[3, 1]])
    np.testing.assert_array_equal(found.modes, person().modes[:, [3, 1]])
    np.testing.assert_array_equal(found.noise_mm, person().noise_mm[[3, 1]])
