"""Films a take: videos, sound, camera rig, marker set and exact truth in one folder.

A take is filmed in pieces of some seconds, each of which is whole or not there. What interrupts
the work leaves the finished pieces in a hidden folder, and the next call goes on from them; the
take's own files appear when all are whole.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.audio import write_audio
from ..core.files import alone_in
from ..core.formats.markers_toml import write_marker_set
from ..core.formats.rig_json import write_rig
from ..core.markers import MarkerSet
from ..core.mpeg4 import Fapu
from ..core.video_writer import VideoWriter, join_videos
from .film_views import Filmed, Views, open_views
from .scenes import SCENE_S
from .take_settings import write_take_settings
from .take_sound import HeardSound, Source, clap_source, record, scene_source
from .takes import Take, Truth, take_truth
from .truth_file import join_truth
from .wand import BALL_RADIUS_MM, BALLS_MM

WORK_FOLDER = ".filming"
PIECE_S = 8.0
CALLIPER_MM = 0.1  # the actor's units are measured to this
_MOUTH_MM, _HANDS_MM = (0.0, -55.0, 60.0), (60.0, -220.0, 250.0)
_STAMP_BASE = Fraction(1, 90000)
_THREADS = 2
_NO_IMAGE = np.zeros((0, 0), np.uint8)
_TAKES_OWN = re.compile(r"cam[0-9]+\.(mp4|mkv)|markers\.toml|audio\.wav")


@dataclass(frozen=True)
class FilmedTake:
    """Files of a filmed take; those it does not have are None."""

    folder: Path
    rig: Path
    truth: Path
    settings: Path
    videos: tuple[Path, ...]
    marker_set: Path | None = None
    sound: Path | None = None


def film_take(
    take: Take,
    folder: Path,
    *,
    keep_vertices: bool = False,
    on_frame: Callable[[int], None] | None = None,
    on_resume: Callable[[int], None] | None = None,
) -> FilmedTake:
    """Film a take into a folder that exists.

    Writes ``take.toml``, ``rig.json``, ``truth.npz`` (`write_truth` says what is in it), a video
    a camera, ``markers.toml`` (with the actor's units, measured to 0.1 mm) if there are markers,
    and ``audio.wav`` if there is something to hear.

    Parameters
    ----------
    take : Take
    folder : Path
    keep_vertices : bool
        Put all vertices into the truth: ``vertices`` (T, V, 3) float32, mm, head frame.
    on_frame : callable, optional
        Told each beat's index when it is filmed, or found finished.
    on_resume : callable, optional
        Told how many pieces an interrupted run has left, if any.

    Raises
    ------
    InputError
        If another run is filming into the folder.
    """
    with alone_in(folder):
        return _film(take, folder, keep_vertices, on_frame, on_resume)


def _film(
    take: Take,
    folder: Path,
    keep_vertices: bool,
    on_frame: Callable[[int], None] | None,
    on_resume: Callable[[int], None] | None,
) -> FilmedTake:
    work = folder / WORK_FOLDER
    _continue_or_begin(work, take, keep_vertices)
    if on_resume is not None and pieces_done(folder):
        on_resume(pieces_done(folder))
    n = len(take.time_s)
    step = max(1, round(PIECE_S * take.settings.cameras.rate_hz))
    pieces: list[Path] = []
    views: Views | None = None
    for first in range(0, n, step):
        beats = slice(first, min(first + step, n))
        piece = work / f"piece_{first:08d}"
        if not piece.is_dir():
            views = views or open_views(take)
            _film_piece(take, views, piece, beats, keep_vertices, on_frame)
        elif on_frame is not None:
            for beat in range(beats.start, beats.stop):
                on_frame(beat)
        pieces.append(piece)
    done = work / "done"
    shutil.rmtree(done, ignore_errors=True)
    done.mkdir()
    _join(take, pieces, done)
    _drop_earlier(folder, {path.name for path in done.iterdir()})
    for path in sorted(done.iterdir()):
        path.replace(folder / path.name)
    shutil.rmtree(work)
    return filmed_files(take, folder)


def filmed_files(take: Take, folder: Path) -> FilmedTake:
    """Where the files of a take are."""
    suffix = _suffix(take)
    return FilmedTake(
        folder,
        folder / "rig.json",
        folder / "truth.npz",
        folder / "take.toml",
        tuple(folder / f"{name}{suffix}" for name in take.rig),
        None if take.marker_set is None else folder / "markers.toml",
        folder / "audio.wav" if sources_of(take) else None,
    )


def pieces_done(folder: Path) -> int:
    """How many finished pieces of an interrupted take lie in a folder."""
    return len(list((folder / WORK_FOLDER).glob("piece_????????")))


def _drop_earlier(folder: Path, names: Collection[str]) -> None:
    """Remove what an earlier take in this folder had and this one has not.

    Otherwise ``animate take/cam*.mp4`` would mix two takes. Only what `film_take` writes, and only
    where a ``take.toml`` says that an earlier take is there.
    """
    if not (folder / "take.toml").is_file():
        return
    for path in sorted(folder.iterdir()):
        if _TAKES_OWN.fullmatch(path.name) and path.name not in names:
            path.unlink()


def _continue_or_begin(work: Path, take: Take, keep_vertices: bool) -> None:
    """Keep the pieces of the same take, throw away those of another."""
    work.mkdir(exist_ok=True)
    asked = work / "asked.toml"
    write_take_settings(work / "now.toml", take.settings, take.seed)
    now = (work / "now.toml").read_text("utf-8") + f"# keep_vertices {keep_vertices}\n"
    if not asked.exists() or asked.read_text("utf-8") != now:
        shutil.rmtree(work)
        work.mkdir()
        asked.write_text(now, "utf-8")


def _film_piece(
    take: Take,
    views: Views,
    piece: Path,
    beats: slice,
    keep_vertices: bool,
    on_frame: Callable[[int], None] | None,
) -> None:
    part = piece.with_name("unfinished")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    names = take.rig.names
    rows: list[list[Filmed | None]] = []
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(_THREADS))
        reels = [stack.enter_context(_Reel(take, part, name, beats, views)) for name in names]
        for beat in range(beats.start, beats.stop):
            shoot = partial(_Reel.film, beat=beat)
            filmed = pool.map(shoot, reels) if views.in_threads else map(shoot, reels)
            rows.append([None if f is None else replace(f, image=_NO_IMAGE) for f in filmed])
            if on_frame is not None:
                on_frame(beat)
    arrays = _wand_truth(take, beats) if take.wand else _truth_arrays(take, beats, keep_vertices)
    np.savez(part / "truth.npz", **arrays, **_pixel_truth(take, rows))  # type: ignore[arg-type]
    part.replace(piece)


def _pixel_truth(
    take: Take, rows: Sequence[Sequence[Filmed | None]]
) -> dict[str, NDArray[np.float64]]:
    """Where things are in the pictures, (T, C, K, 2) px, and how much of them is seen.

    ``marker_pixels``, ``marker_outlines``, ``marker_visible`` (T, C, M) of markers or a wand's
    balls; of plain takes ``feature_point_pixels`` and ``feature_point_visible``. NaN and 0 where
    the camera lost the frame.
    """
    n = max((len(f.visible) for row in rows for f in row if f is not None), default=0)
    shape = (len(rows), len(take.rig.names), n)
    centres, outlines = np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan)
    visible = np.zeros(shape)
    for i, row in enumerate(rows):
        for c, filmed in enumerate(row):
            if filmed is not None:
                centres[i, c], outlines[i, c] = filmed.centres, filmed.outlines
                visible[i, c] = filmed.visible
    if take.settings.kind == "plain":
        return {"feature_point_pixels": centres, "feature_point_visible": visible}
    return {"marker_pixels": centres, "marker_outlines": outlines, "marker_visible": visible}


def _wand_truth(take: Take, beats: slice) -> dict[str, NDArray[np.generic]]:
    """``time_s`` (T,) and ``marker_positions`` (T, 3, 3) mm, world, of a wand's balls."""
    assert take.wand is not None
    time_s = take.time_s[beats]
    return {
        "time_s": time_s,
        "marker_positions": np.stack([take.wand.balls(float(t)) for t in time_s]),
    }


class _Reel:
    """One camera's video of one piece."""

    def __init__(self, take: Take, folder: Path, name: str, beats: slice, views: Views) -> None:
        self._take, self._name, self._views = take, name, views
        times = take.frames[name]
        rows = np.flatnonzero((times.frame >= beats.start) & (times.frame < beats.stop))
        self._row_of = {int(times.frame[r]): int(r) for r in rows}
        self._start_s = float(times.stamp_s[rows[0]]) if len(rows) else 0.0
        s = take.settings
        width, height = s.cameras.image_size
        sideways = s.video.rotation_deg % 180 != 0
        self._writer = None
        if len(rows):
            self._writer = VideoWriter(
                folder / f"{name}{_suffix(take)}",
                (height, width) if sideways else (width, height),
                Fraction(s.cameras.rate_hz).limit_denominator(1001),
                crf=s.video.crf,
                max_bit_rate=s.video.max_bit_rate,
                lossless=s.video.codec == "lossless",
                time_base=_STAMP_BASE if s.clocks.jitter_frames else None,
                reproducible=True,
            )

    def __enter__(self) -> _Reel:
        if self._writer is not None:
            self._writer.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        if self._writer is not None:
            self._writer.__exit__(*error)  # type: ignore[arg-type]

    def film(self, beat: int) -> Filmed | None:
        """Film a beat; None if the camera loses that frame."""
        row = self._row_of.get(beat)
        if row is None:
            return None
        assert self._writer is not None
        times, camera = self._take.frames[self._name], self._take.rig.names.index(self._name)
        rng = np.random.default_rng([self._take.seed, 7, camera, beat])
        filmed = self._views.film(self._name, float(times.world_s[row]), rng)
        quarters = self._take.settings.video.rotation_deg // 90
        self._writer.write(
            np.rot90(filmed.image, -quarters), float(times.stamp_s[row]) - self._start_s
        )
        return filmed


def _suffix(take: Take) -> str:
    return ".mkv" if take.settings.video.codec == "lossless" else ".mp4"


def sources_of(take: Take) -> tuple[Source, ...]:
    """What sounds in a take."""
    found = []
    if take.settings.performance.voice:
        found.append(scene_source(np.array(_MOUTH_MM), take.scenes.sound, SCENE_S))
    if take.claps:
        found.append(clap_source(np.array(_HANDS_MM), take.claps))
    return tuple(found)


def _join(take: Take, pieces: Sequence[Path], folder: Path) -> None:
    """Everything that a take's folder holds, from its pieces."""
    suffix, sources = _suffix(take), sources_of(take)
    step = round(PIECE_S * take.settings.cameras.rate_hz)
    for i, (name, camera) in enumerate(take.rig.cameras.items()):
        times = take.frames[name]
        parts = [p / f"{name}{suffix}" for p in pieces]
        parts = [p for p in parts if p.exists()]
        which = times.frame // step
        starts = [float(times.stamp_s[which == k][0]) for k in np.unique(which)]
        heard = HeardSound(
            sources,
            camera.position,
            take.clocks[name],
            seconds=take.settings.seconds,
            noise_seed=take.seed * 16 + i,
        )
        join_videos(
            parts,
            folder / f"{name}{suffix}",
            starts_s=starts,
            audio=heard if sources else None,
            rotation_deg=take.settings.video.rotation_deg,
        )
    if sources:
        write_audio(folder / "audio.wav", record(sources, take.settings.seconds))
    join_truth([p / "truth.npz" for p in pieces], folder / "truth.npz", _constant_truth(take))
    write_rig(folder / "rig.json", take.rig)
    write_take_settings(folder / "take.toml", take.settings, take.seed)
    if take.marker_set is not None:
        write_marker_set(folder / "markers.toml", _measured(take, take.marker_set))


def _measured(take: Take, marker_set: MarkerSet) -> MarkerSet:
    """The marker set with its markers' size, and the actor's units as callipers give them."""
    units = {
        name: round(round(getattr(take.head.fapu, name) / CALLIPER_MM) * CALLIPER_MM, 6)
        for name in ("irisd", "es", "ens", "mns", "mw")
    }
    markers = take.markers
    assert markers is not None
    return replace(
        marker_set,
        fapu=Fapu(**units),
        diameter_mm=2 * float(np.median(markers.radius_mm)),
        standoff_mm=float(np.median(markers.stand_off_mm)) if markers.kind == "spheres" else 0.0,
    )


def _truth_arrays(take: Take, beats: slice, keep_vertices: bool) -> dict[str, NDArray[np.generic]]:
    """The rows of ``truth.npz`` at some beats.

    ``time_s`` (T,) s, world clock; ``marker_positions`` and ``marker_skin`` (T, M, 3) mm, world;
    ``faps`` (T, 68) table units, NaN where the head has none; ``head_quaternion`` (T, 4) wxyz and
    ``head_translation`` (T, 3) mm, world from head; ``feature_points`` (T, P, 3) and
    ``landmarks`` (T, L, 3) mm, head frame; ``arkit_weights`` (T, 52); ``gaze`` (T, 2, 2) rad;
    ``jaw_quaternion`` (T, 4), ``jaw_translation`` (T, 3) mm, head frame; if asked for,
    ``vertices`` (T, V, 3) float32, mm, head frame.
    """
    truth: Truth = take_truth(take, beats)
    found: dict[str, NDArray[np.generic]] = {
        "time_s": truth.time_s,
        "marker_positions": truth.marker_positions,
        "marker_skin": truth.marker_skin,
        "faps": truth.faps,
        "head_quaternion": truth.head_quaternion,
        "head_translation": truth.head_translation,
        "feature_points": np.stack(list(truth.feature_points.values()), axis=1),
        "landmarks": np.stack(list(truth.landmarks.values()), axis=1),
        "arkit_weights": truth.weights,
        "gaze": truth.gaze,
        "jaw_quaternion": truth.jaw_quaternion,
        "jaw_translation": truth.jaw_translation,
    }
    if keep_vertices:
        found["vertices"] = np.stack(
            [take.pose(float(t)).vertices.astype(np.float32) for t in truth.time_s]
        )
    return found


def _constant_truth(take: Take) -> dict[str, NDArray[np.generic]]:
    """What ``truth.npz`` holds once.

    Names: ``marker_names``, ``feature_point_names``, ``landmark_names``, ``arkit_names``,
    ``camera_names``; ``fapu`` (5,) mm: irisd es ens mns mw; ``marker_radius_mm`` (M,); the
    cameras' clocks ``clock_offset_s``, ``clock_drift`` (C,); for every camera ``frame_CAM`` (F,)
    the beat of each frame in its file, ``frame_world_s_CAM`` and ``frame_stamp_s_CAM`` (F,) when
    it was exposed and what the file says. ``clap_s`` (n,), ``sound_delay_s`` (C,) from the hands
    and ``flash_s`` (0 or 1,), world time; ``knocked_camera``, ``knock_s`` and the camera's pose
    from then on, ``knock_quaternion``, ``knock_translation``.
    """
    marks = take.head.mesh.landmarks
    assert marks is not None
    found: dict[str, NDArray[np.generic]] = {
        "marker_names": np.array(_marker_names(take), dtype=np.str_),
        "marker_radius_mm": _marker_radii(take),
        "feature_point_names": np.array(take.head.feature_points.names),
        "landmark_names": np.array(marks.names),
        "arkit_names": np.array(take.head.shape_names),
        "camera_names": np.array(take.rig.names),
        "fapu": np.array(
            [take.head.fapu.as_dict()[k] for k in ("IRISD", "ES", "ENS", "MNS", "MW")]
        ),
        "clock_offset_s": np.array([take.clocks[n].offset_s for n in take.rig]),
        "clock_drift": np.array([take.clocks[n].drift for n in take.rig]),
    }
    for name, times in take.frames.items():
        found[f"frame_{name}"] = times.frame
        found[f"frame_world_s_{name}"] = times.world_s
        found[f"frame_stamp_s_{name}"] = times.stamp_s
    if take.claps:
        hands = Source(np.array(_HANDS_MM), lambda first, last: np.zeros(last - first))
        found["clap_s"] = np.array([c.time_s for c in take.claps])
        found["sound_delay_s"] = np.array(
            [hands.delay_s(c.position) for c in take.rig.cameras.values()]
        )
    if take.flash_s is not None:
        found["flash_s"] = np.array([take.flash_s])
    if take.knock is not None:
        pose = take.knock.after.camera_from_world
        found["knocked_camera"] = np.array([take.knock.camera])
        found["knock_s"] = np.array([take.knock.time_s])
        found["knock_quaternion"] = pose.quaternion
        found["knock_translation"] = pose.translation
    return found


def _marker_names(take: Take) -> tuple[str, ...]:
    if take.wand is not None:
        return tuple(f"ball{i}" for i in range(len(BALLS_MM)))
    return () if take.markers is None else take.markers.glue.names


def _marker_radii(take: Take) -> NDArray[np.float64]:
    if take.wand is not None:
        return np.full(len(BALLS_MM), BALL_RADIUS_MM)
    return np.zeros(0) if take.markers is None else take.markers.radius_mm
