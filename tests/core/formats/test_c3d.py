"""C3D, against ezc3d and against files put together byte by byte."""

from __future__ import annotations

import logging
import struct
import subprocess
import sys
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.c3d import read_c3d, write_c3d
from facewright.core.formats.c3d_writer import C3dWriter
from facewright.core.trajectories import Source, Trajectories

T, M = 50, 4
FLOAT32 = 2.0**-24


def take(frames: int = T, markers: int = M, rate_hz: float = 60.0, seed: int = 0) -> Trajectories:
    """Markers with gaps, some of them filled, one at the origin."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(scale=300, size=(frames, markers, 3))
    positions[3, 0] = 0
    missing = rng.random((frames, markers)) < 0.2
    filled = ~missing & (rng.random((frames, markers)) < 0.2)
    missing[3, 0] = filled[3, 0] = False
    positions[missing] = np.nan
    measured = ~missing & ~filled
    source = np.where(filled, rng.integers(2, 4, filled.shape), measured).astype(np.uint8)
    residual = np.where(measured, rng.gamma(2, 0.1, (frames, markers)), np.nan)
    views = np.where(measured, rng.integers(2, 8, (frames, markers)), 0).astype(np.int32)
    names = tuple(f"marker_{n:03}" for n in range(markers))
    times = np.arange(frames) / rate_hz
    return Trajectories(times, names, positions, None, source, residual, views)


@pytest.mark.parametrize("rate_hz", [25.0, 60.0, 59.94, 119.88, 240.0])
def test_what_is_written_reads_back(tmp_path: Path, rate_hz: float) -> None:
    whole = take(rate_hz=rate_hz)

    write_c3d(tmp_path / "a.c3d", whole)
    found = read_c3d(tmp_path / "a.c3d")

    assert found.names == whole.names
    assert found.rate_hz == pytest.approx(rate_hz, rel=1e-12)
    np.testing.assert_array_equal(np.isnan(found.positions), np.isnan(whole.positions))
    np.testing.assert_allclose(found.positions, whole.positions, rtol=FLOAT32, atol=0)
    np.testing.assert_array_equal(found.source, whole.source)
    np.testing.assert_array_equal(found.n_views, whole.n_views)
    assert whole.residual_px is not None and found.residual_px is not None
    step = np.nanmax(whole.residual_px) / 254
    np.testing.assert_allclose(found.residual_px, whole.residual_px, atol=1.01 * step)
    assert [p.name for p in tmp_path.iterdir()] == ["a.c3d"]


def test_what_is_not_there_is_not_read_back(tmp_path: Path) -> None:
    whole = take()
    plain = Trajectories(whole.time_s, whole.names, whole.positions, source=whole.source)
    write_c3d(tmp_path / "a.C3D", plain)
    found = read_c3d(tmp_path / "a.C3D")
    assert found.residual_px is None and found.n_views is None and found.covariances is None
    np.testing.assert_array_equal(found.source, whole.source)
    assert [p.name for p in tmp_path.iterdir()] == ["a.C3D"]


def test_measured_samples_without_a_residual_stay_without(tmp_path: Path) -> None:
    residual = np.array([[0.0, np.nan], [3.0, 0.5]])
    whole = Trajectories(np.arange(2) / 50, ("a", "b"), np.ones((2, 2, 3)), residual_px=residual)
    write_c3d(tmp_path / "a.c3d", whole)
    found = read_c3d(tmp_path / "a.c3d")
    np.testing.assert_allclose(found.residual_px, residual, atol=3 / 254)  # type: ignore[arg-type]
    assert not found.is_filled.any()


def test_ezc3d_reads_what_we_write(tmp_path: Path) -> None:
    whole = take()
    write_c3d(tmp_path / "a.c3d", whole)

    peer = ezc3d.c3d(str(tmp_path / "a.c3d"))

    points = peer["parameters"]["POINT"]
    assert points["UNITS"]["value"] == ["mm"]
    assert tuple(points["LABELS"]["value"]) == whole.names
    assert points["RATE"]["value"][0] == 60
    xyz = peer["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(xyz.astype(np.float32), whole.positions.astype(np.float32))
    missing = np.isnan(whole.positions[..., 0])
    residuals = peer["data"]["meta_points"]["residuals"][0].T
    assert (residuals[missing] == -1).all()
    assert (residuals[~missing] >= 0).all()


def test_missing_samples_and_fourth_words_are_the_formats(tmp_path: Path) -> None:
    """c3d.org: -1 for a missing point; else cameras in the high byte, residual in the low one."""
    positions = np.ones((2, 2, 3))
    positions[0, 1] = np.nan
    whole = Trajectories(
        np.arange(2) / 50,
        ("a", "b"),
        positions,
        None,
        np.array([[Source.MEASURED, Source.MISSING], [Source.INTERPOLATED, Source.MEASURED]]),
        np.array([[0.5, np.nan], [np.nan, 2.54]]),
        np.array([[3, 0], [0, 9]], np.int32),
    )

    write_c3d(tmp_path / "a.c3d", whole)

    data = (tmp_path / "a.c3d").read_bytes()
    (block,) = struct.unpack_from("<H", data, 16)
    words = np.frombuffer(data, "<f4", 16, (block - 1) * 512).reshape(2, 2, 4)
    np.testing.assert_array_equal(words[0, 1], (0, 0, 0, -1))
    assert words[0, 0, 3] == 0b111 * 256 + 50  # three cameras; steps of 2.54 / 254
    assert words[1, 0, 3] == 0  # filled: neither
    assert words[1, 1, 3] == 0x7F * 256 + 254  # nine cameras: room for seven
    assert struct.unpack_from("<f", data, 12)[0] == np.float32(-0.01)


# --- Files by others ---


def foreign(path: Path, unit: str | None = "mm", labels: list[str] | None = None) -> Path:
    """A file that ezc3d wrote by itself: 3 frames of 2 points, one sample missing."""
    document = ezc3d.c3d()
    points = document["parameters"]["POINT"]
    points["RATE"]["value"] = [100.0]
    points["UNITS"]["value"] = [unit] if unit is not None else []
    points["LABELS"]["value"] = labels or ["left", "right"]
    xyz = np.arange(24.0).reshape(4, 2, 3) + 1
    residuals = np.zeros((1, 2, 3))
    residuals[0, 1, 2] = -1
    document["data"]["points"] = xyz
    document["data"]["meta_points"]["residuals"] = residuals
    document["data"]["meta_points"]["camera_masks"] = np.zeros((7, 2, 3), bool)
    document.write(str(path))
    return path


@pytest.mark.parametrize(("unit", "mm"), [("mm", 1), ("cm", 10), ("m", 1000), ("M ", 1000)])
def test_other_units_become_millimetres(tmp_path: Path, unit: str, mm: float) -> None:
    found = read_c3d(foreign(tmp_path / "a.c3d", unit))
    expected = (np.arange(24.0).reshape(4, 2, 3) + 1)[:3].transpose(2, 1, 0) * mm
    expected[2, 1] = np.nan
    np.testing.assert_allclose(found.positions, expected)
    assert found.names == ("left", "right")
    assert found.rate_hz == 100
    assert not found.is_filled.any()
    assert found.residual_px is None


def test_a_missing_unit_is_logged_and_an_unknown_one_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        read_c3d(foreign(tmp_path / "a.c3d", None))
    assert "POINT:UNITS is missing; taken to be mm" in caplog.text
    with pytest.raises(FileFormatError, match="POINT:UNITS: expected one of mm, cm, m, found inch"):
        read_c3d(foreign(tmp_path / "b.c3d", "inch"))


@pytest.mark.parametrize(
    ("labels", "names"),
    [
        (["a", "a"], ("a", "a_2")),
        (["a", ""], ("a", "unnamed_2")),
        (["", "unnamed_1"], ("unnamed_2", "unnamed_1")),
        (["x" * 200, "y"], ("x" * 200, "y")),
    ],
)
def test_names_are_made_to_differ(
    tmp_path: Path, labels: list[str], names: tuple[str, ...]
) -> None:
    assert read_c3d(foreign(tmp_path / "a.c3d", labels=labels)).names == names


def parameter(group: int, name: str, kind: int, sizes: list[int], data: bytes) -> bytes:
    body = struct.pack("<bB", kind, len(sizes)) + bytes(sizes) + data + b"\0"
    head = struct.pack("<bb", len(name), group) + name.encode()
    return head + struct.pack("<H", len(body) + 2) + body


def vax(value: float) -> bytes:
    """A VAX F-float: IEEE times 4, its 16-bit halves swapped."""
    data = struct.pack("<f", value * 4)
    return data[2:] + data[:2]


def by_hand(path: Path, processor: int, scale: float, analog: int = 0) -> Path:
    """2 frames of 2 points with 0 or 3 analog samples in a frame, by the format's description."""
    number = vax if processor == 85 else (lambda v: struct.pack("<f", v))
    group = b"\x05\xffPOINT" + struct.pack("<H", 3) + b"\0"
    group += b"\x06\xfeANALOG" + struct.pack("<H", 3) + b"\0"
    group += parameter(1, "USED", 2, [], struct.pack("<h", 2))
    group += parameter(1, "SCALE", 4, [], number(scale))
    group += parameter(1, "RATE", 4, [], number(50))
    group += parameter(1, "FRAMES", 2, [], struct.pack("<h", 2))
    group += parameter(1, "DATA_START", 2, [], struct.pack("<h", 3))
    group += parameter(1, "UNITS", -1, [4], b"cm  ")
    group += parameter(1, "LABELS", -1, [4, 2], b"ab  \xe4   ")
    group += parameter(2, "USED", 2, [], struct.pack("<h", analog))
    group += parameter(2, "RATE", 4, [], number(50 if analog else 0))
    section = bytes([1, 0x50, 1, processor]) + group
    header = struct.pack("<BBHHHHH", 2, 0x50, 2, analog, 1, 2, 10) + number(scale)
    header += struct.pack("<HH", 3, 1) + number(50)
    points = [[(1, 2, 3, 0x0305), (4, 5, 6, 0)], [(0, 0, 0, -1), (-7, 8, 9, 0x7F01)]]
    data = b""
    for frame in points:
        for point in frame:
            data += b"".join(number(v) if scale < 0 else struct.pack("<h", v) for v in point)
        data += (number(1.5) if scale < 0 else struct.pack("<h", 15)) * analog
    path.write_bytes(header.ljust(512, b"\0") + section.ljust(512, b"\0") + data)
    return path


