"""Chunks of a take put together again: which frames each delivers, and what it sees of others.

Chunk k begins `overlap` frames before ``k step`` (chunk 0 at 0) and ends before ``(k + 1) step``.
In the overlap two chunks have found the same dots; the first half is taken from the earlier one.
Where they disagree about a name there, neither is believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ..core.trajectories import Source, Trajectories
from .chunk_files import ChunkFiles

_SAME_MM = 0.5  # two chunks' samples of one marker: the same dots, seen by trackers of other past
_OTHER_MM = 2.0  # samples of one name that are not one marker
_LEAST_SHARED = 3

_PER_SAMPLE = ("positions", "covariances", "source", "residual_px", "n_views")


@dataclass(frozen=True, eq=False)
class Joined:
    """A chunk with what surrounds it.

    Attributes
    ----------
    tracks : Trajectories
    own : slice
        The frames that this chunk delivers.
    """

    tracks: Trajectories
    own: slice

    def own_of(self, tracks: Trajectories) -> Trajectories:
        """The chunk's own frames of trajectories over all of them."""
        return _rows(tracks, self.own)


class JoinedChunks:
    """The chunks of a finished take.

    Parameters
    ----------
    files : ChunkFiles
    kind : str
    n_chunks : int
    step, overlap : int
        Frames.
    columns : sequence of (M_k,) int64, optional
        For each chunk, which of the take's columns its tracks go to; by default all chunks have
        the same names.
    """

    def __init__(
        self,
        files: ChunkFiles,
        kind: str,
        n_chunks: int,
        step: int,
        overlap: int,
        columns: Sequence[NDArray[np.int64]] | None = None,
    ) -> None:
        self._files, self._kind, self._n = files, kind, n_chunks
        self._step, self._overlap, self._columns = step, overlap, columns
        self._lengths: list[int] = []
        largest = 0.0
        names: tuple[str, ...] = ()
        for index in range(n_chunks):
            tracks, _ = files.read(kind, index)
            names = tracks.names
            self._lengths.append(len(tracks.time_s))
            assert tracks.residual_px is not None
            largest = max(largest, float(np.nanmax(tracks.residual_px, initial=0.0)))
        self.largest_residual_px = largest
        if columns is not None:
            n = max((int(c.max()) + 1 for c in columns if len(c)), default=0)
            names = tuple(f"m{m:03d}" for m in range(n))
        self.names = names
        self.n_frames = self._begin(n_chunks - 1) + self._lengths[-1]
        self._cached: dict[int, Trajectories] = {}

    def rows(self, index: int) -> slice:
        """Which of a chunk's frames it delivers."""
        begin, end = self._own(index)
        return slice(begin - self._begin(index), end - self._begin(index))

    def part(self, index: int, context: int) -> Joined:
        """A chunk's own frames, and up to so many frames of its neighbours on both sides."""
        begin, end = self._own(index)
        first, last = max(0, begin - context), min(self.n_frames, end + context)
        near = [k for k in (index - 1, index, index + 1) if 0 <= k < self._n]
        self._cached = {k: self._cached.get(k) or self._read(k) for k in near}
        pieces = []
        for k in near:
            own = self._own(k)
            lo, hi = max(first, own[0]), min(last, own[1])
            if lo < hi:
                pieces.append(
                    _rows(self._agreed(k), slice(lo - self._begin(k), hi - self._begin(k)))
                )
        first = max(first, self._own(near[0])[0])
        return Joined(_concatenated(pieces), slice(begin - first, end - first))

    def _begin(self, index: int) -> int:
        return max(0, index * self._step - self._overlap) if index else 0

    def _own(self, index: int) -> tuple[int, int]:
        begin = index * self._step - self._overlap // 2 if index else 0
        is_last = index + 1 == self._n
        end = self.n_frames if is_last else (index + 1) * self._step - self._overlap // 2
        return begin, end

    def _read(self, index: int) -> Trajectories:
        tracks, _ = self._files.read(self._kind, index)
        if self._columns is None:
            return tracks
        return _spread(tracks, self._columns[index], self.names)

    def _agreed(self, index: int) -> Trajectories:
        """A chunk without the samples of overlaps whose names the other chunk denies."""
        tracks = self._cached[index]
        bad = np.zeros(tracks.source.shape, bool)
        for other in (index - 1, index + 1):
            if other not in self._cached:
                continue
            begins = self._begin(index), self._begin(other)
            lo = max(begins)
            hi = min(
                b + len(self._cached[k].time_s) for k, b in zip((index, other), begins, strict=True)
            )
            mine, theirs = (slice(lo - b, hi - b) for b in begins)
            gap = tracks.positions[mine] - self._cached[other].positions[theirs]
            bad[mine] |= np.linalg.norm(gap, axis=2) > _OTHER_MM  # False for NaN
        return _without(tracks, bad) if bad.any() else tracks


