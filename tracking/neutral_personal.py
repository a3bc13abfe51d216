"""A person's neutral face: found in a clip, kept in a file, used again."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.files import atomic_path
from ..heads.face_landmarks import NAMED_LANDMARKS
from ..heads.face_scores import SCORE_NAMES
from .face_fit import FittedFace
from .landmark_tracks import LandmarkSource, LandmarkTracks

Floats = NDArray[np.float64]
VERSION = 1
#: Frames that are taken for neutral, and how long the stretches are that they come from.
MOST_FRAMES, STRETCH_S = 8, 0.2
_FIELDS = ("amounts", "size", "offsets", "focal_px", "focal_sd_px", "n_frames")
#: How much each sign of not being neutral counts, in shares of the eyes' distance.
_MOTION, _TURNED, _MOUTH, _EYES, _BROWS = 3.0, 0.3, 3.0, 3.0, 0.5
#: Of the sum of the network's expression scores, gaze left out: they know what neutral faces look
#: like, but not this person's.
_SCORES = 0.2
#: Brows of unlike height and a mouth off the middle, likewise; and of a stretch that comes late.
_UNEVEN, _LATE, _EARLY_S = 1.0, 0.05, 1.0
_BROWS_OVER_EYES = ((105, 33), (334, 263))
_EXPRESSIVE = [
    i for i, name in enumerate(SCORE_NAMES) if not name.startswith(("_neutral", "eyeLook"))
]
_USUAL_SHARE = 70.0  # percentile of the lids' opening that is an open eye


def find_neutral_frames(
    tracks: LandmarkTracks, others: Sequence[LandmarkTracks] = ()
) -> NDArray[np.int64]:
    """Frames with lips closed, eyes open, both sides alike, the head to the front, little motion.

    Where several stretches are about as good, an early one: takes begin at rest more often than
    not.

    Parameters
    ----------
    tracks : LandmarkTracks
    others : sequence of LandmarkTracks
        What other cameras saw of the same face; each has its say.

    Returns
    -------
    (m,) int64
        Frames of `tracks`, in order: the stretch of `MOST_FRAMES` frames of one shot, or fewer,
        that is most neutral.

    Raises
    ------
    InputError
        If no frame shows a face.
    """
    cost = _shared_cost(tracks, others)
    if not np.isfinite(cost).any():
        raise InputError(
            "no frame shows a face that the network saw: no neutral face to start from"
        )
    best: tuple[float, NDArray[np.int64]] = (np.inf, np.zeros(0, np.int64))
    for shot in tracks.shots:
        for first in range(shot.start, max(shot.start + 1, shot.stop - MOST_FRAMES + 1)):
            frames = np.arange(first, min(first + MOST_FRAMES, shot.stop))
            frames = frames[np.isfinite(cost[frames])]
            if len(frames):
                # fewer frames tell less of the person
                here = float(cost[frames].mean() * np.sqrt(MOST_FRAMES / len(frames)))
                best = min(best, (here, frames), key=lambda found: found[0])
    return best[1]


def frames_around(tracks: LandmarkTracks, time_s: float) -> NDArray[np.int64]:
    """Frames with a face, of the same shot, around a time.

    Raises
    ------
    InputError
        If none has a face.
    """
    seen = np.flatnonzero(~tracks.is_missing)
    near = seen[np.abs(tracks.time_s[seen] - time_s) <= STRETCH_S]
    if not len(near):
        raise InputError(
            f"no face within {STRETCH_S:g} s of {time_s:.2f} s: choose another neutral time"
        )
    best = near[np.argmin(np.abs(tracks.time_s[near] - time_s))]
    shot = next(s for s in tracks.shots if s.start <= best < s.stop)
    near = near[(near >= shot.start) & (near < shot.stop)]
    nearest = np.argsort(np.abs(tracks.time_s[near] - time_s), kind="stable")[:MOST_FRAMES]
    return np.asarray(np.sort(near[nearest]))


def _shared_cost(tracks: LandmarkTracks, others: Sequence[LandmarkTracks]) -> Floats:
    """The mean cost of all cameras that saw the face, at the first one's frames."""
    t = tracks.time_s
    costs = [_cost(tracks)]
    for other in others:
        nearest = np.abs(other.time_s[None] - t[:, None]).argmin(axis=1)
        costs.append(_cost(other)[nearest])
    table = np.stack(costs)
    seen = np.isfinite(table)
    shared = np.where(seen, table, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    late = _LATE * (1 - np.exp(-(t - t[0]) / _EARLY_S))
    return np.asarray(np.where(seen[0], shared + late, np.nan))


def _cost(tracks: LandmarkTracks) -> Floats:
    """How far each frame is from neutral, (T,); NaN without a face."""
    p = tracks.points_px
    if np.isnan(p).all():
        return np.full(len(p), np.nan)
    at = {name: p[:, i] for name, i in NAMED_LANDMARKS.items()}

    def distance(a: str, b: str) -> Floats:
        return np.asarray(np.linalg.norm(at[a] - at[b], axis=1))

    eyes = distance("eye_right_outer", "eye_left_outer")
    mouth = distance("lip_upper_inner", "lip_lower_inner") / eyes
    width = distance("mouth_right", "mouth_left") / eyes
    lids = sum(distance(f"lid_{s}_upper", f"lid_{s}_lower") for s in ("right", "left")) / eyes
    one, two = (np.linalg.norm(p[:, a] - p[:, b], axis=1) / eyes for a, b in _BROWS_OVER_EYES)
    brows = one + two
    cost = np.where(tracks.is_missing, np.nan, 0.0)
    for share, size, rest in (
        (_MOUTH, mouth, 0.0),
        (_MOUTH, width, 50.0),
        (_EYES, lids, _USUAL_SHARE),
        (_BROWS, brows, 50.0),
        (_UNEVEN, np.abs(one - two), 0.0),
        (_UNEVEN, _mouth_aside(at), 0.0),
        (_TURNED, _turned(at), 0.0),
        (_MOTION, _motion(p, eyes), 0.0),
    ):
        if np.isfinite(size).any():  # marked points may lack some
            cost += share * abs(size - np.nanpercentile(size, rest))
    if tracks.scores is not None and np.isfinite(tracks.scores).any():
        total = tracks.scores[:, _EXPRESSIVE].sum(axis=1)
        cost += _SCORES * np.where(np.isnan(total), np.nanmax(total), total)
    unseen = (tracks.source != LandmarkSource.NETWORK) & (tracks.source != LandmarkSource.FOLLOWED)
    return np.asarray(np.where(unseen, np.nan, cost), dtype=np.float64)


def _turned(at: dict[str, Floats]) -> Floats:
    """How far the tip of the nose lies from the middle between the eyes, in their distance."""
    return np.abs(_along_eyes(at, at["nose_tip"], at["eye_right_outer"], at["eye_left_outer"]))


def _mouth_aside(at: dict[str, Floats]) -> Floats:
    """How far the mouth's middle lies from the nose along the line of the eyes, likewise."""
    return np.abs(_along_eyes(at, at["nose_tip"], at["mouth_right"], at["mouth_left"]))


def _along_eyes(at: dict[str, Floats], point: Floats, one: Floats, two: Floats) -> Floats:
    """A point's distance from the middle of two others along the eyes, in the eyes' distance."""
    across = at["eye_left_outer"] - at["eye_right_outer"]
    off = point - (one + two) / 2
    return np.asarray((off * across).sum(axis=1) / (across**2).sum(axis=1), dtype=np.float64)


def _motion(p: Floats, eyes: Floats) -> Floats:
    """Mean motion of the points from the frames before and after, in the eyes' distance."""
    step = np.linalg.norm(np.diff(p, axis=0), axis=2)
    step = np.nanmean(np.where(np.isnan(step), 0.0, step), axis=1)
    both = (
        np.concatenate([step[:1], np.maximum(step[1:], step[:-1]), step[-1:]]) if len(step) else 0
    )
    return np.asarray(both / eyes, dtype=np.float64)


def write_neutral(path: Path, face: FittedFace) -> None:
    """Write a person's neutral face as ``.npz``; `read_neutral` gives it back."""
    arrays = {name: np.asarray(getattr(face, name)) for name in _FIELDS}
    with atomic_path(path) as part, open(part, "wb") as stream:
        np.savez_compressed(stream, version=np.array(VERSION), **arrays)  # type: ignore[arg-type]


def read_neutral(path: Path) -> FittedFace:
    """Read a person's neutral face.

    Raises
    ------
    FileFormatError
        If it is none, or of another version.
    OSError
        If the file cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as z:
            missing = [n for n in ("version", *_FIELDS) if n not in z.files]
            if missing:
                raise FileFormatError(path, missing[0], "an array of a neutral face", "nothing")
            if int(z["version"]) != VERSION:
                raise FileFormatError(path, "version", str(VERSION), str(z["version"]))
            values = {name: np.asarray(z[name], dtype=np.float64) for name in _FIELDS}
    except (ValueError, zipfile.BadZipFile, EOFError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(path, "file", "a neutral face (.npz)", "another kind") from error
    for name, value in values.items():
        if not np.isfinite(value).all():
            raise FileFormatError(path, name, "finite numbers", "others")
    try:
        return FittedFace(
            values["amounts"], float(values["size"]), values["offsets"],
            float(values["focal_px"]), float(values["focal_sd_px"]), int(values["n_frames"]),
        )  # fmt: skip
    except (ValueError, TypeError) as error:
        raise FileFormatError(path, "file", "arrays of a neutral face", str(error)) from error
