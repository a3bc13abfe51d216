"""One self-contained HTML page: the animated head beside the video, over its curves.

The page needs nothing but itself: the viewer, the models, the videos and the curves are inside,
and its content security policy forbids the browser to fetch anything.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
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

#: Browsers keep text in strings of at most half a gibibyte; base64 adds a third.
MAX_ITEM_BYTES = 300 * 1024 * 1024
_BLOCK = 3 * 1024 * 1024  # bytes turned into base64 at a time; a multiple of 3
_WEBM_SIGNATURE = b"\x1a\x45\xdf\xa3"
_SCRIPTS = ("page_media.js", "page_plot.js", "page.js")


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
    """

    label: str
    glb: bytes
    start_s: float = 0.0
    orbit: str = "0deg 86deg 112%"


@dataclass(frozen=True, eq=False)
class PageVideo:
    """A video to show: an .mp4 or .webm file. Only the first video of a page may sound."""

    label: str
    mp4: bytes
    start_s: float = 0.0


@dataclass(frozen=True)
class PageTable:
    """A table under the curves; columns whose cells are all numbers stand to the right."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


def write_page(
    path: Path,
    *,
    title: str,
    models: Sequence[PageModel] = (),
    videos: Sequence[PageVideo] = (),
    curves: Clip | None = None,
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
    curves : Clip or None
        FAPs or any named channels; channels that are never set are left out.
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
    config: dict[str, Any] = {
        "models": [
            {"id": f"model-{i}", "label": m.label, "start": m.start_s, "orbit": m.orbit}
            for i, m in enumerate(models)
        ],
        "videos": [
            {"id": f"video-{i}", "label": v.label, "start": v.start_s, "type": _video_type(v)}
            for i, v in enumerate(videos)
        ],
        "rate": None if curves is not None else _frame_rate(models, videos),
        "curves": None,
    }
    blocks = [(f"model-{i}", m.glb) for i, m in enumerate(models)]
    blocks += [(f"video-{i}", v.mp4) for i, v in enumerate(videos)]
    if curves is not None:
        values = _set_channels(curves)
        entries = channel_entries(values)
        config["curves"] = {
            "channels": entries,
            "shown": shown_first(entries),
            "regions": REGIONS,
        }
        by_channel = np.ascontiguousarray(values.values.T, dtype="<f4")
        blocks.append(("curve-times", values.time_s.astype("<f8").tobytes()))
        blocks.append(("curve-values", by_channel.tobytes()))
    for name, data in blocks:
        _check_size(name, data)
    scripts = _scripts(has_models=bool(models))
    parts: dict[str, Callable[[], Iterator[str]]] = {
        "title": lambda: iter([escape(title)]),
        "policy": lambda: iter([escape(_policy(scripts))]),
        "style": lambda: iter([_asset("page.css")]),
        "drawings": lambda: (f'<div class="sheet">{d.svg()}</div>\n' for d in drawings),
        "tables": lambda: iter([_tables_html(tables)]),
        "notes": lambda: iter([_notes_html(notes)]),
        "data": lambda: _data_html(config, blocks),
        "scripts": lambda: (f'<script type="module">{text}</script>\n' for text in scripts),
    }
    with atomic_write(path) as stream:
        # split on the template's own marks, so that nothing put in is searched for marks again
        for i, piece in enumerate(re.split(r"\{\{(\w+)\}\}", _asset("page.html"))):
            stream.writelines([piece] if i % 2 == 0 else parts[piece]())


def _asset(name: str) -> str:
    text = files(__package__).joinpath("data", name).read_text(encoding="utf-8")
    return text.replace("\r\n", "\n")  # as the browser reads it, and as the policy's hash needs it


# what goes in


def _check_media(models: Sequence[PageModel], videos: Sequence[PageVideo]) -> None:
    for model in models:
        GlbDocument(f"model {model.label}", model.glb)
    for video in videos:
        if video.mp4[4:8] != b"ftyp" and not video.mp4.startswith(_WEBM_SIGNATURE):
            raise InputError(f"video {video.label} is neither MP4 nor WebM: convert it first")


def _check_size(name: str, data: bytes) -> None:
    if len(data) > MAX_ITEM_BYTES:
        raise InputError(
            f"{name} of the page takes {len(data) / 2**20:.0f} MiB, browsers bear "
            f"{MAX_ITEM_BYTES // 2**20}: make it shorter or smaller"
        )


def _video_type(video: PageVideo) -> str:
    return "video/webm" if video.mp4.startswith(_WEBM_SIGNATURE) else "video/mp4"


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


# what comes out


def _scripts(*, has_models: bool) -> list[str]:
    """The page's modules. Each is inline: a file:// page may not fetch modules."""
    texts = ["\n".join(_asset(name) for name in _SCRIPTS)]
    if has_models:
        texts.insert(0, _asset("model-viewer.min.js"))
    return [_inline(text) for text in texts]


