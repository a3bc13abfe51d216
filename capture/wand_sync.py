"""How two cameras' clocks differ, from a waved wand that both saw.

At the right offset the balls' pictures lie on each other's epipolar lines, whatever the cameras'
places: x_b' E x_a = 0 for one matrix E. The offset at which such a matrix fits best is sharp, since
nothing but noise is left there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ..core.camera import Camera
from ..core.errors import InputError
from .synchronise import ClockFit
from .wand_track import WandTrack, at_times

Floats = NDArray[np.float64]
_LEAST_FRAMES = 25
#: The search's steps; balls lie off their lines by some pixels there, not by some tens.
_STEP_FRAMES = 0.5
#: Elsewhere the misfit must be so many times larger, or the offset is not known.
_CLEARER = 3.0
_ELSEWHERE_FRAMES = 3.0
_LEAST_MOTION_PX = 20.0
_LEAST_OVERLAP = 0.25  # of the shorter recording


def synchronise_wand(
    reference: WandTrack,
    other: WandTrack,
    reference_lens: Camera,
    other_lens: Camera,
    *,
    symmetric: bool = False,
    max_offset_s: float = 5.0,
) -> ClockFit:
    """The offset of a camera's clock against a reference's, from a wand in both videos.

    Parameters
    ----------
    reference, other : WandTrack
    reference_lens, other_lens : Camera
        Poses do not matter.
    symmetric : bool
        The order of the balls is not known.
    max_offset_s : float
        So far apart at most the videos began.

    Raises
    ------
    InputError
        If both do not show the wand move for long enough, or several offsets fit about as well.
    """
    step = float(np.median(np.diff(reference.time_s)))
    for track in (reference, other):
        _check_motion(track)
    if symmetric:
        reference, other = _middle(reference), _middle(other)
    xa = _conditioned(reference_lens.undistort(reference.pixels))
    waved = replace(other, pixels=_conditioned(other_lens.undistort(other.pixels)))
    least = max(
        _LEAST_FRAMES,
        _LEAST_OVERLAP * min(int(reference.is_seen.sum()), int(other.is_seen.sum())),
    )

    def misfit(offset: float) -> float:
        xb, _ = at_times(waved, reference.time_s + offset)
        return _epipolar_misfit(xa, xb, least)

    offsets = np.arange(-max_offset_s, max_offset_s + step, _STEP_FRAMES * step)
    scores = np.array([misfit(o) for o in offsets])
    if not np.isfinite(scores).any():
        raise InputError(
            f"fewer than {int(least)} frames of both show the wand at the same time, within "
            f"{max_offset_s:.3g} s"
        )
    centre = float(offsets[int(np.argmin(scores))])
    bounds = (centre - step, centre + step)
    fine = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-7})
    best, offset = float(fine.fun), float(fine.x)
    far = scores[np.abs(offsets - centre) > _ELSEWHERE_FRAMES * step]
    if len(far) and not far.min() > _CLEARER * best:
        rival = offsets[np.abs(offsets - centre) > _ELSEWHERE_FRAMES * step][int(np.argmin(far))]
        raise InputError(
            f"the wand's motions fit about as well at {rival:.2f} s as at {offset:.2f} s: wave it "
            "for longer, and turn it more"
        )
    h = step / 20
    curvature = (misfit(offset + h) - 2 * best + misfit(offset - h)) / h**2
    n = int((np.isfinite(at_times(waved, reference.time_s + offset)[0][:, 0, 0])).sum())
    count = n * reference.pixels.shape[1]
    sd = float(np.sqrt(2 * best / curvature / count)) if curvature > 0 else float("nan")
    return ClockFit(offset, 0.0, sd, float("inf"), n, len(reference.time_s), "wand")


def _check_motion(track: WandTrack) -> None:
    if not track.is_seen.any():
        raise InputError("no frame of one of the videos shows the wand")
    moved = float(np.ptp(track.pixels[track.is_seen], axis=0).max())
    if moved < _LEAST_MOTION_PX:
        raise InputError(f"the wand hardly moves ({moved:.1f} px): wave it")


def _middle(track: WandTrack) -> WandTrack:
    """The balls' middle alone: what does not depend on which end is which, nearly."""
    middle = track.pixels.mean(axis=1, keepdims=True)
    return replace(track, pixels=middle, sd=track.sd.mean(axis=1, keepdims=True))


def _conditioned(xy: Floats) -> Floats:
    """About their middle, in units of their spread (Hartley 1997)."""
    known = xy[np.isfinite(xy).all(axis=-1)]
    if not len(known):
        return xy
    return np.asarray((xy - known.mean(axis=0)) / max(float(known.std()), 1e-12))


def _epipolar_misfit(xa: Floats, xb: Floats, least: float) -> float:
    """Mean square of what the best matrix leaves; infinite for too few shared frames."""
    both = np.isfinite(xa[..., 0]) & np.isfinite(xb[..., 0])
    if both.any(axis=1).sum() < least:
        return float("inf")
    a, b = (np.column_stack([x[both], np.ones(int(both.sum()))]) for x in (xa, xb))
    products = (b[:, :, None] * a[:, None]).reshape(-1, 9)
    return float(np.linalg.eigvalsh(products.T @ products)[0] / len(products))