@pytest.mark.parametrize("processor", [84, 85])
@pytest.mark.parametrize("scale", [-0.1, 0.5])
@pytest.mark.parametrize("analog", [0, 3])
def test_all_number_formats_are_read(
    tmp_path: Path, processor: int, scale: float, analog: int
) -> None:
    found = read_c3d(by_hand(tmp_path / "a.c3d", processor, scale, analog))

    step = 10 * (scale if scale > 0 else 1)
    expected = np.array([[(1, 2, 3), (4, 5, 6)], [(np.nan,) * 3, (-7, 8, 9)]]) * step
    np.testing.assert_allclose(found.positions, expected)
    assert found.names == ("ab", "ä")
    assert found.rate_hz == 50
    np.testing.assert_array_equal(found.is_filled, [[False, True], [False, False]])
    np.testing.assert_array_equal(found.n_views, [[2, 0], [0, 7]])
    assert found.residual_px is None  # a length, not pixels


@pytest.mark.parametrize("scale", [-0.1, 0.5])
def test_positions_agree_with_ezc3d(tmp_path: Path, scale: float) -> None:
    path = by_hand(tmp_path / "a.c3d", 84, scale)
    peer = ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(read_c3d(path).positions, peer * 10)


def test_gaps_written_as_zeros_are_gaps(tmp_path: Path) -> None:
    path = foreign(tmp_path / "a.c3d")
    data = bytearray(path.read_bytes())
    (block,) = struct.unpack_from("<H", data, 16)
    data[(block - 1) * 512 : (block - 1) * 512 + 16] = bytes(16)
    path.write_bytes(data)
    found = read_c3d(path)
    assert np.isnan(found.positions[0, 0]).all()
    assert np.isfinite(found.positions[0, 1]).all()


