"""Predictions, against motion that is known exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.tracking.prediction import Prediction

Floats = NDArray[np.float64]


def nodding(n_frames: int = 120, own_mm: float = 0.0) -> Floats:
    """(T, 20, 3) mm: a head that nods and wanders at 60 Hz; markers may move by themselves."""
    rng = np.random.default_rng(0)
    t = np.arange(n_frames) / 60
    points = rng.uniform((-60, -90, 0), (60, 90, 70), size=(20, 3))
    phase = rng.uniform(0, 6, size=(20, 3))
    own = own_mm * np.sin(2 * np.pi * 3 * t[:, None, None] + phase)
    turns = Rotation.from_euler("xy", 0.3 * np.sin(np.outer(t, (5.0, 3.5)))).as_matrix()
    shift = 20 * np.sin(np.outer(t, (2.0, 3.0, 1.0)))
    return np.asarray(np.einsum("tij,tmj->tmi", turns, points + own) + shift[:, None])


def follow(truth: Floats, hidden: NDArray[np.bool_]) -> tuple[float, float]:
    """RMS of predictions before a frame is seen, and of hidden markers once the others are."""
    prediction = Prediction()
    prediction.begin(truth[0])
    before, given_others = [], []
    for points, out in zip(truth[1:], hidden[1:], strict=True):
        here = np.where(out[:, None], np.nan, points)
        before.append((prediction.predict() - points)[~out & (prediction.unseen == 0)])
        prediction.learn_common_motion(here)
        given_others.append((prediction.predict() - points)[out])
        prediction.update(here)

    def rms(errors: list[Floats]) -> float:
        return float(np.sqrt((np.concatenate(errors[5:]) ** 2).sum(axis=1).mean()))

    return rms(before), rms(given_others) if hidden.any() else np.nan


def test_predictions_beat_constant_velocity() -> None:
    truth = nodding(own_mm=2.0)

    error, _ = follow(truth, np.zeros(truth.shape[:2], bool))

    steps = np.diff(truth, axis=0)
    constant = np.sqrt((np.diff(steps, axis=0) ** 2).sum(axis=2).mean())
    assert error < 0.75 * constant


def test_hidden_markers_of_a_rigid_head_are_carried_exactly() -> None:
    truth = nodding()
    hidden = np.zeros(truth.shape[:2], bool)
    hidden[40:70, 3:6] = True

    _, error = follow(truth, hidden)

    steps = np.linalg.norm(truth[70] - truth[39], axis=1)
    assert steps.max() > 5
    assert error < 0.5  # after half a second


def test_few_markers_are_predicted_each_by_itself() -> None:
    truth = nodding()[:, :4]

    error, _ = follow(truth, np.zeros(truth.shape[:2], bool))

    constant = np.sqrt((np.diff(truth, n=2, axis=0) ** 2).sum(axis=2).mean())
    assert error < 0.75 * constant


def test_markers_that_do_not_move_are_predicted_where_they_are() -> None:
    still = np.tile(nodding()[0], (30, 1, 1))

    error, _ = follow(still, np.zeros(still.shape[:2], bool))

    assert error < 1e-9


def test_markers_on_a_line_do_not_break_it() -> None:
    line = np.arange(10)[:, None] * np.array([[5.0, 1.0, 0.0]])
    truth = np.stack([line + i * np.array([0.3, 0.2, 0.1]) for i in range(20)])

    error, _ = follow(truth, np.zeros(truth.shape[:2], bool))

    assert error < 1e-6
