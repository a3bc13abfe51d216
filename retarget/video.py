"""Animated heads as video files."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.audio import Audio
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rigid import Rigid
from ..core.video_writer import VideoWriter
from ..heads.head import Head
from ..heads.render import HeadRenderer, portrait_camera
from .animation import HeadAnimation
from .resampling import frame_times


def write_head_video(
    path: Path,
    head: Head,
    animation: HeadAnimation,
    *,
    size: tuple[int, int] = (720, 720),
    rate_hz: float | Fraction = 30,
    audio: Audio | None = None,
    camera: Camera | None = None,
    hold_s: float = 0.0,
    on_frame: Callable[[int, NDArray[np.uint8]], None] | None = None,
) -> int:
    """Draw an animated head, frame by frame, into a video.

    The animation is resampled to the video's rate: frame k shows the time k / rate after the
    animation's first frame.

    Parameters
    ----------
    path : Path
        ``.mp4``, ``.webm`` or what else `VideoWriter` writes; appears only when it is complete.
    head : Head
    animation : HeadAnimation
        Of this head.
    size : (width, height), px
        Both even.
    rate_hz : float or Fraction
    audio : Audio or None
        Sound that starts with the first frame.
    camera : Camera or None
        In the world of the animation's head motion, with the same image size. None: a portrait
        camera before the head at rest, for motion about the neck as FAPs give it.
    hold_s : float, s
        How long the last pose is shown after the animation's end, for sound that goes on.
    on_frame : callable or None
        Called after each frame with its number and the (h, w, 3) uint8 picture.

    Returns
    -------
    int
        Number of frames written.

    Raises
    ------
    InputError
        If the animation is another head's, or the camera has another size.
    """
    if animation.head is not head:
        raise InputError(f"the animation is of head {animation.head.name}, not of {head.name}")
    if camera is not None and tuple(camera.image_size) != tuple(size):
        raise InputError(f"the camera's picture is {camera.image_size}, the video's {size}")
    view = portrait_camera(head, size) if camera is None else camera
    start, end = float(animation.time_s[0]), float(animation.time_s[-1])
    times = frame_times(start, end + hold_s, Fraction(rate_hz).limit_denominator(1001))
    shown = animation.resampled(np.unique(np.minimum(times, end)))
    renderer = HeadRenderer(head, quick=True)
    with VideoWriter(path, size, rate_hz, audio=audio) as writer:
        for frame in range(len(times)):
            if frame < len(shown):
                pose = Rigid(shown.motion.quaternion[frame], shown.motion.translation[frame])
                picture = renderer.render(shown.vertices(frame), view, pose)
            writer.write(picture)
            if on_frame is not None:
                on_frame(frame, picture)
    return len(times)
