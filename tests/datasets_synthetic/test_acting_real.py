"""Acting against people: marker speeds of real takes, and the pace of real talk."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from facewright.core.phones import SILENCE
from facewright.datasets_synthetic.acting_babble import babble
from facewright.datasets_synthetic.face_motion import FaceMotion
from facewright.datasets_synthetic.performances import random_performance
from facewright.heads.head import Head

Floats = NDArray[np.float64]
RATE_HZ = 60.0
#: Real marker → feature point.
PLACES = {
    "Chin": "2.1",
    "Mouth_Down": "8.2",
    "Mouth_Up": "8.1",
    "Mouth_Lend": "8.3",
    "Mouth_Rend": "8.4",
    "Leyebrow_Inside": "4.1",
    "Reyebrow_Inside": "4.2",
}
STEADY = ("ForeHead_L", "ForeHead_M", "ForeHead_R", "NoseTop", "Leye_Inside", "Reye_Inside")


def real_paths(path: Path) -> Floats:
    """(T, N, 3) mm at `PLACES`, the head's motion taken out by the steadiest markers."""
    with open(path, encoding="utf-8", newline="") as f:
        rows = list(csv.reader(f))
    names = [c.removesuffix("_x") for c in rows[0] if c.endswith("_x")]
    table = np.array([[float(x) for x in r[1 : 1 + 3 * len(names)]] for r in rows[1:]])
    p = 10 * table.reshape(len(table), -1, 3)  # cm to mm
    steady = p[:, [names.index(n) for n in STEADY]]
    middle = steady.mean(axis=1, keepdims=True)
    U, _, Vt = np.linalg.svd(np.einsum("tni,nj->tij", steady - middle, steady[0] - middle[0]))
    assert (np.linalg.det(U @ Vt) > 0).all()  # turns, not mirror images
    return np.asarray((p[:, [names.index(n) for n in PLACES]] - middle) @ (U @ Vt))


def quick(paths: Floats) -> Floats:
    """99th percentile of each point's speed, mm/s."""
    velocity = savgol_filter(paths, 7, 3, deriv=1, delta=1 / RATE_HZ, axis=0)
    return np.asarray(np.percentile(np.linalg.norm(velocity, axis=2), 99, axis=0))


def test_a_medley_is_as_fast_as_real_faces(real_data: Path, average_head: Head) -> None:
    """Real takes: exercises of the jaw and of the cheeks, at 60 Hz."""
    takes = [real_data / "facial_markers" / f"{n}.csv" for n in ("Jaw", "Cheeks")]
    real = np.max([quick(real_paths(path)) for path in takes], axis=0)
    motion = FaceMotion(average_head)
    points = average_head.feature_points.select(tuple(PLACES.values()))
    p = random_performance(np.random.default_rng(4), average_head, seconds=12.0, rate_hz=RATE_HZ)

    acted = quick(np.array([points.at(motion.vertices(w)) for w in p.weights.values]))

    for name, ratio in zip(PLACES, acted / real, strict=True):
        assert 0.4 < ratio < 2.0, f"{name}: {ratio:.2f} of the real speed"


def test_babble_keeps_the_pace_of_read_sentences(real_data: Path) -> None:
    folder = real_data / "speech" / "labelled"
    rates = []
    for path in sorted(folder.rglob("*.phn")):
        rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        spoken = [r for r in rows if r[2] not in ("h#", "pau", "epi")]
        n = sum(not r[2].endswith("cl") for r in spoken)  # a stop is its closure and its burst
        rates.append(n * 16000 / sum(int(r[1]) - int(r[0]) for r in spoken))
    if not rates:
        pytest.skip(f"no hand labels under {folder}")
    track = babble(np.random.default_rng(0), start_s=0.6, end_s=120.0)
    said = [
        e - s
        for phone, s, e in zip(track.phones, track.start_s, track.end_s, strict=True)
        if phone != SILENCE
    ]

    assert len(rates) > 30
    assert 0.7 < len(said) / sum(said) / np.mean(rates) < 1.1, np.mean(rates)
