"""The page's pieces of HTML: scripts, the policy that admits them, data blocks, tables, notes."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

_BLOCK = 3 * 1024 * 1024  # bytes turned into base64 at a time; a multiple of 3
_SCRIPTS = (
    "page_media.js",
    "page_stage.js",
    "page_clock.js",
    "page_curves.js",
    "page_plot.js",
    "page_pointer.js",
    "page_picker.js",
    "page_transport.js",
    "page.js",
)
#: Good enough for floats; more effort gains a hundredth.
_GZIP_LEVEL = 6


@dataclass(frozen=True)
class PageTable:
    """A table under the curves; columns whose cells are all numbers stand to the right."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Block:
    """Data inside the page: an id, what is stored, and whether that is packed by gzip."""

    name: str
    data: bytes
    is_packed: bool = False


def packed(name: str, data: bytes) -> Block:
    """A block of data that is packed; the same data gives the same bytes."""
    return Block(name, gzip.compress(data, _GZIP_LEVEL, mtime=0), is_packed=True)


def asset(name: str) -> str:
    """A text file of the page's own."""
    text = files(__package__).joinpath("data", name).read_text(encoding="utf-8")
    return text.replace("\r\n", "\n")  # as the browser reads it, and as the policy's hash needs it


def scripts(*, has_models: bool) -> list[str]:
    """The page's modules. Each is inline: a file:// page may not fetch modules."""
    texts = ["\n".join(asset(name) for name in _SCRIPTS)]
    if has_models:
        texts.insert(0, asset("model-viewer.min.js"))
    return [inline(text) for text in texts]


def inline(script: str) -> str:
    """A script that the HTML parser reads to its end and no debugger seeks a source map for."""
    script = re.sub(r"\n//# sourceMappingURL=.*", "", script)
    return re.sub(r"<(?=/script|script|!--)", r"\\x3c", script, flags=re.IGNORECASE)


def policy(modules: Sequence[str]) -> str:
    """The content security policy: these very scripts, and nothing from anywhere else."""
    hashes = [
        "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"
        for text in modules
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


def data_html(config: dict[str, Any], blocks: Sequence[Block]) -> Iterator[str]:
    """Blocks of data; scripts by name, but of types that no browser runs."""
    yield f'<script type="application/json" id="config">{_json(config)}</script>\n'
    for block in blocks:
        mark = ' data-packed="gzip"' if block.is_packed else ""
        yield f'<script type="text/plain" id="{block.name}"{mark}>'
        for start in range(0, len(block.data), _BLOCK):
            yield base64.b64encode(block.data[start : start + _BLOCK]).decode("ascii")
        yield "</script>\n"


def _json(value: Any) -> str:
    """JSON that cannot end the script it stands in."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def tables_html(tables: Sequence[PageTable]) -> str:
    """A section of tables; nothing where there are none."""
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


def notes_html(notes: str) -> str:
    """A section of paragraphs, parted by blank lines; nothing where there are none."""
    paragraphs = [p.strip() for p in re.split(r"\n\s*\n", notes) if p.strip()]
    if not paragraphs:
        return ""
    text = "\n".join(f"<p>{escape(p)}</p>" for p in paragraphs)
    return f'<section class="notes" aria-label="Notes">\n{text}\n</section>'
