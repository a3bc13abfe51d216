"""What is seen of a face between neighbouring frames, and against a reference frame.

All of it is measured in rectified pictures: flow from each frame to the next, and the patches of
the reference frame wherever they are found again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.video import Frame
from ..heads.face_landmarks import N_LANDMARKS
from .covered_faces import covered_points, long_covered
from .face_rectify import RectifiedFrame, canonical_places, even_picture, rectify
from .face_sightings import FaceSightings, ahead
from .flow_tracks import flow_sd, follow_points, shared_motion, skin_kernel
from .iris_fit import fit_irises, usual_radius
from .landmark_filter import LandmarkMeasurements
from .landmark_regions import IS_QUICK
from .landmark_tracks import LandmarkSource
from .templates import FaceTemplate, template_sd

Floats = NDArray[np.float64]

#: The longest gap that is filled from the frames around it.
LONGEST_BRIDGE_S = 0.25
_SURE_PRESENCE = 8.0
_UNSURE_TIMES = 2.0
_WORKERS = 2
_QUEUE = 8  # measurements under way
#: The reference is one of the first frames: their pictures wait for it.
_REFERENCE_WITHIN, _MOST_FOR_REFERENCE = 600, 200
_WELL_FOLLOWED_PX = 0.5  # of the rectified face: flow held on to the point


@dataclass(eq=False)
class FacePiece:
    """A stretch with a face, within one shot, while it is measured.

    Attributes
    ----------
    part : slice
        Frames of the video.
    filled : (n, 478, 2) float64, px
        The network's points; in gaps, on straight ways between the frames around them.
    is_seen : (n,) bool
        Whether the network saw the face.
    frames : list of RectifiedFrame
    places : (478, 2) float64, px of the rectified face
        The reference frame's landmarks.
    kernel : (478, 478) float64
        `flow_tracks.skin_kernel`.
    reference : int
        The frame whose patches are looked for, counted from the part's first.
    measured : LandmarkMeasurements
        Filled in as frames come.
    iris_radius : (2,) float64
        As `iris_fit.usual_radius` says.
    irises : (n, 2, 2) float64, px
        Filled in likewise; NaN where none is seen.
    """

    part: slice
    filled: Floats
    is_seen: NDArray[np.bool_]
    frames: list[RectifiedFrame]
    places: Floats
    kernel: Floats
    reference: int
    measured: LandmarkMeasurements
    iris_radius: Floats
    irises: Floats

    @classmethod
    def of(cls, seen: FaceSightings, part: slice) -> FacePiece:
        is_seen = np.isfinite(seen.presence[part])
        time_s, network = seen.time_s[part], seen.points_px[part].astype(np.float64)
        filled = _filled(time_s, network, is_seen)
        reference = _typical_frame(filled, is_seen)
        places = canonical_places(filled[reference])
        frames = [rectify(points, places) for points in filled]
        unit = np.array([frame.unit_px for frame in frames])
        unsure = ~(seen.presence[part] > _SURE_PRESENCE)
        n = len(time_s)
        measured = LandmarkMeasurements(
            time_s,
            unit,
            network,
            np.zeros((n, N_LANDMARKS, 2)),
            np.full((n, N_LANDMARKS), np.inf),
            np.full((n, N_LANDMARKS, 2), np.nan),
            np.full((n, N_LANDMARKS), np.nan),
            np.where(unsure, _UNSURE_TIMES, 1.0),
        )
        kernel = skin_kernel(places, ~IS_QUICK)
        radius, irises = usual_radius(filled), np.full((n, 2, 2), np.nan)
        return cls(
            part, filled, is_seen, frames, places, kernel, reference, measured, radius, irises
        )

    def step(self, i: int, before: NDArray[np.uint8], now: NDArray[np.uint8]) -> None:
        """Measure how far the points went from frame i - 1 to i."""
        earlier, later = self.frames[i - 1], self.frames[i]
        start = earlier.inwards(self.filled[i - 1])
        found = follow_points(before, now, start, start)
        moves, sd = shared_motion(found.places - start, flow_sd(found), self.kernel)
        self.measured.step[i] = later.outwards(start + np.nan_to_num(moves)) - self.filled[i - 1]
        self.measured.step_sd[i] = sd * later.unit_px

    def register(self, i: int, template: FaceTemplate, now: NDArray[np.uint8]) -> None:
        """Find the reference frame's patches in frame i."""
        frame = self.frames[i]
        found = template.register(now, frame.inwards(self.filled[i]))
        self.measured.template[i] = frame.outwards(found.places)
        self.measured.template_sd[i] = template_sd(found) * frame.unit_px

    def look(self, i: int, gray: NDArray[np.uint8]) -> None:
        """Find the irises in frame i, (h, w) uint8."""
        if self.is_seen[i]:
            self.irises[i] = fit_irises(gray, self.filled[i], self.iris_radius).centre_px

    def hide(self, presence: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Take away what was measured on something before the face.

        Returns what stays unknown and what is uncertain, (n, 478) each.
        """
        m = self.measured
        apart = np.linalg.norm(m.template - m.network, axis=2)
        is_covered, uncertain = covered_points(presence, apart, self.places, m.unit_px)
        m.network[is_covered] = m.template[is_covered] = np.nan
        m.step_sd[is_covered] = np.inf
        return long_covered(is_covered, m.time_s, LONGEST_BRIDGE_S), uncertain

    def sources(self) -> NDArray[np.int64]:
        """Of each frame: a gap's frame is followed where flow held most points on both sides."""
        held = np.median(self.measured.step_sd / self.measured.unit_px[:, None], axis=1)
        is_held = held < _WELL_FOLLOWED_PX
        is_held &= np.append(is_held[1:], True)
        gap = np.where(is_held, LandmarkSource.FOLLOWED, LandmarkSource.BRIDGED)
        return np.where(self.is_seen, LandmarkSource.NETWORK, gap).astype(np.int64)


def _filled(time_s: Floats, network: Floats, is_seen: NDArray[np.bool_]) -> Floats:
    """The points, in gaps on straight ways between the frames around them."""
    flat = network.reshape(len(network), -1).copy()
    for column in flat.T if not is_seen.all() else ():
        column[~is_seen] = np.interp(time_s[~is_seen], time_s[is_seen], column[is_seen])
    return flat.reshape(network.shape)


def _typical_frame(points: Floats, is_seen: NDArray[np.bool_]) -> int:
    """The frame whose face is most like the median one: often at rest, seen as it usually is."""
    seen = np.flatnonzero(is_seen[:_REFERENCE_WITHIN])
    some = seen[:: -(-len(seen) // _MOST_FOR_REFERENCE)]
    places = canonical_places(points[some[0]])
    upright = np.stack([rectify(points[i], places).inwards(points[i]) for i in some])
    apart = np.linalg.norm(upright - np.median(upright, axis=0), axis=2).mean(axis=1)
    return int(some[np.argmin(apart)])


def measure_pieces(frames: Iterator[Frame], pieces: list[FacePiece]) -> None:
    """Flow and templates of all stretches, in one reading of the video."""
    with ThreadPoolExecutor(_WORKERS) as pool:
        todo = deque(pieces)
        running = _Running(pool)
        for number, frame in enumerate(ahead(frames)):
            if todo and number >= todo[0].part.stop:
                todo.popleft()
                running.begin()
            if not todo:
                break
            if number >= todo[0].part.start:
                running.take(todo[0], number - todo[0].part.start, frame.image)
        running.finish()


class _Running:
    """Measurements of one stretch, some frames at a time in other threads."""

    def __init__(self, pool: ThreadPoolExecutor) -> None:
        self._pool = pool
        self._jobs: deque[Future[None]] = deque()
        self.begin()

    def begin(self) -> None:
        """The next frame belongs to another stretch."""
        self._before: NDArray[np.uint8] | None = None
        self._template: FaceTemplate | None = None
        self._early: list[tuple[int, NDArray[np.uint8]]] = []  # before the reference frame

    def take(self, piece: FacePiece, i: int, gray: NDArray[np.uint8]) -> None:
        """Measure frame i of a stretch, (h, w) uint8."""
        now = even_picture(gray, piece.frames[i])
        self._do(piece.look, i, gray)
        if self._before is not None:
            self._do(piece.step, i, self._before, now)
        self._before = now
        if i == piece.reference:
            self._template = FaceTemplate(now, piece.places)
            for j, picture in self._early:
                self._do(piece.register, j, self._template, picture)
            self._early.clear()
        if self._template is None:
            self._early.append((i, now))
        else:
            self._do(piece.register, i, self._template, now)

    def _do(self, function: Callable[..., None], *given: object) -> None:
        self._jobs.append(self._pool.submit(function, *given))
        if len(self._jobs) > _QUEUE:
            self._jobs.popleft().result()

    def finish(self) -> None:
        """Wait for what is under way."""
        while self._jobs:
            self._jobs.popleft().result()
