"""A rig from the board that a take shows, for `facewright calibrate rig`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from ..core.errors import InputError
from .options import note
from .progress import progress
from .rig_sightings import Sightings

if TYPE_CHECKING:
    from ..capture.lens import BoardView, LensCalibration, RejectedView
    from ..capture.rigs import RigCalibration
    from ..capture.shutter_check import BoardSpeed, ShutterCheck
    from ..capture.synchronise import ClockFit
    from ..core.boards import Board
    from ..core.camera import Camera

_MIN_LENS_VIEWS = 4
#: All cameras together leave so many times what each view alone does, and more than this, px.
_APART_TIMES, _APART_PX = 4.0, 0.3
#: A clock's standard deviation that lets the board go further than this matters, mm.
_CLOCK_MATTERS_MM = 0.1


@dataclass(frozen=True, eq=False)
class RigResult:
    """A calibrated rig with all that its report tells.

    Attributes
    ----------
    found : RigCalibration
        Its rejected views and warnings include those of detection and of the lenses.
    lenses : mapping from camera to LensCalibration
        Empty where lenses were given.
    views : mapping from camera to views
        As handed to the solver.
    clocks : mapping from camera to ClockFit
    board : Board
    speeds : mapping from camera to BoardSpeed
        Empty where there are pictures, not videos.
    shutters : mapping from camera to ShutterCheck
        Empty if not looked at.
    notes : tuple of str
    """

    found: RigCalibration
    lenses: Mapping[str, LensCalibration]
    views: Mapping[str, list[BoardView]]
    clocks: Mapping[str, ClockFit]
    board: Board
    speeds: Mapping[str, BoardSpeed] = field(default_factory=dict)
    shutters: Mapping[str, ShutterCheck] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def rig_by_board(
    seen: Sightings,
    pattern: Board,
    known: Mapping[str, Camera] | None,
    model: str | None,
    world: str,
    *,
    look_at_shutters: bool = False,
) -> RigResult:
    """Lenses from each camera's own views (unless known), then all cameras together.

    Raises
    ------
    InputError
        If two cameras do not share views, a lens cannot be found, or there is no such world.
    """
    from ..capture.board_turns import agree_on_turns
    from ..capture.rigs import calibrate_rig
    from .rig_shutters import shutters_of, speeds_of

    blind = [name for name, views in seen.views.items() if not views]
    views = {name: list(found) for name, found in seen.views.items() if found}
    if len(views) < 2:
        raise InputError(_nobody(seen, pattern, views))
    _check_world(world, views)
    lenses, found_lenses, views, rejected = _lenses(seen, views, known, model)
    views, n_turned = agree_on_turns(views, lenses, pattern)
    notes = list(seen.notes)
    if n_turned:
        notes.append(f"{pattern} looks the same when turned: {n_turned} views were turned to agree")
        note(notes[-1])
    refine = {name: lens.model for name, lens in found_lenses.items()}
    found = calibrate_rig(
        views, lenses, refine=refine, world="camera" if world == "head" else world
    )
    if world == "head":
        found = around_head(found)
    speeds = speeds_of(seen, found.rig, pattern)
    shutters = shutters_of(seen, found.rig, pattern, speeds) if look_at_shutters else {}
    said = [f"{name}: never saw the board, and is left out" for name in blind]
    said += [
        f"{name}: {warning}" for name, lens in found_lenses.items() for warning in lens.warnings
    ]
    said += [f"{name}: {check.warning}" for name, check in shutters.items() if check.matters]
    said += _unsure_clocks(seen.clocks, speeds)
    said += _out_of_step(found, views, seen)
    found = replace(
        found,
        views_rejected=(*seen.rejected, *rejected, *found.views_rejected),
        unconnected=(*found.unconnected, *blind),
        warnings=(*seen.warnings, *found.warnings, *said),
    )
    return RigResult(
        found, found_lenses, views, seen.clocks, pattern, speeds, shutters, tuple(notes)
    )


def _out_of_step(
    found: RigCalibration, views: Mapping[str, list[BoardView]], seen: Sightings
) -> list[str]:
    """Says so where views that each camera explains alone do not fit together."""
    import numpy as np

    from ..capture.lens import board_pose
    from ..core.rigid import Rigid

    by_key = {(camera, v.name): v for camera, shown in views.items() for v in shown}
    alone = []
    for key in found.residuals:
        camera, view = replace(found.rig[key[0]], camera_from_world=Rigid.identity()), by_key[key]
        pose = Rigid.from_rotation(*board_pose(view, camera))
        off = camera.project(pose.apply(view.points)) - view.pixels
        alone.append(float((off**2).sum(axis=1).mean()))
    each_px = float(np.sqrt(np.median(alone)))
    if not found.rms_used_px > max(_APART_TIMES * each_px, _APART_PX):
        return []
    hint = "; try --sync motion" if seen.videos and not seen.clocks else ""
    return [
        f"the cameras' views do not fit together: {found.rms_used_px:.2g} px RMS, where each view "
        f"by itself is explained to {each_px:.2g} px: they were not taken at the same moment, or a "
        f"camera moved{hint}. This result is not to be trusted"
    ]


def _check_world(world: str, views: Mapping[str, list[BoardView]]) -> None:
    """Before the long work; the solver may yet reject the view."""
    names = list(dict.fromkeys(v.name for seen in views.values() for v in seen))
    if world not in ("camera", "head", *names):
        few = ", ".join(names[:8]) + (f", ... ({len(names)} in all)" if len(names) > 8 else "")
        raise InputError(f"--world {world}: expected camera, head or a view: {few}")


def around_head(found: RigCalibration) -> RigCalibration:
    """A calibration in the frame of the head that its cameras look at."""
    from ..capture.rig_world import head_from_world, in_world

    return in_world(found, head_from_world(found.rig))


def _lenses(
    seen: Sightings,
    views: dict[str, list[BoardView]],
    known: Mapping[str, Camera] | None,
    model: str | None,
) -> tuple[
    dict[str, Camera], dict[str, LensCalibration], dict[str, list[BoardView]], list[RejectedView]
]:
    """Lenses; how they were found, where they were; the views that suit them, and the others."""
    if known is not None:
        _check_known(known, seen)
        return dict(known), {}, views, []
    kept, rejected, found = dict(views), [], {}
    for name in progress(list(views), len(views), "lenses"):
        found[name], kept[name], bad = _lens(name, views[name], seen, model)
        rejected += bad
    return {name: lens.camera for name, lens in found.items()}, found, kept, rejected


def _unsure_clocks(clocks: Mapping[str, ClockFit], speeds: Mapping[str, BoardSpeed]) -> list[str]:
    """Says so where the board went far within what a clock is unsure of."""
    import numpy as np

    usual = [s.mm_s for s in speeds.values() if np.isfinite(s.mm_s)]
    if not usual:
        return []
    mm_s = float(np.median(usual))
    said = []
    for name, clock in clocks.items():
        off_mm = clock.offset_sd_s * mm_s
        if not off_mm <= _CLOCK_MATTERS_MM and clock.method != "motion":
            said.append(
                f"{name}: its clock is sure to {1e3 * clock.offset_sd_s:.1f} ms only, in which the "
                f"board usually went {off_mm:.2g} mm: hold it still in each place, or use "
                "--sync motion"
            )
    return said


def _nobody(seen: Sightings, pattern: Board, views: Mapping[str, object]) -> str:
    if views:
        return f"only {next(iter(views))} sees {pattern}: two cameras must see it together"
    first = "; ".join(f"{r.name}: {r.reason}" for r in seen.rejected[:3])
    if seen.rejected:
        return f"no picture shows {pattern} ({first})"
    return f"no frame shows {pattern} to two cameras at the same time"


def _lens(
    name: str, views: list[BoardView], seen: Sightings, model: str | None
) -> tuple[LensCalibration, list[BoardView], list[RejectedView]]:
    """A camera's lens, the views that are good, and the others."""
    from ..capture.board_views import without_repeats
    from ..capture.lens import RejectedView, calibrate_board

    different, _ = without_repeats(views)  # others may see there what this one sees twice
    if len(different) < _MIN_LENS_VIEWS:
        raise InputError(
            f"{name} shows the board in {len(different)} different poses: "
            f"{_MIN_LENS_VIEWS} are the least for its lens; take more, or give --lenses"
        )
    lens = calibrate_board(different, seen.image_sizes[name], model=model)
    bad = {r.name for r in lens.views_rejected}
    out = [RejectedView(f"{name}/{r.name}", r.reason) for r in lens.views_rejected]
    return lens, [v for v in views if v.name not in bad], out


def _check_known(known: Mapping[str, Camera], seen: Sightings) -> None:
    for name, size in seen.image_sizes.items():
        if name in known and known[name].image_size != size:
            w, h = known[name].image_size
            raise InputError(
                f"the lens of {name} is for pictures of {w}x{h}, but they are {size[0]}x{size[1]}"
            )
