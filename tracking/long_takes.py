"""Takes of any length from videos to C3D, in memory that does not grow with them.

A take is worked in chunks of ten seconds that overlap by one: tracked as they are decoded,
labelled in the order in which the person becomes known, filled with their neighbours in view, and
written as a stream. Finished chunks lie in a folder beside the result (`chunk_files`), so that a
run that was killed goes on where it stopped.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.files import alone_in
from ..core.formats.c3d_writer import C3dWriter
from ..core.markers import MarkerSet
from ..core.person import Person
from ..core.rig import Rig
from ..core.trajectories import Trajectories
from .blobs import BlobSettings
from .chunk_files import ChunkFiles, file_facts, part_folder
from .chunk_joins import JoinedChunks, unlabelled_columns
from .chunk_labels import ChunkLabeller
from .dot_streams import stream_dots
from .footage import Footage
from .gaps import DEFAULT_MAX_GAP_S, SeenFace, fill_gaps, learn_face
from .labelling import Labelling, Repair
from .tracker import FrameDots, TrackerSettings
from .video_clocks import VideoClocks, read_clocks
from .videos import LostFrames, blob_settings, match_videos_to_rig

logger = logging.getLogger(__name__)

CHUNK_S, OVERLAP_S = 10.0, 1.0
_CONTEXT_S = 5.0  # of the neighbours, seen when gaps near a chunk's ends are filled


@dataclass(frozen=True)
class LongSettings:
    """How a long take is tracked.

    Attributes
    ----------
    level : float or None
        Grey level above which a pixel is a dot's; found from each camera's footage by default.
    colour : str or None
        Of the markers, as `videos.blob_settings` says.
    tracker : TrackerSettings
    rate_hz : float or None
        The rate at which the take was filmed, where files say a wrong one.
    refine_rig : bool
        Estimate cameras anew that were moved after their calibration; else they are left out.
    max_gap_s : float
        Longest gap that is filled.
    neutral_frame : int
        At which the face is at rest; not used with a person.
    neutral_s : float or None
        The same as a time; goes before `neutral_frame`.
    face : int
        Of several faces, which: 0 is the one that was seen most.
    chunk_s, overlap_s : float
    """

    level: float | None = None
    colour: str | None = None
    tracker: TrackerSettings = field(default_factory=TrackerSettings)
    rate_hz: float | None = None
    refine_rig: bool = False
    max_gap_s: float = DEFAULT_MAX_GAP_S
    neutral_frame: int = 0
    neutral_s: float | None = None
    face: int = 0
    chunk_s: float = CHUNK_S
    overlap_s: float = OVERLAP_S


@dataclass(frozen=True, eq=False)
class LongTake:
    """What became of a take; its trajectories are in the file.

    Attributes
    ----------
    path : Path
    names : tuple of str, length M
    n_frames : int
    rate_hz : float
    n_measured, n_filled, n_missing : (M,) int64
        Samples of each marker.
    reprojection_rms_px : float
        Over all views used of all points; NaN without any.
    levels : mapping from camera to float
    labelling : Labelling or None
        Of the frame that names spread from; None without a marker set.
    person : Person or None
        As known at the end.
    repairs : tuple of Repair
        Frames are those of the take.
    notes : tuple of str
        What the user should know.
    """

    path: Path
    names: tuple[str, ...]
    n_frames: int
    rate_hz: float
    n_measured: NDArray[np.int64]
    n_filled: NDArray[np.int64]
    n_missing: NDArray[np.int64]
    reprojection_rms_px: float
    levels: Mapping[str, float]
    labelling: Labelling | None
    person: Person | None
    repairs: tuple[Repair, ...]
    notes: tuple[str, ...]


def track_long(
    videos: Sequence[Path],
    rig: Rig,
    out: Path,
    *,
    marker_set: MarkerSet | None = None,
    person: Person | None = None,
    settings: LongSettings | None = None,
    on_frame: Callable[[int], None] | None = None,
    on_resume: Callable[[float], None] | None = None,
    on_chunk: Callable[[Trajectories], None] | None = None,
) -> LongTake:
    """Track a take into a C3D file.

    Parameters
    ----------
    videos : sequence of Path
        Named after the rig's cameras.
    rig : Rig
    out : Path
        The C3D file. ``OUT.part/`` beside it holds what is finished until all is.
    marker_set : MarkerSet, optional
        Without one, trajectories stay unlabelled and gaps stay gaps.
    person : Person, optional
        Whose face it is, known from another take.
    settings : LongSettings, optional
    on_frame : callable, optional
        Told each finished frame's index.
    on_resume : callable, optional
        Told how many seconds of the take an earlier run has finished, if any.
    on_chunk : callable, optional
        Given each piece of the result in order, covariances and all, as it is written.

    Raises
    ------
    InputError, FileFormatError, OSError
        As `videos.track_videos` and `labelling.label_tracks`; or if another run works on the same.
    """
    settings = settings or LongSettings()
    rig, paths = match_videos_to_rig(videos, rig)
    clocks = read_clocks(paths, rate_hz=settings.rate_hz)
    with alone_in(part_folder(out)):
        job = _Job(rig, paths, clocks, out, marker_set, person, settings)
        try:
            found = job.run(on_frame, on_resume, on_chunk)
        except BaseException:
            job.files.remove_if_fruitless()
            raise
        job.files.remove()
    return found


class _Job:
    """One take's work: what all steps share."""

    def __init__(
        self,
        rig: Rig,
        paths: Mapping[str, Path],
        clocks: VideoClocks,
        out: Path,
        marker_set: MarkerSet | None,
        person: Person | None,
        settings: LongSettings,
    ) -> None:
        self.files = ChunkFiles(part_folder(out))
        self._rig, self._paths, self._out = rig, paths, out
        self._marker_set, self._person, self._settings = marker_set, person, settings
        self._clocks, rate_hz = clocks, clocks.rate_hz
        self._overlap = max(2, round(settings.overlap_s * rate_hz))
        self._step = max(2 * self._overlap, round(settings.chunk_s * rate_hz))
        self._neutral = settings.neutral_frame
        if settings.neutral_s is not None:
            self._neutral = round(settings.neutral_s * rate_hz)

    def run(
        self,
        on_frame: Callable[[int], None] | None,
        on_resume: Callable[[float], None] | None,
        on_chunk: Callable[[Trajectories], None] | None,
    ) -> LongTake:
        is_resumed = self.files.begin(self._asked())
        n_done = self._n_tracked() if is_resumed else 0
        if n_done and on_resume is not None:
            on_resume(n_done * self._step / self._clocks.rate_hz)
        blobs = blob_settings(self._paths, level=self._settings.level, colour=self._settings.colour)
        labeller = None
        if self._marker_set is not None:
            labeller = ChunkLabeller(
                self.files, self._marker_set, self._person,
                neutral=divmod(self._neutral, self._step), overlap=self._overlap,
                face=self._settings.face,
            )  # fmt: skip
        with ExitStack() as stack:
            pool = stack.enter_context(ThreadPoolExecutor(1))
            n_chunks = self._track(blobs, n_done, on_frame, labeller, pool)
            if labeller is not None:
                pool.submit(labeller.finish, n_chunks).result()
        return self._write(n_chunks, blobs, labeller, on_chunk)

    def _asked(self) -> dict[str, object]:
        """What a finished chunk depends on."""
        s = self._settings
        spots, chunks = [s.level, s.colour], [s.chunk_s, s.overlap_s, s.rate_hz]
        asked = [*spots, *chunks, s.refine_rig, s.face, self._neutral, *astuple(s.tracker)]
        cameras = {
            name: [
                c.image_size, c.matrix.tolist(), c.camera_from_world.quaternion.tolist(),
                c.camera_from_world.translation.tolist(), c.distortion_model,
                c.distortion.tolist(),
            ]
            for name, c in self._rig.cameras.items()
        }  # fmt: skip
        person = None if self._person is None else self._person.neutral.tolist()
        return {
            "videos": {name: file_facts(path) for name, path in self._paths.items()},
            "rig": cameras,
            "settings": asked,
            "markers": None if self._marker_set is None else repr(self._marker_set),
            "person": person,
        }

    def _n_tracked(self) -> int:
        n = 0
        while self.files.has("tracked", n):
            n += 1
        return n

    # --- Tracking ---

    def _track(
        self,
        blobs: Mapping[str, BlobSettings],
        n_done: int,
        on_frame: Callable[[int], None] | None,
        labeller: ChunkLabeller | None,
        pool: ThreadPoolExecutor,
    ) -> int:
        """Track the chunks that are not finished yet; how many there are in all."""
        labels: Future[None] | None = None

        def label(index: int) -> None:
            nonlocal labels
            if labels is not None and labels.done():
                labels.result()  # raises what went wrong
            if labeller is not None:
                labels = pool.submit(labeller.add, index)

        for index in range(n_done):
            label(index)
        starts = self._starts(n_done)
        if starts is None:
            return n_done  # that was all of it
        if on_frame is not None:
            for beat in range(n_done * self._step):
                on_frame(beat)
        chunk = _Chunk(n_done, self._rig, self._settings, starts)
        following: _Chunk | None = None
        first = max(0, n_done * self._step - self._overlap) if n_done else 0
        frames = stream_dots(self._paths, self._clocks, blobs, first_beat=first, starts=starts)
        beat = first - 1
        with closing(frames):
            for beat, frame in enumerate(frames, first):
                chunk.step(beat, frame)
                if beat >= (chunk.index + 1) * self._step - self._overlap:
                    if following is None:
                        known = chunk.last_stamps(beat)
                        following = _Chunk(chunk.index + 1, self._rig, self._settings, known)
                    following.step(beat, frame)
                if on_frame is not None and beat >= n_done * self._step:
                    on_frame(beat)
                if beat + 1 == (chunk.index + 1) * self._step:
                    assert following is not None
                    chunk.finish(self.files, following.starts)
                    label(chunk.index)
                    chunk, following = following, None
        if chunk.index == 0 or beat + 1 > chunk.index * self._step:
            chunk.finish(self.files, None)
            label(chunk.index)
            return chunk.index + 1
        return chunk.index

    def _starts(self, n_done: int) -> Mapping[str, tuple[int, float]] | None:
        """Where each camera's video goes on after finished chunks; None if it does not."""
        if n_done == 0:
            return {}
        _, more = self.files.read("tracked", n_done - 1)
        if not len(more["next_beat"]):
            return None
        pairs = zip(self._rig, more["next_beat"], more["next_stamp_s"], strict=True)
        return {name: (int(beat), float(stamp_s)) for name, beat, stamp_s in pairs}

    # --- Writing ---

    def _write(
        self,
        n_chunks: int,
        blobs: Mapping[str, BlobSettings],
        labeller: ChunkLabeller | None,
        on_chunk: Callable[[Trajectories], None] | None,
    ) -> LongTake:
        kind, columns = "labelled", None
        if labeller is None:
            kind, columns = "tracked", unlabelled_columns(self.files, n_chunks)
        joined = JoinedChunks(self.files, kind, n_chunks, self._step, self._overlap, columns)
        totals = _Totals(len(joined.names))
        lost = LostFrames(self._rig.names)
        notes = list(self._clocks.notes)
        for index in range(n_chunks):
            _, more = self.files.read("tracked", index)
            for here in more["present"][joined.rows(index)]:
                lost.count(here)
            notes += [str(n) for n in more["notes"]]
        writer = C3dWriter(
            self._out, joined.names, self._clocks.rate_hz, joined.n_frames,
            largest_residual_px=joined.largest_residual_px,
        )  # fmt: skip
        context = round(_CONTEXT_S * self._clocks.rate_hz)
        seen: SeenFace | None = None
        with writer:
            for index in range(n_chunks):
                part = joined.part(index, context)
                if labeller is not None:
                    filled = fill_gaps(part.tracks, max_gap_s=self._settings.max_gap_s, seen=seen)
                    seen = learn_face(part.own_of(part.tracks), seen)
                    part = replace(part, tracks=filled)
                piece = part.own_of(part.tracks)
                writer.write(piece)
                totals.add(piece)
                if on_chunk is not None:
                    on_chunk(piece)
        return LongTake(
            self._out,
            joined.names,
            joined.n_frames,
            self._clocks.rate_hz,
            *totals.counts,
            totals.rms_px,
            {name: s.level for name, s in blobs.items()},
            None if labeller is None else labeller.labelling,
            None if labeller is None else labeller.person,
            () if labeller is None else labeller.repairs,
            _distinct([*notes, *lost.notes(), *(labeller.notes if labeller else ())]),
        )