# --- Long, wide, and what cannot be written ---


def test_takes_of_more_than_65535_frames_are_whole(tmp_path: Path) -> None:
    frames = 66_000
    positions = np.arange(frames, dtype=float)[:, None, None] + np.array([[[1.0, 2.0, 3.0]]])
    write_c3d(tmp_path / "a.c3d", Trajectories(np.arange(frames) / 240, ("m",), positions))
    found = read_c3d(tmp_path / "a.c3d")
    np.testing.assert_array_equal(found.positions, positions)


def test_a_long_take_that_does_not_say_how_long_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.c3d"
    write_c3d(path, Trajectories(np.arange(66_000) / 240, ("m",), np.ones((66_000, 1, 3))))
    path.write_bytes(path.read_bytes().replace(b"LONG_FRAMES", b"LONG_GRAMES"))
    with pytest.raises(FileFormatError, match="POINT:LONG_FRAMES"):
        read_c3d(path)


def test_hundreds_of_markers_are_whole(tmp_path: Path) -> None:
    whole = take(3 + 1, 700)
    write_c3d(tmp_path / "a.c3d", whole)
    found = read_c3d(tmp_path / "a.c3d")
    assert found.names == whole.names
    np.testing.assert_allclose(found.positions, whole.positions, rtol=FLOAT32)


