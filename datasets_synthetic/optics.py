"""What stands between the light and the numbers of a camera: lens, shutter, sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_FLASH_SAMPLES = 64  # of an exposure: a flash begins at once
#: From times, s, an array of any shape, to factors of all light.
Flash = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Optics:
    """Lens and shutter; the defaults are an ideal pinhole with an instant shutter.

    The distortion of the lens belongs to `core.camera.Camera`.

    Attributes
    ----------
    exposure_s : float, s
        How long each row gathers light. A frame's time is the middle of the middle row's exposure.
    readout_s : float, s
        From the first row's exposure to the last row's (rolling shutter); 0 for a global shutter.
    pupil_mm : float, mm
        Diameter of the entrance pupil: what is out of focus is blurred by it.
    focus_mm : float, mm
        Depth that is sharp.
    psf_px : float, px
        Standard deviation of the lens's own Gaussian blur.
    vignetting : float
        Share of the light lost in the corners; grows with the square of the distance from the
        principal point.
    ghost : float
        Share of the light that reflections within the lens throw to the place mirrored through
        the principal point.
    """

    exposure_s: float = 0.0
    readout_s: float = 0.0
    pupil_mm: float = 0.0
    focus_mm: float = 750.0
    psf_px: float = 0.0
    vignetting: float = 0.0
    ghost: float = 0.0

    def __post_init__(self) -> None:
        for name in ("exposure_s", "readout_s", "pupil_mm", "psf_px", "vignetting", "ghost"):
            if not 0 <= getattr(self, name) < 1e3:
                raise ValueError(f"{name} must be at least 0, got {getattr(self, name)}")
        if not self.focus_mm > 0:
            raise ValueError(f"focus_mm must lie above 0, got {self.focus_mm}")

    def row_delay_s(self, row: float, height: int) -> float:
        """When a row is exposed, against the frame's time."""
        return self.readout_s * (row / max(height - 1, 1) - 0.5)

    def blur_diameter_px(self, depth_mm: float, focal_px: float) -> float:
        """Circle of confusion of a point at a depth (thin lens)."""
        return focal_px * self.pupil_mm * abs(1 / depth_mm - 1 / self.focus_mm)


@dataclass(frozen=True)
class Sensor:
    """From light to numbers: level = 255 (gain · light)^(1 / gamma), with noise before the power.

    Attributes
    ----------
    gain : float
        Exposure: linear light of 1 / gain saturates.
    full_well_e : float
        Electrons at saturation, which set the shot noise; infinite for none.
    read_noise_e : float
        Standard deviation of the read noise, electrons.
    gamma : float
        1 for linear numbers, 2.2 for pictures made to be looked at.
    black_level : float
        Grey level of no light.
    """

    gain: float = 1.0
    full_well_e: float = 12000.0
    read_noise_e: float = 12.0
    gamma: float = 1.0
    black_level: float = 0.0

    def __post_init__(self) -> None:
        if not (self.gain > 0 and self.full_well_e > 0 and self.gamma > 0):
            raise ValueError("gain, full_well_e and gamma must lie above 0")
        if not (self.read_noise_e >= 0 and 0 <= self.black_level < 255):
            raise ValueError("read_noise_e must be at least 0, black_level in 0 to 255")


#: A sensor without noise.
NOISELESS = Sensor(full_well_e=float("inf"), read_noise_e=0.0)


def flash_rows(flash: Flash, optics: Optics, height: int, time_s: float) -> NDArray[np.float32]:
    """Factor of the light in each row of a frame while a flash shines, (h, 1).

    Parameters
    ----------
    flash : Flash
    optics : Optics
    height : int
    time_s : float
        The frame's.
    """
    n = _FLASH_SAMPLES if optics.exposure_s > 0 else 1
    instants = optics.exposure_s * ((np.arange(n) + 0.5) / n - 0.5)
    rows = np.arange(height) if optics.readout_s else np.array([(height - 1) / 2])
    delays = optics.readout_s * (rows / max(height - 1, 1) - 0.5)
    factor = flash(time_s + delays[:, None] + instants).mean(axis=1)
    return np.broadcast_to(factor.astype(np.float32)[:, None], (height, 1))
