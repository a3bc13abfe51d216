"""Clips of one kind as clips of another: FAPs, ARKit weights, weights of a head's own shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.formats.live_link_csv import CHANNELS
from ..core.mpeg4 import ANGLE_UNIT_RAD, fap_channels
from ..heads.head import Head
from .arkit import HEAD_TURNS, direct_faps, direct_weights, is_arkit
from .shape_names import understand_shapes
from .shape_solver import ShapeDrive, weights_to_faps

#: Rotations of the eyes in an ARKit clip, rad, and the FAPs that say the same.
EYE_TURNS = {
    "leftEyeYaw": "yaw_l_eyeball",
    "leftEyePitch": "pitch_l_eyeball",
    "rightEyeYaw": "yaw_r_eyeball",
    "rightEyePitch": "pitch_r_eyeball",
}
_MAX_SHOWN = 5


def clip_kind(clip: Clip, head: Head | None = None) -> str:
    """``"faps"``, ``"arkit"``, or ``"shapes"``: names of the head's own shapes.

    Raises
    ------
    InputError
        If no channel is any of these.
    """
    if _sets_any(clip, fap_channels()):
        return "faps"
    if is_arkit(clip) or _sets_any(clip, CHANNELS):
        return "arkit"
    if head is not None and _sets_any(clip, head.shape_names):
        return "shapes"
    shown = ", ".join(clip.channels[:_MAX_SHOWN]) + (" ..." if len(clip.channels) > 5 else "")
    whose = "" if head is None else f" or shape of head {head.name}"
    raise InputError(
        f"the clip has no FAP, ARKit weight{whose} that is set; its channels are {shown or 'none'}"
    )


def has_known_shapes(head: Head | None) -> bool:
    """Whether a head has shapes whose names say what they are."""
    if head is None or head.shapes is None or not head.shape_names:
        return False
    meanings = understand_shapes(head.shape_names).meanings.values()
    return any(meaning.kind in ("arkit", "side", "pose") for meaning in meanings)


def faps_of(clip: Clip, head: Head | None, *, direct: bool = False) -> Clip:
    """A clip as FAPs: as it is, else by what a head's shapes do to its feature points.

    Parameters
    ----------
    clip : Clip
        Of FAPs, ARKit weights or weights of the head's own shapes.
    head : Head or None
        None, or one without shapes that are understood: ARKit weights go by the fixed table.
    direct : bool
        By the fixed table in any case.

    Raises
    ------
    InputError
        If no channel is known, or only to a head that is not there.
    """
    kind = clip_kind(clip, head)
    if kind == "faps":
        return _only(clip, fap_channels())
    if kind == "arkit" and (direct or not has_known_shapes(head)):
        return direct_faps(clip)
    assert head is not None
    return _with_eye_turns(weights_to_faps(ShapeDrive(head).jacobian, clip), clip)


def arkit_of(clip: Clip, head: Head | None, *, direct: bool = False) -> Clip:
    """A clip as ARKit weights and rotations: as it is, else solved for a head's shapes.

    Parameters
    ----------
    clip : Clip
        As in `faps_of`.
    head : Head or None
        None, or one without shapes: FAPs go by the fixed table.
    direct : bool
        By the fixed table in any case.

    Raises
    ------
    InputError
        If no channel is known.
    """
    kind = clip_kind(clip, head)
    if kind == "arkit":
        return _only(clip, CHANNELS)
    if kind == "faps" and (direct or not has_known_shapes(head)):
        weights = direct_weights(clip)
    else:
        assert head is not None
        weights = ShapeDrive(head).weights(clip).arkit_clip()
    return _with_turns(weights, clip)


def _with_eye_turns(faps: Clip, arkit: Clip) -> Clip:
    """FAPs with rotations of the eyes where an ARKit clip gives these: they are exact."""
    values = {c: faps[c] for c in faps.channels}
    for turn, name in EYE_TURNS.items():
        if turn in arkit.channels and np.nan_to_num(arkit[turn]).any():
            values[name] = arkit[turn] / ANGLE_UNIT_RAD
    return _clip(faps.time_s, values)


def _with_turns(weights: Clip, faps: Clip) -> Clip:
    values = {c: weights[c] for c in weights.channels}
    for turn, name in {**HEAD_TURNS, **EYE_TURNS}.items():
        if name in faps.channels and turn not in values:
            values[turn] = faps[name] * ANGLE_UNIT_RAD
    return _clip(weights.time_s, values)


def _sets_any(clip: Clip, names: tuple[str, ...]) -> bool:
    return any(c in names and not np.isnan(clip[c]).all() for c in clip.channels)


def _only(clip: Clip, names: tuple[str, ...]) -> Clip:
    return _clip(clip.time_s, {c: clip[c] for c in names if c in clip.channels})


def _clip(time_s: NDArray[np.float64], values: dict[str, NDArray[np.float64]]) -> Clip:
    return Clip(time_s, tuple(values), np.stack(list(values.values()), axis=1))
