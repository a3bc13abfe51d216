"""The same flashes in two videos: how bright frames are, and which flash is which."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.video import probe_video, read_frames
from .flashes import Flash, find_flashes
from .synchronise import ClockFit, synchronise_flash_light, synchronise_flashes

Floats = NDArray[np.float64]
#: Luma of black, and of what is as good as white (ITU-R BT.601 and BT.709: 16 to 235).
_LIMITED_LUMA, _FULL_LUMA = (16.0, 232.0), (0.0, 252.0)
_FULL_RANGE = ("gray", "rgb", "bgr", "gbr", "yuvj", "0rgb", "argb", "pal")
#: A rise of less than this share of the clearest flash is none.
_WEAK = 0.25
_SATURATED = 0.01
_MOST_FLASHES = 12
_DRIFT = 1e-4  # of clocks, for flashes that lie far apart


@dataclass(frozen=True, eq=False)
class Brightness:
    """How bright the frames of a video are on the whole.

    Attributes
    ----------
    time_s : (T,) float64, s
        From the first frame.
    light : (T,) float64
        Mean luma above black, as coded: linear in light if the camera wrote it so.
    saturated : (T,) float64, 0 to 1
        Share of the picture that is as good as white.
    """

    time_s: Floats
    light: Floats
    saturated: Floats


def frame_brightness(path: Path, *, on_frame: Callable[[int], None] | None = None) -> Brightness:
    """Look at all frames of a video.

    Raises
    ------
    FileFormatError
        If it is no video, or damaged.
    OSError
        If it cannot be read.
    """
    is_full = probe_video(path).pixel_format.startswith(_FULL_RANGE)
    black, white = _FULL_LUMA if is_full else _LIMITED_LUMA
    times, means, shares = [], [], []
    with closing(read_frames(path, gray=True)) as frames:
        for frame in frames:
            if on_frame is not None:
                on_frame(frame.index)
            times.append(frame.time_s)
            means.append(float(frame.image.mean()) - black)
            shares.append(float((frame.image >= white).mean()))
    return Brightness(np.array(times), np.maximum(np.array(means), 0.0), np.array(shares))


def clear_flashes(
    seen: Brightness, exposure_s: float = 0.0, *, whole: bool = False
) -> tuple[Flash, ...]:
    """The flashes of `find_flashes` that are not far weaker than the clearest.

    Parameters
    ----------
    seen : Brightness
    exposure_s : float, s
        0 if not known.
    whole : bool
        Their strength is needed, not only their beginning: none may saturate the picture.

    Raises
    ------
    InputError
        If nothing stands out; if `whole`, and a flash saturates more than 1 % of the picture.
    """
    found = find_flashes(seen.time_s, seen.light, exposure_s, most=_MOST_FLASHES)
    rises = [_rise(flash, seen.time_s, seen.light) for flash in found]
    clear = tuple(f for f, rise in zip(found, rises, strict=True) if rise >= _WEAK * max(rises))
    if whole:
        for flash in clear:
            share = _rise(flash, seen.time_s, seen.saturated)
            if share > _SATURATED:
                raise InputError(
                    f"the flash at {flash.time_s:.2f} s turns {100 * share:.0f} % of the picture "
                    "white: its light does not tell when it began; use --sync flash, or dim it"
                )
    return clear


def _rise(flash: Flash, time_s: Floats, values: Floats) -> float:
    """How much higher they are, from the frame before to the highest of the next few."""
    after = int(np.searchsorted(time_s, flash.earliest_s))
    before = values[max(after - 1, 0)]
    return float(values[after : after + 4].max(initial=before) - before)


def synchronise_by_flashes(
    reference: Sequence[Flash],
    other: Sequence[Flash],
    *,
    max_offset_s: float = 30.0,
    by_light: bool = False,
) -> ClockFit:
    """A clock from the flashes that two cameras have in common.

    Each offset that would bring one flash of the reference to one of the other is tried; that under
    which most flashes meet is taken.

    Parameters
    ----------
    reference, other : sequence of Flash
        Of `find_flashes`, in order.
    max_offset_s : float
    by_light : bool
        Use how far each flash has died away in each camera's frames (`synchronise_flash_light`):
        far surer between frames, but only for light that brightens both pictures alike.

    Raises
    ------
    InputError
        If none fit within the largest offset, or different offsets fit equally well.
    """
    pairs = _pairs(reference, other, max_offset_s)
    a, b = [reference[i] for i, _ in pairs], [other[j] for _, j in pairs]
    if not by_light:
        return synchronise_flashes(
            [f.time_s for f in a],
            [f.time_s for f in b],
            reference_sd_s=[f.sd_s for f in a],
            other_sd_s=[f.sd_s for f in b],
        )
    fits = [synchronise_flash_light(x, y) for x, y in zip(a, b, strict=True)]
    if len(fits) == 1:
        return fits[0]
    times = [f.time_s for f in a]
    late = [t + fit.offset_s for t, fit in zip(times, fits, strict=True)]
    none = [0.0] * len(times)
    sds = [fit.offset_sd_s for fit in fits]
    return synchronise_flashes(times, late, reference_sd_s=none, other_sd_s=sds)


def _pairs(
    reference: Sequence[Flash], other: Sequence[Flash], max_offset_s: float
) -> list[tuple[int, int]]:
    """Indices of the flashes that meet under the offset that lets most meet."""
    trials = []
    for a in reference:
        for b in other:
            offset = b.time_s - a.time_s
            if abs(offset) <= max_offset_s:
                trials.append((offset, _meeting(reference, other, offset)))
    if not trials:
        raise InputError(
            f"no flash of one lies within {max_offset_s:g} s of one of the other: was it seen by "
            "both? else say how far apart they began with --max-offset"
        )
    most = max(len(pairs) for _, pairs in trials)
    best = [trial for trial in trials if len(trial[1]) == most]
    chosen = min(best, key=lambda trial: _misfit(reference, other, trial[1]))
    width = max(f.latest_s - f.earliest_s for f in (*reference, *other))
    rivals = [offset for offset, _ in best if abs(offset - chosen[0]) > 2 * width]
    if rivals:
        raise InputError(
            f"the flashes fit at an offset of {chosen[0]:.3f} s as well as at {rivals[0]:.3f} s: "
            "say how far apart the videos can have begun with --max-offset, or flash unevenly"
        )
    return chosen[1]


def _meeting(
    reference: Sequence[Flash], other: Sequence[Flash], offset: float
) -> list[tuple[int, int]]:
    """Flashes that may have been the same, each once, in order."""
    pairs: list[tuple[int, int]] = []
    free = set(range(len(other)))
    for i, a in enumerate(reference):
        slack = _DRIFT * abs(a.time_s - reference[0].time_s)
        near = [
            j
            for j in free
            if a.earliest_s + offset - slack <= other[j].latest_s
            and other[j].earliest_s <= a.latest_s + offset + slack
        ]
        if near:
            j = min(near, key=lambda k: abs(other[k].time_s - a.time_s - offset))
            free.discard(j)
            pairs.append((i, j))
    return pairs


def _misfit(
    reference: Sequence[Flash], other: Sequence[Flash], pairs: Sequence[tuple[int, int]]
) -> float:
    lags = np.array([other[j].time_s - reference[i].time_s for i, j in pairs])
    return float(np.ptp(lags))
