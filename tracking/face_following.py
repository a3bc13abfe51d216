"""From an ordinary video to a face's landmarks over time.

The network sees the face in each frame; flow between neighbouring frames and patches of a
reference frame are measured in rectified pictures; a filter joins them. ::

    tracks = track_landmarks(Path("clip.mp4"))
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.video import Frame, read_frames
from ..heads.face_finder import FaceFinder, FoundFace
from ..heads.face_landmarks import N_LANDMARKS
from ..heads.face_scores import SCORE_NAMES
from .face_measuring import LONGEST_BRIDGE_S, FacePiece, measure_pieces
from .face_sightings import FaceSightings, sight_face
from .iris_fit import IRISES
from .landmark_filter import filter_landmarks
from .landmark_tracks import LandmarkSource, LandmarkTracks

Floats = NDArray[np.float64]

_UNCERTAIN_TIMES = 4.0  # for the stated deviation of what may be hidden


def track_landmarks(
    video: Path | Sequence[Frame], *, finder: FaceFinder | None = None, face: int = 0
) -> LandmarkTracks:
    """The landmarks of one face through a video.

    The video is read twice: by the network, and for flow and templates.

    Parameters
    ----------
    video : Path or sequence of Frame, RGB
    finder : FaceFinder, optional
    face : int
        Which face is followed where there are several, the largest being 0.

    Returns
    -------
    LandmarkTracks
        Without lag. Its `notes` tell of several faces and of frames without one.

    Raises
    ------
    InputError
        If there is no face in any frame, or the networks are not installed.
    FileFormatError, OSError
        If the file cannot be read.
    """
    if face < 0:
        raise ValueError(f"face must be 0 or more, got {face}")
    finder = FaceFinder() if finder is None else finder
    with closing(_frames(video, gray=False)) as frames:
        seen = sight_face(frames, finder, face=face)
    name = video.name if isinstance(video, Path) else "the video"
    if np.isnan(seen.presence).all():
        raise InputError(_no_face(name, seen, face))
    pieces = [FacePiece.of(seen, part) for part in _parts(seen)]
    with closing(_frames(video, gray=True)) as frames:
        measure_pieces(frames, pieces)
    return _joined(seen, pieces, finder, _notes(seen, face))


def _frames(video: Path | Sequence[Frame], *, gray: bool) -> Generator[Frame, None, None]:
    if isinstance(video, Path):
        yield from read_frames(video, gray=gray)
        return
    for frame in video:
        is_colour = frame.image.ndim == 3
        if gray and is_colour:
            image = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
            yield Frame(frame.index, frame.time_s, image)
        else:
            yield frame


def _no_face(name: str, seen: FaceSightings, face: int) -> str:
    T = len(seen.time_s)
    if seen.n_faces:
        return f"{name}: face {face} was asked for, but at most {seen.n_faces} were seen at once"
    return (
        f"{name}: no face was found in {T} frames: it must be seen from the front or up to about "
        "60 degrees from the side and fill a twentieth of the picture; or mark its points yourself"
    )


def _notes(seen: FaceSightings, face: int) -> tuple[str, ...]:
    notes = []
    if seen.n_faces > 1:
        which = "the largest" if face == 0 else f"number {face}"
        notes.append(
            f"{seen.n_faces} faces were seen: {which} is followed (another: face 0 to "
            f"{seen.n_faces - 1}, by size)"
        )
    n_without = int(np.isnan(seen.presence).sum())
    if n_without:
        notes.append(f"{n_without} of {len(seen.time_s)} frames show no face that could be found")
    if seen.cuts:
        notes.append(f"{len(seen.cuts)} cuts were found")
    return tuple(notes)


def _notes_on_hidden(sd: Floats, presence: Floats) -> tuple[str, ...]:
    n_partly = int((np.isnan(sd).any(axis=1) & np.isfinite(presence)).sum())
    if not n_partly:
        return ()
    return (
        f"in {n_partly} frames parts of the face are covered or turned away: they are left out",
    )


def _parts(seen: FaceSightings) -> Iterator[slice]:
    """Stretches with a face, each within one shot; short gaps inside are left in."""
    known = np.flatnonzero(np.isfinite(seen.presence))
    start = before = int(known[0])
    for frame in known[1:].tolist():
        is_long = seen.time_s[frame] - seen.time_s[before] > LONGEST_BRIDGE_S
        is_cut = any(before < cut <= frame for cut in seen.cuts)
        if is_cut or (frame > before + 1 and is_long):
            yield slice(start, before + 1)
            start = frame
        before = frame
    yield slice(start, before + 1)


def _joined(
    seen: FaceSightings, pieces: list[FacePiece], finder: FaceFinder, notes: tuple[str, ...]
) -> LandmarkTracks:
    T = len(seen.time_s)
    points, sd = np.full((T, N_LANDMARKS, 2), np.nan), np.full((T, N_LANDMARKS), np.nan)
    source = np.full(T, LandmarkSource.MISSING, np.int64)
    scores, irises = np.full((T, len(SCORE_NAMES)), np.nan), np.full((T, 2, 2), np.nan)
    for piece in pieces:
        hidden, uncertain = piece.hide(seen.presence[piece.part])
        points[piece.part], sd[piece.part] = filter_landmarks(piece.measured)
        sd[piece.part][uncertain] *= _UNCERTAIN_TIMES
        points[piece.part][hidden] = sd[piece.part][hidden] = np.nan
        gone = np.stack([hidden[:, rows[0]] for rows in IRISES], axis=1)
        irises[piece.part] = np.where(gone[..., None], np.nan, piece.irises)
        source[piece.part] = np.where(hidden.all(axis=1), LandmarkSource.MISSING, piece.sources())
    is_whole = (source == LandmarkSource.NETWORK) & np.isfinite(sd).all(axis=1)
    for frame in np.flatnonzero(is_whole):
        scores[frame] = finder.scores(_as_found(points[frame], seen.presence[frame]))
    return LandmarkTracks(
        seen.time_s,
        points,
        sd,
        seen.presence,
        source,
        seen.image_size,
        scores,
        seen.cuts,
        notes + _notes_on_hidden(sd, seen.presence),
        irises,
    )


def _as_found(points: Floats, presence: float) -> FoundFace:
    box = np.concatenate([points.min(axis=0), points.max(axis=0)])
    return FoundFace(box, np.nan, np.pad(points, ((0, 0), (0, 1))), presence)
