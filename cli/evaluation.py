"""How far each stage was off, against a synthetic take's exact truth."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..core.mpeg4 import Fapu, fap_by_name
from ..core.rigid import rotation_from_quaternion
from ..core.video import read_frames
from ..tracking.blobs import BlobSettings, find_blobs, find_level

if TYPE_CHECKING:
    from ..core.clip import Clip
    from ..core.head_motion import HeadMotion
    from ..core.trajectories import Trajectories
    from ..tracking.performance import TrackedPerformance

UNOCCLUDED = 0.99  # share of a dot's picture that must be seen for its centre to be judged
_NEAR_PX = 3.0
MIN_RANGE_MM, MIN_RANGE_RAD = 3.0, float(np.deg2rad(3.0))


@dataclass(frozen=True)
class Stage:
    """One measured quantity of one stage; `limit` None where it is only reported."""

    stage: str
    quantity: str
    unit: str
    value: float
    limit: float | None = None
    at_least: bool = False

    @property
    def passed(self) -> bool:
        """Whether the limit is kept (True where there is none)."""
        if self.limit is None:
            return True
        return bool(self.value >= self.limit if self.at_least else self.value <= self.limit)

    def as_dict(self) -> dict[str, Any]:
        """For JSON: stage, quantity, unit, value, limit, passed."""
        found = asdict(self)
        del found["at_least"]
        return {**found, "passed": self.passed}


def load_truth(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a take's ``truth.npz``."""
    with np.load(path, allow_pickle=False) as z:
        return {name: z[name] for name in z.files}


def centre_errors(
    videos: Sequence[Path], truth: dict[str, NDArray[Any]], *, step: int = 1
) -> NDArray[np.float64]:
    """Errors of dots' centres in the decoded videos, (n, 2) px; a row for each unoccluded dot.

    NaN where no dot was found within 3 px of the true centre.

    Parameters
    ----------
    videos : sequence of Path
        One a camera, named after it.
    truth : dict
    step : int
        Every so many frames.
    """
    names = [str(n) for n in truth["camera_names"]]
    errors = []
    for path in videos:
        c = names.index(path.stem)
        settings: BlobSettings | None = None
        with closing(read_frames(path, gray=True)) as frames:
            for frame in frames:
                settings = settings or BlobSettings(find_level(frame.image))
                if frame.index % step:
                    continue
                true = truth["marker_pixels"][frame.index, c]
                seen = truth["marker_visible"][frame.index, c] >= UNOCCLUDED
                found = find_blobs(frame.image, settings).centres
                off = np.full((int(seen.sum()), 2), np.nan)
                if len(found) and len(off):
                    d = np.linalg.norm(found[None] - true[seen][:, None], axis=2)
                    near = d.min(axis=1) < _NEAR_PX
                    off[near] = (found[d.argmin(axis=1)] - true[seen])[near]
                errors.append(off)
    return np.concatenate(errors)


def position_errors_mm(
    trajectories: Trajectories, truth: dict[str, NDArray[Any]]
) -> NDArray[np.float64]:
    """Distances of labelled markers from the truth, (T, M) mm, in the truth's marker order."""
    return np.asarray(np.linalg.norm(_positions(trajectories, truth) - _true(truth), axis=2))


def identity_switches(trajectories: Trajectories, truth: dict[str, NDArray[Any]]) -> int:
    """Samples that lie nearer to another marker's true place than to their own."""
    found, true = _positions(trajectories, truth), _true(truth)
    wrong = 0
    for frame in range(len(found)):
        known = ~np.isnan(found[frame, :, 0])
        d = np.linalg.norm(found[frame, known][:, None] - true[frame][None], axis=2)
        wrong += int((d.argmin(axis=1) != np.flatnonzero(known)).sum())
    return wrong


