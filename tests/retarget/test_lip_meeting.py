from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.mpeg4 import fap_by_name
from facewright.datasets_synthetic.lip_motion import LipMotion
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.heads.own_head import read_own_head
from facewright.retarget.auxiliary_points import auxiliary_model
from facewright.retarget.deformer import FeaturePointDeformer
from facewright.retarget.drive import HeadDrive
from facewright.retarget.followers import Followers
from facewright.retarget.lip_meeting import LipMeeting, LipSeam
from facewright.retarget.lip_places import find_lip_places

Floats = NDArray[np.float64]
SMILE = {"raise_l_cornerlip": 7.0, "raise_r_cornerlip": 7.0}
SMILE |= {"stretch_l_cornerlip": 4.0, "stretch_r_cornerlip": 4.0}
BILABIAL = {n: 0.0 for n in ("lower_t_midlip", "raise_b_midlip", "lower_t_lip_lm")}
BILABIAL |= {n: 0.0 for n in ("lower_t_lip_rm", "raise_b_lip_lm", "raise_b_lip_rm")}
PRESSED = {n: 3.0 for n in BILABIAL}


def clip_mm(head: Head, mm: dict[str, float]) -> Clip:
    values = [v / head.fapu.unit(fap_by_name()[n]) for n, v in mm.items()]
    return Clip(np.zeros(1), tuple(mm), np.array([values]))


class Seamed:
    """A drive's points, with a seam put behind them."""

    def __init__(self, drive: HeadDrive) -> None:
        self.drive, self.head = drive, drive.head
        names = drive.deformer.points.names
        self.kept = [i for i, n in enumerate(names) if not n.startswith("lip.seam.")]
        points = drive.deformer.points.select(tuple(names[i] for i in self.kept))
        tables = tuple(t[:, self.kept].tocsr() for t in drive.deformer.tables)
        self.without = _led(drive.deformer.joined(points, tables))
        self.seam = LipSeam(drive.head, drive.deformer.joined(points, tables))
        self.deformer = _led(self.seam.deformer)

    def found(self, mm: dict[str, float]) -> Floats:
        told = self.drive.feature_point_displacements(clip_mm(self.head, mm))[:, self.kept]
        found = np.zeros((1, len(self.deformer.points), 3))
        found[:, : len(self.kept)] = told
        self.seam.close(found)
        return found

    def vertices(self, mm: dict[str, float], *, seam: bool = True) -> Floats:
        found, rest = self.found(mm)[0], self.head.mesh.vertices
        if seam:
            return np.asarray(rest + self.deformer.displace(found))
        return np.asarray(rest + self.without.displace(found[: len(self.kept)]))


def _led(deformer: FeaturePointDeformer) -> FeaturePointDeformer:
    return deformer.led(Followers.of(auxiliary_model(), deformer.points))


@pytest.fixture(scope="module", params=[None, 101])
def seamed(request: pytest.FixtureRequest, drive: HeadDrive) -> Seamed:
    if request.param is None:
        return Seamed(drive)
    return Seamed(HeadDrive(make_head(random_identity(np.random.default_rng(request.param)))))


def gap_and_crossing(head: Head, v: Floats) -> tuple[float, float]:
    """How much wider the mouth is open than at rest, and how much deeper lips lie in each other.

    By the heights that synthetic actors' lips are held by, at 39 stations across the mouth.
    """
    lips = LipMotion(head)
    opening0, room0 = (h[1:-1] for h in lips.heights(np.array(head.mesh.vertices)))
    opening, room = (h[1:-1] for h in lips.heights(v))
    gap = (opening - np.maximum(opening0, 0)).max()
    return float(gap), float((np.minimum(room0, 0) - room).max())


def test_closed_lips_stay_closed_in_a_smile(seamed: Seamed) -> None:
    smiling = BILABIAL | SMILE
    before, _ = gap_and_crossing(seamed.head, seamed.vertices(smiling, seam=False))
    gap, _ = gap_and_crossing(seamed.head, seamed.vertices(smiling))
    assert before > 0.4  # what there is to close
    assert gap < 0.2, f"{gap:.2f} mm"


