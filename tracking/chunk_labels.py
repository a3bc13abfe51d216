"""Names for the chunks of a take, in the order in which the person becomes known."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.markers import MarkerSet
from ..core.person import Person
from ..core.trajectories import Trajectories
from .chunk_files import ChunkFiles
from .faces import split_faces
from .labelling import Labelled, Labelling, Repair, label_tracks

_PERSON = ("neutral", "modes", "noise_mm", "is_known")


class ChunkLabeller:
    """Labels chunks as they are tracked: from the neutral one on, then those before it.

    Parameters
    ----------
    files : ChunkFiles
        Holds ``tracked`` chunks; ``labelled`` ones are written there.
    marker_set : MarkerSet
    person : Person or None
        If known from another take, no neutral is needed.
    neutral : (chunk, frame after ``chunk step``)
    overlap : int
        Frames by which a chunk begins before that.
    face : int
        Of several faces, which.
    """

    def __init__(
        self,
        files: ChunkFiles,
        marker_set: MarkerSet,
        person: Person | None,
        *,
        neutral: tuple[int, int],
        overlap: int,
        face: int = 0,
    ) -> None:
        self._files, self._marker_set, self.person = files, marker_set, person
        chunk, frame = neutral
        self._first = 0 if person is not None else chunk
        self._neutral_frame = frame + (overlap if chunk else 0)
        self._face = face
        self._middle: NDArray[np.float64] | None = None
        self._early: list[int] = []
        self._repairs: dict[int, tuple[Repair, ...]] = {}
        self.labelling: Labelling | None = None
        self.notes: list[str] = []

    @property
    def repairs(self) -> tuple[Repair, ...]:
        """In order of time, frames those of the take."""
        return tuple(r for index in sorted(self._repairs) for r in self._repairs[index])

    def add(self, index: int) -> None:
        """Label a chunk, if the person is known by now; else at the end."""
        if index < self._first:
            self._early.append(index)
        else:
            self._label(index)

    def finish(self, n_chunks: int) -> None:
        """Label what came before the neutral frame, backwards.

        Raises
        ------
        InputError
            If the neutral frame is behind the end of the take.
        """
        if self._first >= n_chunks:
            raise InputError("the neutral frame is behind the end of the take")
        self._middle = None
        for index in reversed(self._early):
            self._label(index)

    def _label(self, index: int) -> None:
        if index != self._first and self._files.has("labelled", index):
            self._take_over(index)
            return
        tracks, _ = self._files.read("tracked", index)
        tracks = self._of_face(tracks, index)
        repairs: tuple[Repair, ...] = ()
        try:
            found = self._labelled(tracks, index)
            labelled, self.person = found.trajectories, found.person
            if index == self._first:
                self.labelling = found.labelling
            repairs = found.repairs
        except InputError as error:
            if index == self._first:
                raise
            span = f"from {tracks.time_s[0]:.1f} to {tracks.time_s[-1]:.1f} s"
            self.notes.append(f"{span} nobody could be recognised: {error}")
            labelled = _nothing(tracks, self._marker_set.labels)
        first_frame = round(tracks.time_s[0] / _interval_s(tracks)) if len(tracks.time_s) > 1 else 0
        moved = tuple(
            replace(
                r, first_frame=r.first_frame + first_frame, last_frame=r.last_frame + first_frame
            )
            for r in repairs
        )
        self._repairs[index] = moved
        self._files.write("labelled", index, labelled, **self._kept(moved))

    def _labelled(self, tracks: Trajectories, index: int) -> Labelled:
        if index == self._first and self.person is None:
            return label_tracks(tracks, self._marker_set, neutral_frame=self._neutral_frame)
        return label_tracks(tracks, self._marker_set, person=self.person)

    def _of_face(self, tracks: Trajectories, index: int) -> Trajectories:
        """The tracks of the face asked for: by size at first, by its place from then on."""
        faces = split_faces(tracks)
        if not faces:
            return tracks
        middles = [np.nanmedian(tracks.positions[:, f].reshape(-1, 3), axis=0) for f in faces]
        if self._middle is None:
            chosen = self._face
            if chosen >= len(faces):
                raise InputError(
                    f"face {chosen} was asked for, but {len(faces)} were found (0 to "
                    f"{len(faces) - 1})"
                )
        else:
            off = [float(np.linalg.norm(m - self._middle)) for m in middles]
            chosen = int(np.argmin(off))
        if len(faces) > 1:
            self.notes.append(
                f"{len(faces)} faces are before the cameras: the one at "
                f"({', '.join(f'{x:.0f}' for x in middles[chosen])}) mm is taken"
            )
        self._middle = middles[chosen]
        return tracks.select(tuple(tracks.names[m] for m in faces[chosen]))

    def _kept(self, repairs: tuple[Repair, ...]) -> dict[str, NDArray[Any]]:
        """What a later run needs to go on from this chunk."""
        kept = {"repairs": np.array(json.dumps([asdict(r) for r in repairs]))}
        if self.person is not None:
            kept |= {name: np.asarray(getattr(self.person, name)) for name in _PERSON}
            kept["labels"] = np.array(self.person.labels, dtype=np.str_)
            kept["numbers"] = np.array([self.person.log_scale_sd, self.person.n_frames])
        return kept

    def _take_over(self, index: int) -> None:
        _, more = self._files.read("labelled", index)
        self._repairs[index] = tuple(Repair(**r) for r in json.loads(str(more["repairs"])))
        if "labels" in more:
            neutral, modes, noise_mm, is_known = (more[name] for name in _PERSON)
            self.person = Person(
                self._marker_set.name,
                tuple(str(n) for n in more["labels"]),
                neutral,
                modes,
                noise_mm,
                is_known,
                float(more["numbers"][0]),
                int(more["numbers"][1]),
            )


def _interval_s(tracks: Trajectories) -> float:
    return float((tracks.time_s[-1] - tracks.time_s[0]) / (len(tracks.time_s) - 1))


def _nothing(tracks: Trajectories, labels: tuple[str, ...]) -> Trajectories:
    T, M = len(tracks.time_s), len(labels)
    return Trajectories(
        tracks.time_s,
        labels,
        np.full((T, M, 3), np.nan),
        covariances=np.full((T, M, 3, 3), np.nan),
        residual_px=np.full((T, M), np.nan),
        n_views=np.zeros((T, M), np.int32),
    )
