"""ARKit weights and FAPs by a fixed table, the same for all heads.

The table, ``heads/data/arkit_faps.csv``, is the project's own: the FAPs of the average built-in
head under each sculpted shape at weight 1, in units of that face (what is too small to be seen left
out; 30° a look). Since FAPs are relative to a face it serves all, roughly: `shape_solver` solves
for the head itself.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.formats.live_link_csv import ARKIT_SHAPES
from ..core.mpeg4 import ANGLE_UNIT_RAD, fap_table
from .arkit_table import DirectRow, direct_table
from .fap_rules import complete_faps

__all__ = ["DirectRow", "direct_faps", "direct_table", "direct_weights", "is_arkit"]

Floats = NDArray[np.float64]

#: Head rotations of an ARKit clip, rad, and the FAPs that say the same.
HEAD_TURNS = {"headPitch": "head_pitch", "headYaw": "head_yaw", "headRoll": "head_roll"}
_JAW = ("jawOpen", "mouthClose")
#: Beginnings of the names of shapes whose keys others move as well, but little.
_READ_FIRST = (
    "jawOpen", "mouthClose", "eyeLook", "jawLeft", "jawRight", "jawForward", "mouthLeft",
    "mouthRight", "mouthFunnel", "cheekSquint", "noseSneer",
)  # fmt: skip


def is_arkit(clip: Clip) -> bool:
    """Whether a clip holds ARKit weights."""
    return bool(set(clip.channels) & set(ARKIT_SHAPES))


def direct_faps(clip: Clip) -> Clip:
    """FAPs of ARKit weights, by the table.

    Parameters
    ----------
    clip : Clip
        ARKit weights; what is not set counts 0. Rotations of the head become FAPs 48 to 50.
        ``mouthClose`` counts up to ``jawOpen``, whose corrective it is.

    Returns
    -------
    Clip
        Every FAP of the table, so that 0 is said where nothing moves.

    Raises
    ------
    InputError
        If the clip holds no ARKit weight.
    """
    if not is_arkit(clip):
        shown = ", ".join(clip.channels[:5]) or "none"
        raise InputError(f"the clip has no ARKit weights; its channels are {shown}")
    names = [fap.name for fap in fap_table()]
    sums = {row.fap: np.zeros(len(clip.time_s)) for rows in direct_table().values() for row in rows}
    weights = {n: np.nan_to_num(clip[n]) for n in ARKIT_SHAPES if n in clip.channels}
    if set(_JAW) <= set(weights):
        weights["mouthClose"] = np.minimum(weights["mouthClose"], weights["jawOpen"])
    for shape, weight in weights.items():
        for row in direct_table()[shape]:
            sums[row.fap] = sums[row.fap] + row.amount * weight
    for channel, fap_name in HEAD_TURNS.items():
        if channel in clip.channels:
            sums[fap_name] = np.nan_to_num(clip[channel]) / ANGLE_UNIT_RAD
    channels = tuple(sorted(sums, key=names.index))
    return Clip(clip.time_s, channels, np.stack([sums[c] for c in channels], axis=1))


def direct_weights(clip: Clip) -> Clip:
    """ARKit weights of FAPs, by the table: each shape as far as all of its key FAPs agree.

    One shape after the other, first those of `_READ_FIRST`, then those with most keys; what a shape
    does is taken off the FAPs before the next is read, so that nothing counts twice.
    All weights are within [0, 1], and exactly 0 where all FAPs are.

    Parameters
    ----------
    clip : Clip
        Of FAPs; those that it does not give follow `complete_faps`.

    Returns
    -------
    Clip
        The shapes that the clip's FAPs tell of, and the head's rotations where it gives these.

    Raises
    ------
    InputError
        If the clip holds no FAP, or none that the table knows.
    """
    faps = dict(complete_faps(clip))
    found: dict[str, Floats] = {}
    for shape in _reading_order():
        keys = [row for row in direct_table()[shape] if row.is_key and row.fap in faps]
        if not keys:
            continue
        agreed = np.min([faps[row.fap] / row.amount for row in keys], axis=0)
        most = found.get("jawOpen", np.zeros_like(agreed)) if shape == "mouthClose" else 1.0
        found[shape] = np.clip(agreed, 0.0, most)
        for row in direct_table()[shape]:
            if row.fap in faps:
                faps[row.fap] = faps[row.fap] - row.amount * found[shape]
    for channel, fap_name in HEAD_TURNS.items():
        if fap_name in faps:
            found[channel] = faps[fap_name] * ANGLE_UNIT_RAD
    if not found:
        raise InputError("the clip's FAPs tell of none of ARKit's shapes: " + ", ".join(faps))
    return Clip(clip.time_s, tuple(found), np.stack(list(found.values()), axis=1))


@cache
def _reading_order() -> tuple[str, ...]:
    """The shapes that say most about FAPs first."""
    n_keys = {shape: sum(row.is_key for row in rows) for shape, rows in direct_table().items()}
    rank = {
        shape: next((i for i, stem in enumerate(_READ_FIRST) if shape.startswith(stem)), 99)
        for shape in ARKIT_SHAPES
    }
    return tuple(sorted(ARKIT_SHAPES, key=lambda shape: (rank[shape], -n_keys[shape])))
