"""What `facewright retarget` writes: an animated head, or curves."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError
from .heads import find_head
from .options import note
from .progress import Ticks

if TYPE_CHECKING:
    from ..core.clip import Clip
    from ..heads.head import Head
    from ..retarget.animation import HeadAnimation
    from ..retarget.resampling import FittedSound

VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm")
USD = (".usd", ".usda", ".usdc", ".usdz")
CURVES = (".csv", ".fap", ".npz")
OUTPUTS = (".glb", *USD, *VIDEOS, *CURVES, ".bvh")
#: A video's rate where the clip's own is no usual one.
VIDEO_RATE = Fraction(30)
_LEAST_VIDEO_RATE, _MOST_VIDEO_RATE = 23, 60.5


@dataclass(frozen=True)
class Drive:
    """How a clip moves a head.

    Attributes
    ----------
    head_name : str
        As the user gave it.
    points : Path or None
        Of the head's feature points.
    method : str or None
        ``points``, ``shapes``, ``direct``; None: what suits the clip.
    """

    head_name: str
    points: Path | None
    method: str | None

    @cached_property
    def head(self) -> Head:
        """The head, made when it is first needed."""
        return find_head(self.head_name, self.points)

    def method_for(self, clip: Clip) -> str:
        """`method`, else shapes for weights if the head has shapes, else points; which is said."""
        from ..retarget.conversion import clip_kind, has_known_shapes

        kind = clip_kind(clip, self.head)
        if self.method is not None:
            return self.method
        if kind == "faps":
            return "points"
        method = "shapes" if has_known_shapes(self.head) else "points"
        own = "its shapes" if method == "shapes" else "its feature points"
        note(f"the clip holds weights: {self.head.name} is driven by {own} (see --drive)")
        return method

    def animate(self, clip: Clip) -> HeadAnimation:
        """The head moving as a clip of any kind says."""
        from ..retarget.conversion import faps_of
        from ..retarget.drive import HeadDrive
        from ..retarget.shape_solver import ShapeDrive

        method = self.method_for(clip)
        if method == "points":
            by_points = HeadDrive(self.head)
            faps = faps_of(clip, self.head)
            _say_derived(faps, by_points.dead_faps)
            return by_points.animate(faps)
        drive = ShapeDrive(self.head, method=method)
        self._say_unobservable(clip, drive)
        return drive.animate(clip)

    def weights(self, clip: Clip) -> Clip:
        """Weights of the head's own shapes, by their names."""
        from ..retarget.shape_solver import ShapeDrive

        drive = ShapeDrive(self.head, method=self.method or "shapes")
        self._say_unobservable(clip, drive)
        return drive.weights(clip).clip

    def arkit(self, clip: Clip) -> Clip:
        """ARKit weights of a clip of any kind."""
        from ..retarget.conversion import arkit_of, clip_kind, has_known_shapes
        from ..retarget.shape_solver import ShapeDrive

        is_direct = self.method == "direct"
        # the table needs no head, and weights need none either
        head = None if is_direct and clip_kind_or_none(clip) is not None else self.head
        if clip_kind(clip, head) == "faps" and not is_direct:
            if has_known_shapes(head):
                assert head is not None
                self._say_unobservable(clip, ShapeDrive(head))
            else:
                note(f"head {self.head_name} has no shapes: weights are by the fixed table")
        return arkit_of(clip, head, direct=is_direct)

    def faps(self, clip: Clip) -> Clip:
        """FAPs of a clip of any kind."""
        from ..retarget.conversion import clip_kind, faps_of, has_known_shapes

        if clip_kind_or_none(clip) == "faps":
            return faps_of(clip, None)
        is_direct = self.method == "direct"
        if clip_kind(clip, self.head) == "arkit" and not (is_direct or has_known_shapes(self.head)):
            note(f"head {self.head_name} has no shapes: FAPs are by the fixed table")
        return faps_of(clip, self.head, direct=is_direct)

    def _say_unobservable(self, clip: Clip, drive: object) -> None:
        from ..retarget.conversion import clip_kind
        from ..retarget.shape_solver import ShapeDrive

        assert isinstance(drive, ShapeDrive)
        if clip_kind(clip, self.head) == "faps" and drive.method == "shapes" and drive.unobservable:
            note(
                "FAPs in whole numbers leave these shapes unsure: " + ", ".join(drive.unobservable)
            )