def test_as_many_long_names_as_there_is_room_for_are_whole(tmp_path: Path) -> None:
    names = tuple(f"{n:0127}" for n in range(930))
    positions = np.random.default_rng(0).normal(size=(2, len(names), 3))
    write_c3d(tmp_path / "a.c3d", Trajectories(np.arange(2) / 50, names, positions))
    found = read_c3d(tmp_path / "a.c3d")
    assert found.names == names
    np.testing.assert_allclose(found.positions, positions, rtol=FLOAT32)
    peer = ezc3d.c3d(str(tmp_path / "a.c3d"))["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(peer, positions, rtol=FLOAT32)


@pytest.mark.parametrize(
    ("times", "names", "message"),
    [
        ([0, 0.1, 0.3], ("a",), "uneven: resample"),
        ([0.0], ("a",), "at least 2 frames, not 1"),
        ([], ("a",), "at least 2 frames, not 0"),
        ([0, 0.1], (), "1 to 32767 markers, not 0"),
        ([0, 0.1], ("a" * 128,), "127 bytes"),
        ([0, 0.1], ("ä" * 64,), "127 bytes"),
        ([0, 0.1], (" a",), "without spaces around"),
        ([0, 0.1], ("",), "without spaces around"),
        ([0, 0.1], tuple(f"{n:0127}" for n in range(1200)), "longer than a C3D file has room for"),
    ],
)
def test_trajectories_the_format_cannot_hold_are_refused(
    tmp_path: Path, times: list[float], names: tuple[str, ...], message: str
) -> None:
    whole = Trajectories(np.array(times), names, np.zeros((len(times), len(names), 3)))
    with pytest.raises(InputError, match=message):
        write_c3d(tmp_path / "a.c3d", whole)
    assert list(tmp_path.iterdir()) == []


def test_positions_beyond_32_bits_are_refused(tmp_path: Path) -> None:
    whole = Trajectories(np.arange(2) / 50, ("a",), np.full((2, 1, 3), 1e39))
    with pytest.raises(InputError, match="32-bit"):
        write_c3d(tmp_path / "a.c3d", whole)


# --- Piece by piece ---


def piece(whole: Trajectories, rows: slice) -> Trajectories:
    assert whole.residual_px is not None and whole.n_views is not None
    return Trajectories(
        whole.time_s[rows],
        whole.names,
        whole.positions[rows],
        None,
        whole.source[rows],
        whole.residual_px[rows],
        whole.n_views[rows],
    )


def test_pieces_make_the_file_that_the_whole_makes(tmp_path: Path) -> None:
    whole = take()
    write_c3d(tmp_path / "a.c3d", whole)
    assert whole.residual_px is not None
    largest = float(np.nanmax(whole.residual_px))

    writer = C3dWriter(tmp_path / "b.c3d", whole.names, 60.0, T, largest_residual_px=largest)
    with writer:
        for rows in (slice(0, 20), slice(20, 21), slice(21, T)):
            writer.write(piece(whole, rows))

    assert (tmp_path / "b.c3d").read_bytes() == (tmp_path / "a.c3d").read_bytes()


def test_pieces_that_are_too_few_too_many_or_others_leave_no_file(tmp_path: Path) -> None:
    whole = take()
    others = take(markers=M + 1)

    def writing(*pieces: Trajectories) -> None:
        names = whole.names
        with C3dWriter(tmp_path / "a.c3d", names, 60.0, T, largest_residual_px=1.0) as writer:
            for part in pieces:
                writer.write(part)

    with pytest.raises(ValueError, match="49 frames came, 50 were promised"):
        writing(piece(whole, slice(0, 49)))
    with pytest.raises(ValueError, match="more frames than the 50"):
        writing(whole, piece(whole, slice(0, 1)))
    with pytest.raises(ValueError, match="the markers that the file was begun with"):
        writing(others)
    assert list(tmp_path.iterdir()) == []


def test_residuals_beyond_the_stated_largest_are_cut(tmp_path: Path) -> None:
    residual = np.array([[0.5], [3.0]])
    whole = Trajectories(np.arange(2) / 50, ("a",), np.ones((2, 1, 3)), residual_px=residual)
    with C3dWriter(tmp_path / "a.c3d", ("a",), 50.0, 2, largest_residual_px=1.0) as writer:
        writer.write(whole)
    found = read_c3d(tmp_path / "a.c3d").residual_px
    np.testing.assert_allclose(found, [[0.5], [1.0]], atol=1 / 254)  # type: ignore[arg-type]
    assert not read_c3d(tmp_path / "a.c3d").is_filled.any()


@pytest.mark.parametrize("count", [255, 256, 700])
def test_ezc3d_reads_many_names_over_several_parameters(tmp_path: Path, count: int) -> None:
    """A parameter has room for 255; the library knows LABELS2 and so on too."""
    whole = take(4, count)
    write_c3d(tmp_path / "a.c3d", whole)
    peer = ezc3d.c3d(str(tmp_path / "a.c3d"))["parameters"]["POINT"]
    labels = list(peer["LABELS"]["value"])
    for number in range(2, 4):
        if f"LABELS{number}" in peer:
            labels += peer[f"LABELS{number}"]["value"]
    assert tuple(labels) == whole.names


# --- Damage ---


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "an empty file"),
        (b"hello, this is text\n" * 100, "is this a C3D file"),
        (b"\x02", "is this a C3D file"),
        (b"\x02\x50" + bytes(100), "header"),
        (b"\x02\x50" + bytes(3000), "processor type"),
        (b"\xff\x50" + bytes(3000), "header: expected a parameter section"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "a.c3d").write_bytes(data)
    with pytest.raises(FileFormatError, match=message):
        read_c3d(tmp_path / "a.c3d")


