"""One self-contained HTML page: animated heads beside videos, over their sound and curves.

The page needs nothing but itself: the viewer, the models, the videos, the sound and the curves are
inside, and its content security policy forbids the browser to fetch anything.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.files import atomic_write
from ..core.formats.glb_document import GlbDocument
from ..core.formats.gltf import scene_from_glb
from ..core.time_base import uniform_rate_hz
from .drawing import Drawing
from .page_channels import REGIONS, channel_entries, shown_first
from .page_html import (
    Block,
    PageTable,
    asset,
    data_html,
    notes_html,
    packed,
    policy,
    scripts,
    tables_html,
)
from .page_sound import PEAKS_HZ, PageSound, flac_bytes, peak_bytes

__all__ = ["PageCurves", "PageModel", "PageSound", "PageTable", "PageVideo", "write_page"]

#: Browsers keep text in strings of at most half a gibibyte; base64 adds a third.
MAX_ITEM_BYTES = 300 * 1024 * 1024
_WEBM_SIGNATURE = b"\x1a\x45\xdf\xa3"


@dataclass(frozen=True, eq=False)
class PageModel:
    """A model to show.

    Attributes
    ----------
    label : str
    glb : bytes
        A .glb file.
    start_s : float
        When on the page's time line its animation begins.
    orbit : str
        Where it is looked at from: turn about the vertical, angle from it, distance; as
        model-viewer's ``camera-orbit``.
    points : mapping from a point's name to where it is on the model's surface
        Shown on demand. As model-viewer's ``data-surface``: mesh, primitive, three vertices, three
        barycentric coordinates.
    """

    label: str
    glb: bytes
    start_s: float = 0.0
    orbit: str = "0deg 86deg 112%"
    points: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PageVideo:
    """A video to show: an .mp4 or .webm file. Only the first video of a page may sound."""

    label: str
    mp4: bytes
    start_s: float = 0.0


@dataclass(frozen=True, eq=False)
class PageCurves:
    """Curves to plot. Channels of one name in several clips are plotted together, to compare."""

    label: str
    clip: Clip
    start_s: float = 0.0


def write_page(
    path: Path,
    *,
    title: str,
    models: Sequence[PageModel] = (),
    videos: Sequence[PageVideo] = (),
    curves: Clip | Sequence[PageCurves] | None = None,
    sound: PageSound | None = None,
    drawings: Sequence[Drawing] = (),
    tables: Sequence[PageTable] = (),
    notes: str = "",
) -> None:
    """Write the page, atomically. What is not given leaves no empty pane.

    Parameters
    ----------
    path : Path
    title : str
    models, videos : sequences, in the order shown
    curves : Clip, sequence of PageCurves, or None
        FAPs or any named channels; channels that are never set are left out.
    sound : PageSound or None
    drawings : sequence of Drawing
    tables : sequence of PageTable
    notes : str
        Plain text; blank lines part paragraphs.

    Raises
    ------
    InputError
        If a video is neither MP4 nor WebM, or something is too large for a browser.
    FileFormatError
        If a model is no .glb, or is compressed in a way that needs a decoder.
    OSError
        If the page cannot be written.
    """
    _check_media(models, videos)
    for table in tables:
        if any(len(row) != len(table.header) for row in table.rows):
            raise ValueError(f"rows of {table.caption} must have {len(table.header)} cells")
    listed = [PageCurves("", curves)] if isinstance(curves, Clip) else list(curves or ())
    clips, clip_blocks = _clips(listed)
    heard, sound_blocks = _sound(sound)
    plays_video = sound is None or sound.is_in_video
    config: dict[str, Any] = {
        "models": [
            {"id": f"model-{i}", "label": m.label, "start": m.start_s, "orbit": m.orbit,
             "points": list(m.points.items())}
            for i, m in enumerate(models)
        ],
        "videos": [
            {"id": f"video-{i}", "label": v.label, "start": v.start_s, "type": _video_type(v),
             "hasSound": i == 0 and plays_video and _has_sound(v)}
            for i, v in enumerate(videos)
        ],
        "sound": heard,
        "rate": None if listed else _frame_rate(models, videos),
        "clips": clips,
        "shown": _shown(clips),
        "regions": REGIONS,
    }  # fmt: skip
    blocks = [packed(f"model-{i}", m.glb) for i, m in enumerate(models)]
    blocks += [Block(f"video-{i}", v.mp4) for i, v in enumerate(videos)]
    blocks += clip_blocks + sound_blocks
    for block in blocks:
        _check_size(block)
    _write(path, title, config, blocks, drawings, tables, notes)


def _write(
    path: Path,
    title: str,
    config: dict[str, Any],
    blocks: Sequence[Block],
    drawings: Sequence[Drawing],
    tables: Sequence[PageTable],
    notes: str,
) -> None:
    modules = scripts(has_models=bool(config["models"]))
    parts: dict[str, Callable[[], Iterator[str]]] = {
        "title": lambda: iter([escape(title)]),
        "policy": lambda: iter([escape(policy(modules))]),
        "style": lambda: iter([asset("page.css")]),
        "drawings": lambda: (f'<div class="sheet">{d.svg()}</div>\n' for d in drawings),
        "tables": lambda: iter([tables_html(tables)]),
        "notes": lambda: iter([notes_html(notes)]),
        "data": lambda: data_html(config, blocks),
        "scripts": lambda: (f'<script type="module">{text}</script>\n' for text in modules),
    }
    with atomic_write(path) as stream:
        # split on the template's own marks, so that nothing put in is searched for marks again
        for i, piece in enumerate(re.split(r"\{\{(\w+)\}\}", asset("page.html"))):
            stream.writelines([piece] if i % 2 == 0 else parts[piece]())


def _clips(curves: Sequence[PageCurves]) -> tuple[list[dict[str, Any]], list[Block]]:
    """What the page is told of each clip, and the blocks of their times and values."""
    told, blocks = [], []
    for i, given in enumerate(curves):
        clip = _set_channels(given.clip)
        by_channel = np.ascontiguousarray(clip.values.T, dtype="<f4")
        told.append(
            {
                "id": f"curves-{i}",
                "label": given.label,
                "start": given.start_s,
                "channels": channel_entries(clip),
            }
        )
        blocks.append(packed(f"curves-{i}-times", clip.time_s.astype("<f8").tobytes()))
        blocks.append(packed(f"curves-{i}-values", by_channel.tobytes()))
    return told, blocks


def _shown(clips: Sequence[dict[str, Any]]) -> list[str]:
    """Names of the channels plotted when the page opens."""
    by_name: dict[str, dict[str, Any]] = {}
    for clip in clips:
        for entry in clip["channels"]:
            by_name.setdefault(entry["name"], entry)
    entries = list(by_name.values())
    return [entries[i]["name"] for i in shown_first(entries)]


def _sound(sound: PageSound | None) -> tuple[dict[str, Any] | None, list[Block]]:
    """What the page is told of its sound, and the blocks of the sound and its picture."""
    if sound is None:
        return None, []
    told = {
        "label": sound.label,
        "start": sound.start_s,
        "duration": sound.audio.duration_s,
        "peaksRate": PEAKS_HZ,
        "isInVideo": sound.is_in_video,
        "type": "audio/flac",
    }
    blocks = [packed("sound-peaks", peak_bytes(sound.audio))]
    if not sound.is_in_video:
        blocks.append(Block("sound", flac_bytes(sound.audio)))
    return told, blocks


# what goes in


def _check_media(models: Sequence[PageModel], videos: Sequence[PageVideo]) -> None:
    for model in models:
        GlbDocument(f"model {model.label}", model.glb)
    for video in videos:
        if video.mp4[4:8] != b"ftyp" and not video.mp4.startswith(_WEBM_SIGNATURE):
            raise InputError(f"video {video.label} is neither MP4 nor WebM: convert it first")


def _check_size(block: Block) -> None:
    if len(block.data) > MAX_ITEM_BYTES:
        raise InputError(
            f"{block.name} of the page takes {len(block.data) / 2**20:.0f} MiB, browsers bear "
            f"{MAX_ITEM_BYTES // 2**20}: make it shorter or smaller"
        )


def _video_type(video: PageVideo) -> str:
    return "video/webm" if video.mp4.startswith(_WEBM_SIGNATURE) else "video/mp4"


def _has_sound(video: PageVideo) -> bool:
    import av

    try:
        with av.open(io.BytesIO(video.mp4)) as container:
            return bool(container.streams.audio)
    except av.FFmpegError:
        return False  # what cannot be read is told of by `_frame_rate`, or by the browser


def _frame_rate(models: Sequence[PageModel], videos: Sequence[PageVideo]) -> float | None:
    """Frames per second of the first video, else of the first animated model; None: unknown."""
    import av

    for video in videos:
        try:
            with av.open(io.BytesIO(video.mp4)) as container:
                rate = container.streams.video[0].average_rate if container.streams.video else None
        except av.FFmpegError as error:
            raise InputError(f"video {video.label} cannot be read: {error}") from error
        if rate:
            return float(rate)
    for model in models:
        times = scene_from_glb(model.glb, f"model {model.label}").time_s
        rate_hz = uniform_rate_hz(times)
        if rate_hz is not None:
            return rate_hz
    return None


def _set_channels(clip: Clip) -> Clip:
    """The clip without the channels that are never set."""
    columns = np.flatnonzero(~np.isnan(clip.values).all(axis=0))
    return Clip(clip.time_s, tuple(clip.channels[c] for c in columns), clip.values[:, columns])