def _say_derived(faps: Clip, dead: tuple[str, ...]) -> None:
    """What of a clip was not given but derived, and what this head does not show."""
    import numpy as np

    from ..retarget.fap_rules import completed

    if derived := completed(faps).as_text():
        note(derived)
    lost = [name for name in dead if name in faps.channels and np.nan_to_num(faps[name]).any()]
    if lost:
        note(f"not shown by this head: {', '.join(lost)}")


def clip_kind_or_none(clip: Clip) -> str | None:
    """`conversion.clip_kind` without a head; None where only a head could tell."""
    from ..retarget.conversion import clip_kind

    try:
        return clip_kind(clip)
    except InputError:
        return None


def write_curves(out: Path, clip: Clip, drive: Drive, rate: Fraction | None) -> None:
    """Write curves: FAPs, ARKit weights, or (.npz) what the clip holds or the shapes' weights."""
    suffix = out.suffix.lower()
    if suffix == ".npz":
        from ..core.formats.clip_npz import write_clip_npz

        own = drive.method in ("shapes", "direct")
        write_clip_npz(out, drive.weights(clip) if own else clip)
    elif suffix == ".fap":
        from ..core.formats.fap import write_fap

        write_fap(out, drive.faps(clip))
    else:
        from ..core.formats.live_link_csv import USUAL_RATE, write_live_link_csv
        from ..retarget.resampling import rate_text

        used = rate or _rate_of(clip) or Fraction(USUAL_RATE)
        write_live_link_csv(out, drive.arkit(clip), rate=used)
        if used != USUAL_RATE:
            note(f"the time codes of {out.name} count {rate_text(used)} frames a second")


def write_animation(
    out: Path,
    animation: HeadAnimation,
    *,
    rate: Fraction | None,
    sound: FittedSound | None,
    size: tuple[int, int],
    morphs: str,
) -> None:
    """Write an animated head."""
    suffix = out.suffix.lower()
    if suffix in VIDEOS:
        _write_video(out, animation, rate, sound, size)
    elif suffix == ".bvh":
        from ..core.formats.bvh import write_bvh
        from ..retarget.bvh_export import animation_bvh

        write_bvh(out, animation_bvh(animation, rate))
    else:
        from ..core.formats.gltf import write_glb
        from ..retarget.export import animation_glb, frame_curves

        curves = frame_curves(animation) if morphs == "frames" else None
        scene = animation_glb(animation.head, animation, name=out.stem, curves=curves)
        if suffix == ".glb":
            write_glb(out, scene)
            return
        from ..core.formats.usd import write_usd

        audio = None if sound is None else sound.audio
        write_usd(out, scene, rate=rate or _rate_of(animation), sound=audio)


def _write_video(
    out: Path,
    animation: HeadAnimation,
    rate: Fraction | None,
    sound: FittedSound | None,
    size: tuple[int, int],
) -> None:
    from ..retarget.resampling import rate_text
    from ..retarget.video import write_head_video

    if rate is None:
        own = _rate_of(animation)
        is_usual = own is not None and _LEAST_VIDEO_RATE <= own <= _MOST_VIDEO_RATE
        rate = own if own is not None and is_usual else VIDEO_RATE
        if rate != own and len(animation) > 1:
            note(f"the video has {rate_text(rate)} frames/s, poses between keys interpolated")
    hold_s = 0.0 if sound is None else sound.hold_s
    seconds = float(animation.time_s[-1] - animation.time_s[0]) + hold_s
    with Ticks(int(seconds * rate) + 1, "drawing") as tick:
        write_head_video(
            out, animation.head, animation, size=size, rate_hz=rate,
            audio=None if sound is None else sound.audio, hold_s=hold_s, on_frame=tick,
        )  # fmt: skip


def _rate_of(timed: Clip | HeadAnimation) -> Fraction | None:
    from ..retarget.resampling import exact_rate

    return None if timed.rate_hz is None else exact_rate(timed.rate_hz)