class _Chunk:
    """A chunk as its frames come."""

    def __init__(
        self,
        index: int,
        rig: Rig,
        settings: LongSettings,
        starts: Mapping[str, tuple[int, float]],
    ) -> None:
        self.index, self.starts = index, dict(starts)
        self._names, self._refine_rig = rig.names, settings.refine_rig
        self._footage = Footage(rig, settings.tracker)
        self._present: list[NDArray[np.bool_]] = []
        self._last = dict(starts)

    def step(self, beat: int, frame: FrameDots) -> None:
        stamps_s = np.array(frame.stamps_s)
        self._present.append(~np.isnan(stamps_s))
        for name, stamp_s in zip(self._names, stamps_s, strict=True):
            if not np.isnan(stamp_s):
                self._last[name] = (beat, float(stamp_s))
        self._footage.step(frame)

    def last_stamps(self, beat: int) -> dict[str, tuple[int, float]]:
        """For each camera the latest beat up to now, and its stamp."""
        return {name: self._last.get(name, (0, 0.0)) for name in self._names}

    def finish(self, files: ChunkFiles, following: Mapping[str, tuple[int, float]] | None) -> None:
        """Write it; `following` says where the next one begins, if there is one."""
        notes: tuple[str, ...]
        try:
            found = self._footage.tracked(refine_rig=self._refine_rig)
            tracks, notes = found.followed.trajectories, found.verdict.notes
        except InputError as error:
            if self.index == 0:  # better said now than after the take
                raise
            tracks = self._footage.nothing()
            notes = (f"from {tracks.time_s[0]:.1f} to {tracks.time_s[-1]:.1f} s: {error}",)
        next_ = [] if following is None else [following[name] for name in self._names]
        files.write(
            "tracked", self.index, tracks,
            present=np.array(self._present),
            notes=np.array(notes, dtype=np.str_),
            next_beat=np.array([beat for beat, _ in next_], dtype=np.int64),
            next_stamp_s=np.array([stamp_s for _, stamp_s in next_], dtype=np.float64),
        )  # fmt: skip


class _Totals:
    """Counts over the take."""

    def __init__(self, n_markers: int) -> None:
        self._counts = np.zeros((3, n_markers), np.int64)
        self._squares, self._n_views = 0.0, 0

    def add(self, piece: Trajectories) -> None:
        kinds = (piece.is_measured, piece.is_filled, piece.is_missing)
        self._counts += [k.sum(axis=0) for k in kinds]
        assert piece.residual_px is not None
        assert piece.n_views is not None
        seen = piece.is_measured & (piece.n_views > 0)
        n_views = piece.n_views[seen]
        self._squares += float((piece.residual_px[seen] ** 2 * n_views).sum())
        self._n_views += int(n_views.sum())

    @property
    def counts(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        measured, filled, missing = self._counts
        return measured, filled, missing

    @property
    def rms_px(self) -> float:
        return float(np.sqrt(self._squares / self._n_views)) if self._n_views else float("nan")


def _distinct(notes: Sequence[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(notes))