def changed(path: Path, name: bytes, offset: int, value: bytes) -> Path:
    """The first parameter of that name in a new file, changed so many bytes behind it."""
    write_c3d(path, take())
    data = bytearray(path.read_bytes())
    at = data.index(name, 512) + len(name) + offset
    data[at : at + len(value)] = value
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("name", "offset", "value", "message"),
    [
        (b"USED", 4, b"\0\0", "POINT:USED: expected at least one point, found 0"),
        (b"USED", 4, b"\xff\x7f", "data: expected 50 frames"),
        (b"FRAMES", 4, b"\xfe\xff", "data: expected 65534 frames of 64 bytes, found 5[0-9] "),
        (b"LABELS", 3, b"\x04\xff\xff\xff\xff", "a whole parameter section"),
        (b"LABELS", 0, b"\x02\x00", "a whole parameter section"),
        (b"LABELS", 0, b"\xff\xff", "a whole parameter section"),
        (b"SCALE", 4, struct.pack("<f", 0), "POINT:SCALE"),
        (b"SCALE", 4, struct.pack("<f", np.nan), "POINT:SCALE: expected a finite number"),
    ],
)
def test_lying_parameters_are_refused(
    tmp_path: Path, name: bytes, offset: int, value: bytes, message: str
) -> None:
    with pytest.raises(FileFormatError, match=message):
        read_c3d(changed(tmp_path / "a.c3d", name, offset, value))


