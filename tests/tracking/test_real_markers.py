"""Short gaps in real recordings of facial markers (AnimFace, 41 markers at 60 Hz)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.core.trajectories import Trajectories
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
