from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.mpeg4 import fap_by_name
from facewright.datasets_synthetic.lid_motion import lid_layout
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.heads.raycast import RayScene
from facewright.retarget.drive import HeadDrive
from facewright.retarget.lid_edges import LidEdges, find_lid_edges
from facewright.retarget.lid_meeting import KNOTS, WIDEST, parts_of_way
from facewright.retarget.lid_points import lid_opening

Floats = NDArray[np.float64]
_STEP_MM = 0.03


def clip_mm(head: Head, **mm: float) -> Clip:
    values = [v / head.fapu.unit(fap_by_name()[n]) for n, v in mm.items()]
    return Clip(np.zeros(1), tuple(mm), np.array([values]))


@pytest.fixture(scope="module", params=[None, 101])
def driven(request: pytest.FixtureRequest, head: Head, drive: HeadDrive) -> HeadDrive:
    if request.param is None:
        return drive
    return HeadDrive(make_head(random_identity(np.random.default_rng(request.param))))


def depths(v: Floats, triangles: NDArray[np.int32], xs: Floats, ys: Floats) -> Floats:
    x, y = np.meshgrid(xs, ys, indexing="ij")
    start = np.stack([x.ravel(), y.ravel(), np.full(x.size, 300.0)], axis=1)
    t, *_ = RayScene(v, triangles).cast(start, np.tile([0.0, 0.0, -1.0], (x.size, 1)))
    return np.asarray(t.reshape(x.shape), dtype=np.float64)


def gaps_mm(head: Head, v: Floats, side: str) -> Floats:
    """Upper lid above lower lid in columns across the opening, mm; below 0 where they cross.

    Which skin is whose is told by the layout that moves synthetic actors, not by the drive.
    """
    layout, eye = lid_layout(side), head.eyes[side]
    sign = np.zeros(len(v))
    sign[layout.rows] = layout.sign
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    ball = head.mesh.triangles[head.mesh.groups[f"eye_{side}"]]
    columns, heights = lid_opening(head, skin, side)
    xs = columns[heights[:, 0] - heights[:, 1] > 1.0][::2]
    ys = np.arange(-0.8, 0.6, _STEP_MM / eye.radius) * eye.radius + eye.centre[1]
    upper = skin[(sign[skin] > 0).any(axis=1) & (sign[skin] >= 0).all(axis=1)]
    lower = skin[(sign[skin] < 0).any(axis=1) & (sign[skin] <= 0).all(axis=1)]
    before_ball = depths(v, ball, xs, ys)
    above, below = (depths(v, lid, xs, ys) < before_ball for lid in (upper, lower))
    assert above.any(axis=1).all() and below.any(axis=1).all()
    lowest = ys[np.argmax(above, axis=1)]
    highest = ys[len(ys) - 1 - np.argmax(below[:, ::-1], axis=1)]
    return np.asarray(lowest - highest)


@pytest.mark.parametrize("amount", [1.0, 1.7])
def test_lids_meet_and_do_not_cross_in_a_full_blink(driven: HeadDrive, amount: float) -> None:
    head = driven.head
    far = amount * head.fapu.irisd
    v = driven.animate(clip_mm(head, close_t_l_eyelid=far, close_t_r_eyelid=far)).vertices(0)
    for side in ("left", "right"):
        assert gaps_mm(head, head.mesh.vertices, side).max() > 6.0
        gaps = gaps_mm(head, v, side)
        assert gaps.max() <= 0.2, f"{gaps.max():.2f} mm apart"
        assert gaps[1:-1].min() >= -0.2, f"{-gaps[1:-1].min():.2f} mm across each other"
        assert gaps.min() >= -0.4  # in the last half millimetre before a corner


def test_lids_meet_wherever_their_parts_make_them(driven: HeadDrive) -> None:
    head = driven.head
    full = head.fapu.irisd
    lids = {"close_t_l_eyelid": 0.8 * full, "close_b_l_eyelid": 0.4 * full}
    gaps = gaps_mm(head, driven.animate(clip_mm(head, **lids)).vertices(0), "left")
    inner = gaps[2:-2]  # in the very corners less well: 0.5 mm at most, of 20 heads
    assert np.abs(inner).max() <= 0.2, f"{np.abs(inner).max():.2f} mm"
    assert np.abs(gaps).max() < 0.8