def unlabelled_columns(files: ChunkFiles, n_chunks: int) -> list[NDArray[np.int64]]:
    """Which of the take's columns each chunk's unnamed tracks go to: those of the same dots."""
    columns: list[NDArray[np.int64]] = []
    n_taken = 0
    before: Trajectories | None = None
    for index in range(n_chunks):
        tracks, _ = files.read("tracked", index)
        found = np.full(len(tracks.names), -1, dtype=np.int64)
        if before is not None:
            for old, new in zip(*_same_tracks(before, tracks), strict=True):
                found[new] = columns[-1][old]
        fresh = np.flatnonzero(found < 0)
        found[fresh] = n_taken + np.arange(len(fresh))
        n_taken += len(fresh)
        columns.append(found)
        before = tracks
    return columns


def _same_tracks(
    before: Trajectories, after: Trajectories
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of tracks that lie in the same places at the times both know."""
    shared = np.isin(np.round(before.time_s, 6), np.round(after.time_s, 6)).sum()
    a, b = before.positions[-shared:], after.positions[:shared]
    if not shared or not a.shape[1] or not b.shape[1]:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    d = np.linalg.norm(a[:, :, None] - b[:, None], axis=3)
    n = (~np.isnan(d)).sum(axis=0)
    mean = np.divide(np.nansum(d, axis=0), n, out=np.full(n.shape, _SAME_MM), where=n > 0)
    mean[(n < _LEAST_SHARED) | (mean > _SAME_MM)] = _SAME_MM
    rows, columns = linear_sum_assignment(mean)
    same = mean[rows, columns] < _SAME_MM
    return rows[same], columns[same]


def _rows(tracks: Trajectories, rows: slice) -> Trajectories:
    given: dict[str, Any] = {n: getattr(tracks, n) for n in ("time_s", *_PER_SAMPLE)}
    return replace(tracks, **{n: v[rows] for n, v in given.items() if v is not None})


def _concatenated(pieces: Sequence[Trajectories]) -> Trajectories:
    if len(pieces) == 1:
        return pieces[0]
    joined: dict[str, Any] = {
        n: np.concatenate([getattr(p, n) for p in pieces]) for n in ("time_s", *_PER_SAMPLE)
    }
    return replace(pieces[0], **joined)


def _without(tracks: Trajectories, bad: NDArray[np.bool_]) -> Trajectories:
    nothing = {"positions": np.nan, "covariances": np.nan, "residual_px": np.nan, "n_views": 0}
    values: dict[str, Any] = {n: np.array(getattr(tracks, n)) for n in nothing}
    for name, missing in nothing.items():
        values[name][bad] = missing
    source = np.where(bad, np.uint8(Source.MISSING), tracks.source)
    return replace(tracks, **values, source=source)


def _spread(
    tracks: Trajectories, columns: NDArray[np.int64], names: tuple[str, ...]
) -> Trajectories:
    """Tracks in the columns of the take."""
    T, M = len(tracks.time_s), len(names)
    empty: dict[str, Any] = {
        "positions": np.full((T, M, 3), np.nan),
        "covariances": np.full((T, M, 3, 3), np.nan),
        "source": np.zeros((T, M), np.uint8),
        "residual_px": np.full((T, M), np.nan),
        "n_views": np.zeros((T, M), np.int32),
    }
    for name, values in empty.items():
        values[:, columns] = getattr(tracks, name)
    return Trajectories(tracks.time_s, names, **empty)
