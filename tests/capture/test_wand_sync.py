"""Clocks from a wand: known offsets, noise, either way round, and what cannot be told."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.capture.wand_sync import synchronise_wand
from facewright.capture.wand_track import WandTrack
from facewright.core.errors import InputError
from facewright.datasets_synthetic.rigs import face_rig
from facewright.datasets_synthetic.wand import Wand

RIG = face_rig(np.random.default_rng(3), n_cameras=4)
FRAME_S = 1 / 30


def tracks(
    seed: int, offset_s: float, *, picked: tuple[int, ...] = (0, 1, 2), seconds: float = 5.0
) -> tuple[WandTrack, WandTrack]:
    """Two cameras' videos; the second one's clock shows `offset_s` at the first's 0."""
    rng = np.random.default_rng(seed)
    wand = Wand.random(rng)
    found = []
    for name, late in (("cam0", 0.0), ("cam3", offset_s)):
        t = np.asarray(np.arange(round(seconds / FRAME_S)) * FRAME_S, dtype=np.float64)
        balls = np.stack([wand.balls(float(x - late)) for x in t])[:, list(picked)]
        uv = RIG[name].project(balls) + rng.normal(0, 0.1, (*balls.shape[:2], 2))
        if len(picked) == 2:
            turned = rng.random(len(uv)) < 0.5
            uv[turned] = uv[turned][:, ::-1]
        uv[rng.random(len(uv)) < 0.05] = np.nan
        found.append(WandTrack(t, uv, np.full(uv.shape[:2], 0.1)))
    return found[0], found[1]


@pytest.mark.parametrize("offset_s", [0.0, 0.2137, -0.4041])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_offset_is_found_to_a_twentieth_of_a_frame(seed: int, offset_s: float) -> None:
    clock = synchronise_wand(*tracks(seed, offset_s), RIG["cam0"], RIG["cam3"], max_offset_s=1.0)

    assert clock.offset_s == pytest.approx(offset_s, abs=0.05 * FRAME_S)
    assert clock.other_s(2.0) == pytest.approx(2.0 + offset_s, abs=0.05 * FRAME_S)
    assert abs(clock.offset_s - offset_s) < 6 * clock.offset_sd_s < 0.2 * FRAME_S


@pytest.mark.parametrize("offset_s", [0.2137, -0.4041])
def test_wands_that_lie_either_way_round_tell_the_offset(offset_s: float) -> None:
    pair = tracks(1, offset_s, picked=(0, 2))

    clock = synchronise_wand(*pair, RIG["cam0"], RIG["cam3"], symmetric=True, max_offset_s=1.0)

    assert clock.offset_s == pytest.approx(offset_s, abs=0.25 * FRAME_S)


def test_what_does_not_overlap_is_told() -> None:
    with pytest.raises(InputError, match="show the wand at the same time"):
        synchronise_wand(*tracks(1, 0.0, seconds=0.5), RIG["cam0"], RIG["cam3"])


def test_a_wand_at_rest_tells_nothing() -> None:
    a, b = tracks(1, 0.0)
    at = np.flatnonzero(a.is_seen & b.is_seen)[0]
    still = [
        WandTrack(t.time_s, np.tile(t.pixels[at], (len(t.time_s), 1, 1)), t.sd) for t in (a, b)
    ]

    with pytest.raises(InputError, match="hardly moves"):
        synchronise_wand(still[0], still[1], RIG["cam0"], RIG["cam3"], max_offset_s=1.0)


def test_other_motions_tell_nothing() -> None:
    with pytest.raises(InputError, match="fit about as well"):
        synchronise_wand(
            tracks(1, 0.0)[0], tracks(2, 0.0)[1], RIG["cam0"], RIG["cam3"], max_offset_s=1.0
        )