def test_a_rate_is_required(tmp_path: Path) -> None:
    path = changed(tmp_path / "a.c3d", b"RATE", 4, struct.pack("<f", 0))
    data = bytearray(path.read_bytes())
    assert read_c3d(path).rate_hz == 60  # the header has it too
    data[20:24] = bytes(4)
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="POINT:RATE: expected frames per second above 0"):
        read_c3d(path)


def test_a_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.c3d"
    write_c3d(path, take())
    data = path.read_bytes()
    (block,) = struct.unpack_from("<H", data, 16)
    end = (block - 1) * 512 + T * M * 16  # zeros that fill the last block follow
    for n in (*range(1, (block - 1) * 512, 37), end - 64, end - 1):
        path.write_bytes(data[:n])
        with pytest.raises(FileFormatError):
            read_c3d(path)
    path.write_bytes(data[:end])
    assert len(read_c3d(path).time_s) == T


def test_infinity_names_its_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.c3d"
    whole = take()
    write_c3d(path, whole)
    data = bytearray(path.read_bytes())
    (block,) = struct.unpack_from("<H", data, 16)
    at = (block - 1) * 512 + 3 * M * 16
    data[at : at + 4] = struct.pack("<f", np.inf)
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="frame 3, point 0: expected finite numbers"):
        read_c3d(path)


DAMAGE = """
import resource, sys
from pathlib import Path
import numpy as np
from facewright.core.errors import FileFormatError
from facewright.core.formats.c3d import read_c3d
used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
rng = np.random.default_rng(0)
source, path = Path(sys.argv[1]), Path(sys.argv[1] + ".damaged.c3d")
whole = source.read_bytes()
for _ in range(1500):
    data = bytearray(whole)
    for _ in range(int(rng.integers(1, 5))):
        data[int(rng.integers(2048))] = int(rng.choice([0, 1, 127, 128, 255, rng.integers(256)]))
    path.write_bytes(data)
    try:
        read_c3d(path)
    except FileFormatError:
        pass
assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < used + 100_000, "took 100 MB"
print("survived")
"""


def test_damage_neither_crashes_nor_takes_memory(tmp_path: Path, repository: Path) -> None:
    """In a process of its own, since the library underneath would take ours along."""
    write_c3d(tmp_path / "a.c3d", take())
    command = [sys.executable, "-c", DAMAGE, str(tmp_path / "a.c3d")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=repository, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout == "survived\n"
