from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.errors import FileFormatError, InputError
from facewright.core.fat import FacialTables, FapTable
from facewright.core.formats.fat_npz import read_fat_npz, write_fat_npz
from facewright.core.mpeg4 import fap_table
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.retarget.drive import HeadDrive
from facewright.retarget.fat import FacialAnimationTable, build_fat, superposition_error
from facewright.retarget.fat_carried import CARRIED
from facewright.retarget.fat_pieces import few_pieces
from facewright.retarget.limits import FapRange, HeadLimits

BOUND_MM = 0.1
SOME = (
    "open_jaw", "raise_b_midlip", "lower_t_midlip", "stretch_l_cornerlip", "close_t_l_eyelid",
    "close_b_l_eyelid", "yaw_l_eyeball", "raise_l_i_eyebrow", "thrust_tongue_tip",
)  # fmt: skip
ALL = tuple(f.name for f in fap_table()[2:])


@pytest.fixture(scope="module")
def fat(drive: HeadDrive) -> FacialAnimationTable:
    return build_fat(drive, max_error_mm=BOUND_MM, faps=SOME)


def every_fap(**values: float) -> Clip:
    """One frame that gives all FAPs, so that no rule fills any in."""
    return Clip(np.zeros(1), ALL, np.array([[values.get(n, 0.0) for n in ALL]]))


def off_mm(fat: FacialAnimationTable, drive: HeadDrive, **values: float) -> float:
    wanted = drive.animate(every_fap(**values)).vertices(0)
    return float(np.linalg.norm(fat.vertices(values) - wanted, axis=1).max())


@pytest.mark.parametrize("fap", SOME)
def test_one_fap_is_within_the_bound_at_knots_and_between(
    fap: str, fat: FacialAnimationTable, drive: HeadDrive
) -> None:
    table = fat.tables.of(fap)
    assert table is not None
    rng = np.random.default_rng(11)
    k = table.knots
    values = [
        *k,
        *(k[:-1] + 0.5 * np.diff(k)),
        *rng.uniform(k[0], k[-1], 6),
        1.3 * k[0],
        1.3 * k[-1],
    ]
    worst = max(off_mm(fat, drive, **{fap: float(v)}) for v in values)
    assert worst < BOUND_MM, f"{worst:.3f} mm"
    assert max(off_mm(fat, drive, **{fap: float(v)}) for v in k) < 0.1 * BOUND_MM + 1e-4


def test_a_tighter_bound_takes_more_pieces(drive: HeadDrive, fat: FacialAnimationTable) -> None:
    fine = build_fat(drive, max_error_mm=BOUND_MM / 16, faps=("yaw_l_eyeball",))
    a, b = fat.tables.of("yaw_l_eyeball"), fine.tables.of("yaw_l_eyeball")
    assert a is not None and b is not None
    # a chord of an arc is off by its angle squared: a quarter of the length, four times as many
    assert b.n_intervals / a.n_intervals == pytest.approx(4.0, rel=0.35)


def test_pieces_of_a_circle_are_as_few_as_a_circle_needs() -> None:
    radius, bound = 10.0, 0.05

    def curve(values: NDArray[np.float64]) -> NDArray[np.float64]:
        a = values / 1000
        flat = np.zeros((len(values), 3))
        moved = radius * np.stack([np.sin(a), np.cos(a) - 1, 0 * a], axis=1)
        return np.stack([flat, moved], axis=1)

    table = few_pieces("open_jaw", curve, FapRange(-1000.0, 1000.0), bound)

    assert table is not None
    np.testing.assert_array_equal(table.vertices, [1])
    at_best = 2 * np.arccos(1 - bound / radius)  # the angle whose chord is off by the bound
    assert np.ceil(2.0 / at_best) <= table.n_intervals <= 1.35 * 2.0 / at_best + 2
    dense = np.linspace(-1000, 1000, 2001)
    found = np.stack([table.at(v)[0] for v in dense])
    assert np.linalg.norm(found - curve(dense)[:, 1], axis=1).max() < bound


def test_what_is_straight_needs_one_piece_a_side() -> None:
    table = few_pieces(
        "open_jaw", lambda v: v[:, None, None] * np.ones((1, 2, 3)), FapRange(-3.0, 5.0), 0.01
    )
    assert table is not None
    np.testing.assert_array_equal(table.knots, [-3.0, 0.0, 5.0])


