"""A calibration wand: three balls on a line, waved through the space before the cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .markers_on_faces import SPHERE_LIGHT, Lights

#: Places of the balls along the wand, mm: uneven, so that its ends can be told apart.
BALLS_MM = (0.0, 45.0, 120.0)
BALL_RADIUS_MM = 4.0
_REACH_MM = np.array([85.0, 75.0, 70.0])
_CENTRE_MM = np.array([0.0, -15.0, 10.0])
_N_WAVES = 4


@dataclass(frozen=True, eq=False)
class Wand:
    """A wand in motion.

    Attributes
    ----------
    waves : (N_WAVES, 6, 3) float64
        Amplitude share, frequency (Hz) and phase of each coordinate and angle.
    """

    waves: NDArray[np.float64]

    @classmethod
    def random(cls, rng: np.random.Generator) -> Wand:
        """Draw a way through the space, at up to about 0.5 m/s."""
        share = rng.dirichlet(np.full(_N_WAVES, 2.0), size=6).T
        frequency = rng.uniform(0.1, 0.7, size=(_N_WAVES, 6))
        phase = rng.uniform(0, 2 * np.pi, size=(_N_WAVES, 6))
        return cls(np.stack([share, frequency, phase], axis=-1))

    def balls(self, time_s: float) -> NDArray[np.float64]:
        """Centres of the balls, (3, 3) mm, world frame."""
        share, frequency, phase = np.moveaxis(self.waves, -1, 0)
        wander = (share * np.sin(2 * np.pi * frequency * time_s + phase)).sum(axis=0) * 1.6
        middle = _CENTRE_MM + _REACH_MM * wander[:3]
        along = Rotation.from_rotvec(np.pi * wander[3:]).apply([1.0, 0.0, 0.0])
        offsets = np.array(BALLS_MM) - np.mean(BALLS_MM)
        return np.asarray(middle + offsets[:, None] * along)

    def lights(self, time_s: float) -> Lights:
        """The balls as what shines in a room."""
        return Lights(self.balls(time_s), np.full(3, BALL_RADIUS_MM), np.full(3, SPHERE_LIGHT))
