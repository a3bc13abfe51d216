"""Films a marker take: videos, camera rig, marker set and exact truth in one folder."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.formats.markers_toml import write_marker_set
from ..core.formats.rig_json import write_rig
from ..core.markers import MarkerSet
from ..core.mpeg4 import Fapu
from ..core.video_writer import VideoWriter
from .takes import Take, Truth, take_truth
from .views import TakeRenderer

MAX_BIT_RATE = 1_600_000  # an average over two seconds; files come out below 2 Mbit/s
CRF = 13
CALLIPER_MM = 0.1  # the actor's units are measured to this


@dataclass(frozen=True)
class FilmedTake:
    """Files of a filmed take."""

    folder: Path
    rig: Path
    marker_set: Path
    truth: Path
    videos: tuple[Path, ...]


def film_take(
    take: Take,
    folder: Path,
    *,
    noise: bool = True,
    on_frame: Callable[[int], None] | None = None,
) -> FilmedTake:
    """Film a take into a folder that exists.

    Writes ``rig.json``, ``markers.toml`` (with the actor's units, measured to 0.1 mm), one
    ``cam*.mp4`` a camera (H.264, at most 2 Mbit/s) and ``truth.npz``. Files appear when all are
    whole; an interruption leaves none.

    Parameters
    ----------
    take : Take
    folder : Path
    noise : bool
        Shot and read noise of the cameras.
    on_frame : callable, optional
        Told each finished frame's index.
    """
    with tempfile.TemporaryDirectory(prefix=".filming-", dir=folder) as scratch:
        _film(take, Path(scratch), noise, on_frame)
        for path in sorted(Path(scratch).iterdir()):
            path.replace(folder / path.name)
    return FilmedTake(
        folder,
        folder / "rig.json",
        folder / "markers.toml",
        folder / "truth.npz",
        tuple(folder / f"{name}.mp4" for name in take.rig),
    )


def _film(take: Take, folder: Path, noise: bool, on_frame: Callable[[int], None] | None) -> None:
    rate = 1.0 / float(take.time_s[1] - take.time_s[0])
    renderer = TakeRenderer(take)
    rng = np.random.default_rng([take.seed, 1])
    n_frames, n_cameras = len(take.time_s), len(take.rig)
    centres = np.full((n_frames, n_cameras, len(take.glue), 2), np.nan)
    visible = np.zeros((n_frames, n_cameras, len(take.glue)))
    with ExitStack() as stack:
        writers = [
            stack.enter_context(
                VideoWriter(
                    folder / f"{name}.mp4",
                    camera.image_size,
                    round(rate, 3),
                    crf=CRF,
                    max_bit_rate=MAX_BIT_RATE,
                )
            )
            for name, camera in take.rig.cameras.items()
        ]
        for frame in range(n_frames):
            views = renderer.frame(frame, rng, noise=noise)
            for c, (writer, view) in enumerate(zip(writers, views.values(), strict=True)):
                writer.write(view.image)
                centres[frame, c], visible[frame, c] = view.centres, view.visible
            if on_frame is not None:
                on_frame(frame)
    write_truth(folder / "truth.npz", take, take_truth(take), centres, visible)
    write_rig(folder / "rig.json", take.rig)
    write_marker_set(folder / "markers.toml", _measured(take))


def _measured(take: Take) -> MarkerSet:
    """The marker set with the actor's units as callipers give them."""
    units = {
        name: round(round(getattr(take.head.fapu, name) / CALLIPER_MM) * CALLIPER_MM, 6)
        for name in ("irisd", "es", "ens", "mns", "mw")
    }
    return replace(take.marker_set, fapu=Fapu(**units))


def write_truth(
    path: Path,
    take: Take,
    truth: Truth,
    centres: NDArray[np.float64] | None = None,
    visible: NDArray[np.float64] | None = None,
) -> None:
    """Write `truth.npz`.

    ``time_s`` (T,) s; ``marker_names`` (M,); ``marker_positions`` (T, M, 3) mm, world; ``faps``
    (T, 68) table units, NaN where the head has none; ``head_quaternion`` (T, 4) wxyz and
    ``head_translation`` (T, 3) mm, world from head; ``fapu`` (5,) mm: irisd es ens mns mw;
    ``feature_point_names`` (P,) and ``feature_points`` (T, P, 3) mm, head frame;
    ``arkit_names`` (52,) and ``arkit_weights`` (T, 52); and from the pictures ``marker_pixels``
    (T, C, M, 2) px and ``marker_visible`` (T, C, M), the unhidden share of each dot.
    """
    arrays: dict[str, NDArray[np.generic]] = {
        "time_s": take.time_s,
        "marker_names": np.array(take.glue.names),
        "marker_positions": truth.marker_positions,
        "faps": truth.faps,
        "head_quaternion": take.head_motion.quaternion,
        "head_translation": take.head_motion.translation,
        "fapu": np.array(
            [take.head.fapu.as_dict()[k] for k in ("IRISD", "ES", "ENS", "MNS", "MW")]
        ),
        "feature_point_names": np.array(list(truth.feature_points)),
        "feature_points": np.stack(list(truth.feature_points.values()), axis=1),
        "arkit_names": np.array(take.performance.weights.channels),
        "arkit_weights": take.performance.weights.values,
        "camera_names": np.array(take.rig.names),
    }
    if centres is not None and visible is not None:
        arrays |= {"marker_pixels": centres, "marker_visible": visible}
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]