def test_what_moves_nothing_has_no_table() -> None:
    assert few_pieces("open_jaw", lambda v: np.zeros((len(v), 4, 3)), FapRange(0, 9.0), 0.1) is None


def test_animation_and_single_frames_agree(fat: FacialAnimationTable) -> None:
    rng = np.random.default_rng(3)
    values = rng.uniform(-300, 300, (4, len(SOME)))
    full = np.zeros((4, len(ALL)))
    full[:, [ALL.index(n) for n in SOME]] = values
    animation = fat.animate(Clip(np.arange(4) / 25, ALL, full))
    for i in range(4):
        one = fat.vertices(dict(zip(SOME, values[i], strict=True)))
        np.testing.assert_allclose(animation.vertices(i), one, atol=1e-6)


def test_faps_in_separate_places_superpose_exactly(
    fat: FacialAnimationTable, drive: HeadDrive
) -> None:
    values = {"open_jaw": 500.0, "raise_l_i_eyebrow": 60.0, "yaw_l_eyeball": 20000.0}
    assert off_mm(fat, drive, **values) < len(values) * BOUND_MM


@pytest.mark.parametrize(
    ("fap", "value", "part", "alone_mm"),
    [
        ("raise_tongue_tip", 150.0, "tongue", 3.0),
        ("thrust_tongue_tip", 200.0, "tongue", 3.0),
        ("thrust_jaw", 120.0, "teeth_lower", 3.0),
        ("depress_chin", -120.0, "skin", 1.0),
    ],
)
def test_what_the_jaw_carries_is_counted_once(
    fap: str, value: float, part: str, alone_mm: float, drive: HeadDrive
) -> None:
    """These FAPs say where a point is in the head, however far the jaw is open."""
    fat = build_fat(drive, max_error_mm=BOUND_MM, faps=("open_jaw", fap))
    values = {"open_jaw": 700.0, fap: value}
    rows = drive.head.part_vertices(part)
    wanted = drive.animate(every_fap(**values)).vertices(0)[rows]

    off = np.linalg.norm(fat.vertices(values)[rows] - wanted, axis=1)
    open_jaw, own = fat.tables.of("open_jaw"), fat.tables.of(fap)
    assert open_jaw is not None and own is not None
    added = drive.head.mesh.vertices.copy()
    for table in (open_jaw, own):
        added[table.vertices] += table.at(values[table.fap])
    twice = np.linalg.norm(added[rows] - wanted, axis=1)

    assert off.max() < 2 * BOUND_MM, f"{off.max():.3f} mm"
    assert twice.max() > alone_mm, "simply added up, the jaw would count twice"
    animation = fat.animate(every_fap(**values)).vertices(0)[rows]
    np.testing.assert_allclose(animation, fat.vertices(values)[rows], atol=1e-6)


def test_the_knots_sums_are_the_matrixs(fat: FacialAnimationTable) -> None:
    """Exporters take the matrix, frames the sums."""
    d = fat.animate(every_fap(open_jaw=1.0)).deformer
    moves = np.random.default_rng(4).normal(size=(3, len(d.points), 3))
    moves[:, ::2] = 0.0
    moved = d.displace(moves)
    wanted = (d.matrix @ moves.reshape(3, -1).T).T.reshape(moved.shape)
    np.testing.assert_allclose(moved, wanted, atol=1e-9)
    np.testing.assert_array_equal(d.displace(moves[1]), moved[1])
    with pytest.raises(ValueError, match="displacements must have shape"):
        d.displace(moves[:, :2])


def test_counts_of_knots_are_interpolations(fat: FacialAnimationTable) -> None:
    rng = np.random.default_rng(9)
    values = rng.uniform(-3000, 3000, (40, len(SOME)))
    values[:4] = [[0.0], [1e9], [-1e9], [1.0]]
    full = np.zeros((40, len(ALL)))
    for i, name in enumerate(SOME):
        full[:] = 0.0
        full[:, ALL.index(name)] = values[:, i]
        table = fat.tables.of(name)
        assert table is not None
        animation = fat.animate(Clip(np.arange(40) / 25, ALL, full))
        own = [n.rpartition(".")[0] == name for n in animation.point_names]
        asked = values[:, i]
        if name in CARRIED:
            asked = HeadLimits(fat.head, says=False).bent({name: asked})[name]
        wanted = table.weights(asked)[:, table.knots != 0]
        np.testing.assert_allclose(animation.displacements[:, own, 0], wanted, atol=1e-9)
        assert not animation.displacements[:, ~np.array(own)].any()