def test_half_closed_is_half_closed(driven: HeadDrive) -> None:
    head = driven.head
    rest = gaps_mm(head, head.mesh.vertices, "left")
    gap = float(find(head, "left").gap_mm(head.points["3.1"][0]))
    half = driven.animate(clip_mm(head, close_t_l_eyelid=gap / 2, close_t_r_eyelid=0.0)).vertices(0)
    # the press at the end of the way is part of it
    assert np.abs(gaps_mm(head, half, "left") - rest / 2)[2:-2].max() < 0.35


def find(head: Head, side: str) -> LidEdges:
    edges = find_lid_edges(head, head.mesh.triangles[head.mesh.groups["skin"]], side)
    assert edges is not None
    return edges


def test_edges_run_along_what_is_seen(driven: HeadDrive) -> None:
    head = driven.head
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    for side in ("left", "right"):
        edges = find(head, side)
        xs, heights = lid_opening(head, skin, side)
        assert not set(edges.upper) & set(edges.lower)
        for edge, column in ((edges.upper, 0), (edges.lower, 1)):
            at = head.mesh.vertices[edge]
            inside = (at[:, 0] > xs[3]) & (at[:, 0] < xs[-4])
            assert inside.sum() > 10
            off = at[inside, 1] - np.interp(at[inside, 0], xs, heights[:, column])
            assert np.abs(off).max() < 0.6, f"{np.abs(off).max():.2f} mm"


def test_closed_lids_stay_before_the_eyeball(driven: HeadDrive) -> None:
    """Also over the cornea of eyes that look up and down."""
    head = driven.head
    full = head.fapu.irisd
    shut = {"close_t_l_eyelid": full, "close_t_r_eyelid": full}
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    for pitch in (-25000.0, 0.0, 25000.0):
        clip = clip_mm(head, **shut)
        names = (*clip.channels, "pitch_l_eyeball", "pitch_r_eyeball")
        values = np.array([[*clip.values[0], pitch, pitch]])
        v = driven.animate(Clip(np.zeros(1), names, values)).vertices(0)
        for side in ("left", "right"):
            eye = head.eyes[side]
            xs = np.arange(-0.9, 0.9, 0.02) * eye.radius + eye.centre[0]
            ys = np.arange(-0.8, 0.8, 0.01) * eye.radius + eye.centre[1]
            ball = head.mesh.triangles[head.mesh.groups[f"eye_{side}"]]
            shows = depths(v, ball, xs, ys) < depths(v, skin, xs, ys)
            mm2 = shows.sum() * 0.0002 * eye.radius**2
            assert mm2 < 1.0, f"{mm2:.2f} mm² of the {side} eye at pitch {pitch:g}"


def test_points_of_the_lids_go_where_faps_say_at_all_parts(driven: HeadDrive) -> None:
    head = driven.head
    gap = float(find(head, "left").gap_mm(head.points["3.1"][0]))
    top = head.feature_points.select(("3.1",))
    rest = top.at(head.mesh.vertices)[0, 1]
    for part in (*KNOTS[:-1], 0.1, 0.6, -0.5):
        clip = clip_mm(head, close_t_l_eyelid=part * gap, close_t_r_eyelid=0.0)
        moved = top.at(driven.animate(clip).vertices(0))[0, 1] - rest
        assert moved == pytest.approx(-part * gap, abs=1e-6)


def test_parts_of_the_way_add_up_to_one_at_most() -> None:
    rng = np.random.default_rng(2)
    down, up = rng.uniform(-30, 30, (2, 500))
    d, u = parts_of_way(down, up, 8.0)
    assert (d + u <= 1 + 1e-9).all()
    assert (d >= -WIDEST).all() and (u >= -WIDEST).all()
    room = (np.maximum(down / 8, -WIDEST) + np.maximum(up / 8, -WIDEST)) <= 1
    np.testing.assert_allclose(d[room], np.maximum(down / 8, -WIDEST)[room], atol=1e-9)
    both = (down > 0) & (up > 0) & ~room
    assert both.any()
    np.testing.assert_allclose((d / u)[both], (down / up)[both], rtol=1e-6)
    # an open lower lid leaves the upper one further to go, and they meet all the same
    d, u = parts_of_way(np.array([20.0]), np.array([-2.0]), 8.0)
    assert d[0] + u[0] == pytest.approx(1.0)