def test_pressed_lips_do_not_pass_through_each_other(seamed: Seamed) -> None:
    _, before = gap_and_crossing(seamed.head, seamed.vertices(PRESSED, seam=False))
    gap, crossing = gap_and_crossing(seamed.head, seamed.vertices(PRESSED))
    assert crossing < 0.15 < before, f"{crossing:.2f} mm, without the seam {before:.2f} mm"
    assert gap < 0.2


def test_places_on_both_lips_move_alike_while_they_are_closed(seamed: Seamed) -> None:
    places = find_lip_places(seamed.head)
    assert places is not None
    assert len(places.x) > 12
    smiling = BILABIAL | SMILE
    corners = [seamed.head.points[n][0] for n in ("2.5", "2.4")]
    inner = (places.x > corners[0] + 4) & (places.x < corners[1] - 4)  # corners go by FAPs alone
    assert inner.sum() > 10
    for seam, most in ((False, 5.0), (True, 0.25)):
        moved = seamed.vertices(smiling, seam=seam) - seamed.head.mesh.vertices
        apart = (places.upper.at(moved) - places.lower.at(moved))[inner]
        assert np.abs(apart).max() < most
        assert seam or np.abs(apart).max() > 0.5


def test_lips_that_faps_hold_apart_go_their_own_way(seamed: Seamed) -> None:
    wide = {"open_jaw": 14.0, "raise_b_midlip": -13.0, "raise_b_lip_lm": -10.0}
    wide |= {"raise_b_lip_rm": -10.0, "lower_t_midlip": -2.0}
    found = seamed.found(wide)[0, len(seamed.kept) :]
    x = find_lip_places(seamed.head).x  # type: ignore[union-attr]
    middle = np.tile(np.abs(x) < 12, 2)
    assert middle.sum() >= 10
    np.testing.assert_array_equal(found[middle], 0.0)


def test_rest_is_rest(seamed: Seamed) -> None:
    assert np.abs(seamed.found({"open_jaw": 0.0})).max() < 1e-12


def test_no_fap_of_the_brows_parts_the_lips(seamed: Seamed) -> None:
    """What auxiliary points have learnt of whole faces must not open a closed mouth."""
    brows = {"raise_l_i_eyebrow": 9.0, "raise_r_i_eyebrow": 9.0, "raise_l_o_eyebrow": 9.0}
    gap, crossing = gap_and_crossing(seamed.head, seamed.vertices(brows))
    assert gap < 0.05
    assert crossing < 0.1


def test_corrections_stay_on_their_lips(seamed: Seamed) -> None:
    places = find_lip_places(seamed.head)
    assert places is not None
    v = seamed.head.mesh.vertices
    for spread, at in (
        (places.upper_spread, places.upper.at(v)),
        (places.lower_spread, places.lower.at(v)),
    ):
        total = np.asarray(spread.sum(axis=1)).ravel()
        assert total.min() >= 0 and total.max() < 1 + 1e-9
        moving = v[total > 0]
        nearest = np.linalg.norm(moving[:, None] - at, axis=2).min(axis=1)
        assert nearest.max() < 14.0
    both = (places.upper_spread.sum(axis=1) > 0) & (places.lower_spread.sum(axis=1) > 0)
    assert not np.asarray(both).any()


def test_lips_of_a_mask_without_an_opening_move_together(real_data: Path) -> None:
    head = read_own_head(real_data / "heads" / "canonical_face_model.obj").head
    pair = head.feature_points.select(("2.2", "2.3"))
    moves = np.random.default_rng(3).normal(size=(5, 2, 3))
    found = moves.copy()

    LipMeeting(head, pair, [("2.2", "2.3")]).meet(found)

    np.testing.assert_array_equal(found[:, 0], found[:, 1])
    np.testing.assert_allclose(found[:, 0], moves.mean(axis=1))
    drive = HeadDrive(head)
    assert LipSeam(head, drive.deformer).deformer is drive.deformer  # nothing to hold together
    clip = clip_mm(head, {"lower_t_midlip": -4.0, "raise_b_midlip": -6.0, "open_jaw": 8.0})
    moved = pair.at(drive.animate(clip).vertices(0)) - pair.at(head.mesh.vertices)
    assert np.abs(moved).max() > 0.5
    np.testing.assert_allclose(moved[0, 1], moved[1, 1], atol=1e-6)
