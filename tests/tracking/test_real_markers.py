"""Real recordings of facial markers (AnimFace, 41 markers at 60 Hz): names, and short gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.trajectories import Trajectories
from facewright.tracking.constellation import find_constellation
from facewright.tracking.face_variation import person_of_take
from facewright.tracking.gaps import fill_gaps


def real_take(path: Path) -> Trajectories:
    """The recording, mm; its columns are ``NAME_x, NAME_y, NAME_z`` in cm after the frame."""
    header = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    table = np.genfromtxt(path, delimiter=",", skip_header=1)[:1500]
    names = tuple(n.removesuffix("_x") for n in header[1::3])
    positions = table[:, 1 : 1 + 3 * len(names)].reshape(len(table), -1, 3) * 10.0
    return Trajectories(np.arange(len(table)) / 60.0, names, positions)


@pytest.mark.parametrize("name", ["Jaw.csv", "Cheeks.csv"])
def test_filled_gaps_of_real_markers_beat_straight_lines(real_data: Path, name: str) -> None:
    take = real_take(real_data / "facial_markers" / name)
    rng = np.random.default_rng(5)
    holes = []
    positions = np.array(take.positions)
    for marker in range(len(take.names)):
        for start in range(40, len(take.time_s) - 40, 60):
            first = start + int(rng.integers(20))
            rows = slice(first, first + 5)
            if not np.isnan(positions[first - 10 : first + 15, marker]).any():
                holes.append((rows, marker))
                positions[rows, marker] = np.nan
    assert len(holes) > 500

    filled = fill_gaps(Trajectories(take.time_s, take.names, positions))

    cubic, straight = [], []
    for rows, marker in holes:
        true = take.positions[rows, marker]
        ends = take.positions[[rows.start - 1, rows.stop], marker]
        line = ends[0] + np.linspace(0, 1, 7)[1:-1, None] * (ends[1] - ends[0])
        cubic.append(np.linalg.norm(filled.positions[rows, marker] - true, axis=1))
        straight.append(np.linalg.norm(line - true, axis=1))
        assert filled.is_filled[rows, marker].all()
    rms = [float(np.sqrt(np.mean(np.square(e)))) for e in (cubic, straight)]
    assert rms[0] < 0.8 * rms[1], f"cubic {rms[0]:.3f} mm, straight {rms[1]:.3f} mm"


def disturbed(
    rng: np.random.Generator, face: NDArray[np.float64], missing: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A face anywhere, larger or smaller, without some markers and with three ghosts.

    Returns the points and whose each is, −1 for a ghost.
    """
    keep = rng.permutation(len(face))[round(missing * len(face)) :]
    ghosts = rng.uniform(face.min(axis=0), face.max(axis=0), size=(3, 3))
    points = np.concatenate([face[keep], ghosts])
    owners = np.concatenate([keep, [-1, -1, -1]])
    order = rng.permutation(len(points))
    R, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 200, 3)
    return rng.uniform(0.9, 1.1) * points[order] @ R.T + shift, owners[order]


@pytest.mark.parametrize(("template", "other"), [("Jaw", "Cheeks"), ("Cheeks", "Jaw")])
@pytest.mark.parametrize("missing", [0.0, 0.05, 0.1])
def test_single_frames_are_named_from_the_other_take(
    real_data: Path, template: str, other: str, missing: float
) -> None:
    """The markers were glued anew between the takes, up to 3 mm from where they were."""
    folder = real_data / "facial_markers"
    person = person_of_take(real_take(folder / f"{template}.csv"))
    take = real_take(folder / f"{other}.csv")
    rng = np.random.default_rng([11, round(100 * missing)])

    right = wrong = visible = 0
    for frame in rng.integers(len(take.time_s), size=12):
        points, owners = disturbed(rng, np.asarray(take.positions[frame]), missing)
        found = find_constellation(points, person).point_of_label
        named = np.flatnonzero(found >= 0)
        is_right = owners[found[named]] == named
        right, wrong = right + int(is_right.sum()), wrong + int((~is_right).sum())
        visible += int((owners >= 0).sum())

    assert wrong <= (0 if missing < 0.1 else 1)
    assert right >= 0.98 * visible, f"{right} of {visible} named"
