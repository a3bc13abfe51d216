"""From pictures to geometry: lenses, rigs, clocks and boards, usable without files.

    from facewright.capture import calibrate_board, detect_board

Names are imported when they are first used, since what is behind them takes seconds to load.
`tsai` and `synchronise` are functions, and modules of these names hold them: of a module ask for
what is in it, ``from facewright.capture.tsai import TsaiCalibration``.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .board_detection import Detection, detect_board, flip_view
    from .camera_shifts import CameraShift
    from .clock_fit import ClockFit
    from .flash_match import synchronise_by_flashes
    from .flashes import Flash, find_flashes
    from .lens import LENS_MODELS, BoardView, LensCalibration, calibrate_board, point_sd_mm
    from .marker_rig import RigRefinement, camera_shifts, refine_rig
    from .motion_clock import synchronise_motion
    from .pose import PoseEstimate, estimate_pose
    from .rig_uncertainty import TriangulationSd, triangulation_sd_mm
    from .rigs import RigCalibration, calibrate_rig
    from .rolling_shutter import Readout, estimate_readout
    from .synchronise import (
        synchronise,
        synchronise_flash_light,
        synchronise_flashes,
        synchronise_sound,
    )
    from .tsai import Parameter, TsaiCalibration, tsai
    from .view_choice import choose_frames
    from .wand_rig import calibrate_wand

__all__ = [
    "LENS_MODELS",
    "BoardView",
    "CameraShift",
    "ClockFit",
    "Detection",
    "Flash",
    "LensCalibration",
    "Parameter",
    "PoseEstimate",
    "Readout",
    "RigCalibration",
    "RigRefinement",
    "TriangulationSd",
    "TsaiCalibration",
    "calibrate_board",
    "calibrate_rig",
    "calibrate_wand",
    "camera_shifts",
    "choose_frames",
    "detect_board",
    "estimate_pose",
    "estimate_readout",
    "find_flashes",
    "flip_view",
    "point_sd_mm",
    "refine_rig",
    "synchronise",
    "synchronise_by_flashes",
    "synchronise_flash_light",
    "synchronise_flashes",
    "synchronise_motion",
    "synchronise_sound",
    "triangulation_sd_mm",
    "tsai",
]
_MODULES = {
    "board_detection": ("Detection", "detect_board", "flip_view"),
    "camera_shifts": ("CameraShift",),
    "clock_fit": ("ClockFit",),
    "flash_match": ("synchronise_by_flashes",),
    "flashes": ("Flash", "find_flashes"),
    "lens": ("LENS_MODELS", "BoardView", "LensCalibration", "calibrate_board", "point_sd_mm"),
    "marker_rig": ("RigRefinement", "camera_shifts", "refine_rig"),
    "motion_clock": ("synchronise_motion",),
    "pose": ("PoseEstimate", "estimate_pose"),
    "rig_uncertainty": ("TriangulationSd", "triangulation_sd_mm"),
    "rigs": ("RigCalibration", "calibrate_rig"),
    "rolling_shutter": ("Readout", "estimate_readout"),
    "synchronise": (
        "synchronise",
        "synchronise_flash_light",
        "synchronise_flashes",
        "synchronise_sound",
    ),
    "tsai": ("Parameter", "TsaiCalibration", "tsai"),
    "view_choice": ("choose_frames",),
    "wand_rig": ("calibrate_wand",),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}


if not TYPE_CHECKING:  # to a type checker only the names above are there

    def __getattr__(name: str) -> object:
        """A public name, from the module that holds it."""
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = getattr(import_module(f".{_HOME[name]}", __name__), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Room(ModuleType):
    """A package whose functions are not hidden by modules of the same name.

    Whoever imports ``capture/tsai.py`` makes Python set ``capture.tsai`` to the module: whether
    it names the function would depend on what was imported before.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Room