def test_what_superposition_costs_is_told(fat: FacialAnimationTable, drive: HeadDrive) -> None:
    """Upper and lower lid know nothing of each other: that is told, and is no more than it is."""
    lids = {"close_t_l_eyelid": 900.0, "close_b_l_eyelid": 500.0}
    found = superposition_error(fat, drive, every_fap(**lids))
    assert found.max_mm[0] == pytest.approx(off_mm(fat, drive, **lids), abs=1e-6)
    assert found.max_mm[0] > 1.0 > found.rms_mm[0]
    alone = superposition_error(fat, drive, every_fap(close_t_l_eyelid=900.0))
    assert alone.max_mm[0] < BOUND_MM


def test_the_head_turns_as_with_the_drive(fat: FacialAnimationTable, drive: HeadDrive) -> None:
    clip = every_fap(head_yaw=40000.0, head_pitch=9000.0, open_jaw=100.0)
    a, b = fat.animate(clip).motion, drive.animate(clip).motion
    np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-12)
    np.testing.assert_allclose(a.translation, b.translation, atol=1e-9)


def test_tables_read_back_to_the_last_bit(
    fat: FacialAnimationTable, head: Head, tmp_path: Path
) -> None:
    path = tmp_path / "head.fat.npz"
    write_fat_npz(path, fat.tables)
    found = read_fat_npz(path)
    assert found.max_error_mm == fat.tables.max_error_mm
    np.testing.assert_array_equal(found.rest, fat.tables.rest)
    for a, b in zip(found.tables, fat.tables.tables, strict=True):
        assert a.fap == b.fap
        for name in ("knots", "vertices", "offsets"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    again = FacialAnimationTable(head, found)
    values = {"open_jaw": 321.0}
    np.testing.assert_array_equal(again.vertices(values), fat.vertices(values))


def test_tables_of_another_head_are_refused(fat: FacialAnimationTable) -> None:
    other = make_head(random_identity(np.random.default_rng(8)))
    with pytest.raises(InputError, match="another mesh"):
        FacialAnimationTable(other, fat.tables)


def small() -> FacialTables:
    one = FapTable(
        "open_jaw", np.array([0.0, 9.0]), np.array([0, 2], np.int32),
        np.array([[[0, 0, 0]] * 2, [[0, -1, 0]] * 2], np.float32),
    )  # fmt: skip
    return FacialTables(np.zeros((3, 3), np.float32), 0.1, (one,))


@pytest.mark.parametrize(
    ("member", "value", "said"),
    [
        ("version", np.int64(2), "version"),
        ("n_knots", np.array([3]), "knots"),
        ("n_vertices", np.array([-1]), "n_vertices"),
        ("n_vertices", np.array([2**40]), "n_vertices"),
        ("faps", np.array(["yawn"]), "no FAP 'yawn'"),
        ("vertices", np.array([0, 3], np.int32), "moves vertex 3"),
        ("vertices", np.array([2, 0], np.int32), "must increase"),
        ("knots", np.array([0.0, np.nan]), "knots of open_jaw"),
        ("knots", np.array([1.0, 9.0]), "a knot at 0"),
        ("offsets", np.full((4, 3), np.nan, np.float32), "finite"),
        ("rest", np.zeros((3, 2), np.float32), "rest must have shape"),
        ("max_error_mm", np.float64(0.0), "max_error_mm"),
    ],
)
def test_bad_archives_are_told(member: str, value: object, said: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    write_fat_npz(path, small())
    with np.load(path) as archive:
        members = {name: archive[name] for name in archive.files}
    members[member] = value
    np.savez(path, **members)
    with pytest.raises(FileFormatError, match=said):
        read_fat_npz(path)


def test_truncated_empty_and_pickled_files_are_told(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    write_fat_npz(path, small())
    data = path.read_bytes()
    for bad in (b"", data[: len(data) // 2], b"PK\x03\x04" + b"junk" * 30):
        path.write_bytes(bad)
        with pytest.raises(FileFormatError):
            read_fat_npz(path)
    np.savez(path, version=np.array([object()], dtype=object))
    with pytest.raises(FileFormatError):
        read_fat_npz(path)


def test_wrong_calls_are_told(drive: HeadDrive) -> None:
    with pytest.raises(ValueError, match="above 0"):
        build_fat(drive, max_error_mm=0.0)
    with pytest.raises(ValueError, match="head_yaw"):
        build_fat(drive, faps=("head_yaw",))