def _positions(trajectories: Trajectories, truth: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    names = tuple(str(n) for n in truth["marker_names"])
    return trajectories.select(names).positions


def _true(truth: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    return np.asarray(truth["marker_positions"], dtype=np.float64)


def rotation_errors_rad(motion: HeadMotion, truth: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    """Angles between found and true head rotation, (T,) rad; NaN where unknown."""
    true = rotation_from_quaternion(truth["head_quaternion"])
    off = np.swapaxes(true, 1, 2) @ motion.rotation
    twist = np.stack(
        [off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]],
        axis=1,
    )
    cosine = (np.trace(off, axis1=1, axis2=2) - 1) / 2
    return np.asarray(np.arctan2(np.linalg.norm(twist, axis=1) / 2, cosine))


def fap_errors_percent(clip: Clip, truth: dict[str, NDArray[Any]]) -> dict[str, float]:
    """RMS error of every FAP of a clip, in per cent of its used range.

    The used range is the 1st to 99th percentile of the truth over the take, never below 3 mm
    (3° for rotations). FAPs that the actor's head does not have are left out.
    """
    fapu = Fapu(*(float(x) for x in truth["fapu"]))
    found = {}
    for name in clip.channels:
        fap = fap_by_name()[name]
        true = truth["faps"][:, fap.number - 1]
        if np.isnan(true).all():
            continue
        unit = fapu.unit(fap)
        least = (MIN_RANGE_RAD if fap.fapu == "AU" else MIN_RANGE_MM) / unit
        used = max(float(np.percentile(true, 99) - np.percentile(true, 1)), least)
        error = clip[name] - true
        found[name] = float(100 * np.sqrt(np.nanmean(error**2)) / used)
    return found


def evaluate(
    videos: Sequence[Path],
    truth: dict[str, NDArray[Any]],
    trajectories: Trajectories,
    performance: TrackedPerformance,
    *,
    centre_step: int = 1,
) -> list[Stage]:
    """All stages of tracking against the truth, with the limits that the project sets itself."""
    pixels = centre_errors(videos, truth, step=centre_step)
    mm = position_errors_mm(trajectories, truth)
    names = tuple(str(n) for n in truth["marker_names"])
    measured = ~np.isnan(mm) & trajectories.select(names).is_measured
    angles = np.rad2deg(rotation_errors_rad(performance.head_motion, truth))
    percent = fap_errors_percent(performance.faps, truth)
    tracked = [v for n, v in percent.items() if n not in performance.approximated]
    stood_in = [v for n, v in percent.items() if n in performance.approximated]
    true_fapu = np.asarray(truth["fapu"], dtype=np.float64)
    found_fapu = np.array(list(performance.fapu.as_dict().values()))
    found = [
        Stage("dots", "centre in the image, RMS", "px", _rms(pixels, per_point=True), 0.10),
        Stage(
            "dots", "unoccluded ones found", "%", 100 - float(100 * np.isnan(pixels[:, 0]).mean())
        ),
        Stage("markers", "position in space, RMS", "mm", _rms(mm[measured]), 0.10),
        Stage("markers", "positions put into gaps, RMS", "mm", _rms(mm[~measured])),
        Stage("markers", "samples without position", "%", float(100 * np.isnan(mm).mean())),
        Stage("labels", "identity switches", "", identity_switches(trajectories, truth), 0),
        Stage("head", "rotation, RMS", "°", _rms(angles), 0.10),
    ]
    if performance.head_motion_linear is not None:
        linear = np.rad2deg(rotation_errors_rad(performance.head_motion_linear, truth))
        found.append(Stage("head", "rotation by the linear method, RMS", "°", _rms(linear)))
    off = float(100 * np.abs(found_fapu / true_fapu - 1).max())
    median, worst = float(np.median(tracked)), float(np.max(tracked))
    found += [
        Stage("FAPs", "units of the face, largest error", "%", off),
        Stage("FAPs", "tracked points, median RMS of used range", "%", median, 2),
        Stage("FAPs", "tracked points, worst RMS of used range", "%", worst, 5),
    ]
    if stood_in:
        value = float(np.median(stood_in))
        found.append(Stage("FAPs", "inner lip after outer, median RMS", "%", value))
    return found


def _rms(values: NDArray[np.float64], *, per_point: bool = False) -> float:
    """Root mean square of numbers, or of the lengths of rows; NaN left out, 0 for none."""
    squares = (values**2).sum(axis=-1) if per_point else np.asarray(values) ** 2
    squares = squares[~np.isnan(squares)]
    return float(np.sqrt(squares.mean())) if squares.size else 0.0