def _inline(script: str) -> str:
    """A script that the HTML parser reads to its end and no debugger seeks a source map for."""
    script = re.sub(r"\n//# sourceMappingURL=.*", "", script)
    return re.sub(r"<(?=/script|script|!--)", r"\\x3c", script, flags=re.IGNORECASE)


def _policy(scripts: Sequence[str]) -> str:
    """The content security policy: these very scripts, and nothing from anywhere else."""
    hashes = [
        "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"
        for text in scripts
    ]
    rules = {
        "default-src": "'none'",
        # and WebAssembly, which the viewer compiles from its own text
        "script-src": " ".join([*hashes, "'wasm-unsafe-eval'"]),
        "style-src": "'unsafe-inline'",  # the viewer's own, and colours of curves
        "img-src": "data: blob:",
        "media-src": "blob:",
        "connect-src": "data: blob:",  # the viewer reads models and their textures from memory
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {value}" for name, value in rules.items())


def _data_html(config: dict[str, Any], blocks: Sequence[tuple[str, bytes]]) -> Iterator[str]:
    """Blocks of data; scripts by name, but of types that no browser runs."""
    yield f'<script type="application/json" id="config">{_json(config)}</script>\n'
    for name, data in blocks:
        yield f'<script type="text/plain" id="{name}">'
        for start in range(0, len(data), _BLOCK):
            yield base64.b64encode(data[start : start + _BLOCK]).decode("ascii")
        yield "</script>\n"


def _json(value: Any) -> str:
    """JSON that cannot end the script it stands in."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _tables_html(tables: Sequence[PageTable]) -> str:
    if not tables:
        return ""
    return '<section class="tables">\n' + "\n".join(_table_html(t) for t in tables) + "\n</section>"


def _table_html(table: PageTable) -> str:
    is_number = [
        bool(table.rows) and all(_is_number(row[c]) for row in table.rows)
        for c in range(len(table.header))
    ]

    def line(cells: Sequence[str], tag: str) -> str:
        scope = ' scope="col"' if tag == "th" else ""
        kinds = [' class="number"' if right else "" for right in is_number]
        return "".join(
            f"<{tag}{scope}{kind}>{escape(cell)}</{tag}>"
            for cell, kind in zip(cells, kinds, strict=True)
        )

    body = "".join(f"<tr>{line(row, 'td')}</tr>\n" for row in table.rows)
    return (
        f'<div class="card"><table><caption>{escape(table.caption)}</caption>\n'
        f"<thead><tr>{line(table.header, 'th')}</tr></thead>\n<tbody>{body}</tbody></table></div>"
    )


def _is_number(cell: str) -> bool:
    return re.fullmatch(r"\s*([-+−±]?[\d.,]+(e[-+]?\d+)?\s*%?|—|–|-|)\s*", cell, re.I) is not None


def _notes_html(notes: str) -> str:
    paragraphs = [p.strip() for p in re.split(r"\n\s*\n", notes) if p.strip()]
    if not paragraphs:
        return ""
    text = "\n".join(f"<p>{escape(p)}</p>" for p in paragraphs)
    return f'<section class="notes" aria-label="Notes">\n{text}\n</section>'
