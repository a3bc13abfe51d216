"""The preview of a performance: source camera, tracks and animated head side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.audio import SoundTrack
from ..core.camera import Camera
from ..core.rig import Rig
from ..core.rigid import Rigid
from ..core.trajectories import Trajectories
from ..core.video import read_frames
from ..core.video_writer import VideoWriter
from ..heads.render import HeadRenderer, portrait_camera
from ..retarget.animation import HeadAnimation

PANEL = (480, 540)  # width, height
MAX_RATE_HZ = 30.0
_MARGIN = 1.35  # of the markers' box: the head is larger than its markers
_TRAIL_S = 0.2
CAPTION = 26  # px at the lower edge
#: Colours of markers by the beginning of their label, RGB.
_COLOURS = {
    "lip": (255, 112, 96),
    "chin": (255, 170, 80),
    "jaw": (255, 170, 80),
    "lid": (96, 190, 255),
    "brow": (150, 230, 120),
    "cheek": (250, 215, 90),
    "nos": (220, 150, 255),
    "head": (240, 240, 240),
}


def marker_colour(label: str) -> tuple[int, int, int]:
    """RGB by the beginning of a label, grey for others."""
    return next((c for k, c in _COLOURS.items() if label.startswith(k)), (200, 200, 200))


@dataclass(frozen=True, eq=False)
class SourceView:
    """The camera shown, and the part of its picture that holds the head.

    Attributes
    ----------
    name : str
    video : Path
    camera : Camera
    crop : (x, y, width, height) float, px
    gain : float
        Brightens dim pictures.
    """

    name: str
    video: Path
    camera: Camera
    crop: tuple[float, float, float, float]
    gain: float


def choose_view(
    rig: Rig, videos: dict[str, Path], tracks: Trajectories, forward: NDArray[np.float64]
) -> SourceView:
    """The camera that sees the face most from the front, framed on the markers.

    Parameters
    ----------
    rig : Rig
    videos : mapping from camera to file
    tracks : Trajectories
    forward : (3,) float64
        Out of the neutral face, world frame.
    """
    points = tracks.positions[~np.isnan(tracks.positions[..., 0])]
    middle = points.mean(axis=0)

    def facing(name: str) -> float:
        d = rig[name].position - middle
        return float(d @ forward / np.linalg.norm(d))

    name = max(rig.names, key=facing)
    pixels = rig[name].project(points)
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    low, high = np.percentile(pixels, [0.5, 99.5], axis=0)
    width, height = PANEL[0], PANEL[1] - CAPTION
    span = max(float((high - low)[1]), float((high - low)[0]) * height / width) * _MARGIN
    size = (span * width / height, span)
    x, y = (low + high) / 2 - np.array(size) / 2
    with closing(read_frames(videos[name], gray=True)) as frames:
        image = next(frames).image
    skin = float(np.percentile(image, 90))
    gain = float(np.clip(110 / max(skin, 20.0), 1.0, 2.5))
    return SourceView(name, videos[name], rig[name], (float(x), float(y), *size), gain)


def _affine(view: SourceView) -> NDArray[np.float64]:
    """Source pixels to panel pixels, (2, 3)."""
    x, y, width, _ = view.crop
    s = PANEL[0] / width
    return np.array([[s, 0, -s * x], [0, s, -s * y]])


def source_panels(
    view: SourceView, tracks: Trajectories, step: int
) -> Iterator[tuple[int, NDArray[np.uint8], NDArray[np.uint8]]]:
    """For every `step`-th frame: its number, the source panel and the tracks panel."""
    A = _affine(view)
    pixels = view.camera.project(tracks.positions) @ A[:, :2].T + A[:, 2]
    trail = max(1, round(_TRAIL_S * (tracks.rate_hz or 60.0)))
    size = (PANEL[0], PANEL[1] - CAPTION)
    with closing(read_frames(view.video)) as frames:
        for frame in frames:
            if frame.index % step:
                continue
            bright = np.clip(frame.image.astype(np.float32) * view.gain, 0, 255).astype(np.uint8)
            source = cv2.warpAffine(bright, A, size, flags=cv2.INTER_AREA)
            tracked = (source * 0.6).astype(np.uint8)
            _draw_tracks(tracked, pixels[: frame.index + 1], tracks, frame.index, trail)
            yield (
                frame.index,
                captioned(source, f"{view.name}  {frame.time_s:6.3f} s"),
                captioned(tracked, f"{len(tracks.names)} markers tracked"),
            )


def _draw_tracks(
    panel: NDArray[np.uint8],
    pixels: NDArray[np.float64],
    tracks: Trajectories,
    frame: int,
    trail: int,
) -> None:
    for m, name in enumerate(tracks.names):
        colour = marker_colour(name)
        path = pixels[max(0, frame - trail) : frame + 1, m]
        path = path[np.isfinite(path).all(axis=1)]
        ends = np.rint(path * 16).astype(int)
        for a, b in pairwise(ends):
            cv2.line(panel, tuple(map(int, a)), tuple(map(int, b)), colour, 1, cv2.LINE_AA, 4)
        if np.isfinite(pixels[frame, m]).all():
            at = tuple(int(v) for v in np.rint(pixels[frame, m] * 16))
            thick = 1 if tracks.is_filled[frame, m] else -1  # a ring where filled
            cv2.circle(panel, at, 4 * 16, colour, thick, cv2.LINE_AA, 4)


def captioned(panel: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """A panel with a line of text below."""
    found = np.full((PANEL[1], PANEL[0], 3), 18, np.uint8)
    found[: panel.shape[0]] = panel
    cv2.putText(
        found, text, (10, PANEL[1] - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (205, 205, 205), 1,
        cv2.LINE_AA,
    )  # fmt: skip
    return found


def preview_step(rate_hz: float) -> int:
    """Every how many frames one is shown, so that a second has at most `MAX_RATE_HZ`."""
    return max(1, round(rate_hz / MAX_RATE_HZ))


def write_previews(
    preview: Path,
    source_only: Path,
    panels: Iterable[tuple[int, NDArray[np.uint8], NDArray[np.uint8]]],
    rate_hz: float,
    animation: HeadAnimation,
    head_name: str,
    *,
    audio: SoundTrack | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> int:
    """Write the side-by-side preview, and for the page the first two panels alone.

    Parameters
    ----------
    preview : Path
        Source, tracks, animated head.
    source_only : Path
        Source and tracks, with a key frame four times a second for scrubbing.
    panels : iterable of (frame, source, tracks)
        Pictures of the size `PANEL`, and which of the animation's frames they show.
    rate_hz : float
        How many panels come a second.
    animation : HeadAnimation
    head_name : str
    audio : SoundTrack, optional
        Heard in both.
    on_frame : callable, optional

    Returns
    -------
    int
        Frames written.
    """
    width, height = PANEL
    renderer = HeadRenderer(animation.head, quick=True)
    camera = portrait_camera(animation.head, (width, height - CAPTION))
    count = 0
    with ExitStack() as stack:
        whole = stack.enter_context(VideoWriter(preview, (3 * width, height), rate_hz, audio=audio))
        left = stack.enter_context(
            VideoWriter(source_only, (2 * width, height), rate_hz, crf=21, gop=8, audio=audio)
        )
        for frame, source, tracked in panels:
            motion = animation.motion
            pose = Rigid(motion.quaternion[frame], motion.translation[frame])
            picture = renderer.render(animation.vertices(frame), camera, pose)
            head = captioned(picture, f"{head_name}, driven by FAPs")
            whole.write(np.concatenate([source, tracked, head], axis=1))
            left.write(np.concatenate([source, tracked], axis=1))
            count += 1
            if on_frame is not None:
                on_frame(count)
    return count
