"""The part of YAML that camera files are written in, and nothing more.

Read: block mappings and lists, flow lists and mappings (also over several lines), plain and quoted
scalars, comments, the first line ``%YAML:1.0`` and the tags of OpenCV's FileStorage. Refused, with
the line: anchors and aliases, block text (``|``, ``>``), tags that would make objects, several
documents, keys that come twice, deep nesting. Nothing in a file can run code or ask for more memory
than the file is long.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FileFormatError
from ..files import read_text

#: Board corners of hundreds of views fit; nobody writes a camera file larger than this.
MAX_BYTES = 16 * 1024 * 1024
_MAX_DEPTH = 32
_TAGS = frozenset(
    ("!!opencv-matrix", "!!opencv-nd-matrix", "!!map", "!!seq", "!!str", "!!int", "!!float")
)
_INTEGER = re.compile(r"[-+]?\d{1,15}")
_REAL = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")
_CONSTANTS: dict[str, Any] = {
    "": None, "~": None, "null": None, "true": True, "false": False,
    ".nan": float("nan"), ".inf": float("inf"), "+.inf": float("inf"), "-.inf": float("-inf"),
}  # fmt: skip
_QUOTED = r'"(?:[^"\\]|\\.)*"|\'(?:[^\']|\'\')*\''
_QUOTED_KEY = re.compile(rf"({_QUOTED})[ \t]*:(?=\s|$)")
#: No plain key begins with these.
_INDICATORS = frozenset("[]{}#&*!|>'\"%@`,:-?")
_FLOW_TOKEN = re.compile(rf"\s*([\[\]{{}},]|{_QUOTED}|[^\[\]{{}},\"'\s][^\[\]{{}},]*)")
_ESCAPE = re.compile(r"\\(?:x([0-9a-fA-F]{2})|u([0-9a-fA-F]{4})|(.))")
_ESCAPED = {"n": "\n", "r": "\r", "t": "\t", "0": "\0"}


@dataclass(frozen=True)
class _Line:
    """What stands on a line (and on those that continue its brackets)."""

    number: int
    indent: int
    text: str


def read_yaml(path: Path) -> Any:
    """The document of a file: dictionaries, lists, text, int, float, bool and None.

    Raises
    ------
    FileFormatError
        ``camera.yml, line 7: expected "key: value", found ...``.
    OSError
        If the file cannot be read.
    """
    text = read_text(path, MAX_BYTES).removeprefix("\ufeff")
    if "\0" in text:
        raise FileFormatError(path, "file", "YAML text", "a binary file")
    return _Parser(path, text).document()


class _Parser:
    def __init__(self, path: Path, text: str) -> None:
        self._path = path
        self._lines = self._join(text.splitlines())
        self._at = 0

    def document(self) -> Any:
        if not self._lines:
            raise FileFormatError(self._path, "file", "a YAML document", "only comments")
        found = self._block(0)
        if self._at < len(self._lines):
            line = self._lines[self._at]
            raise self._error(line, "a line that is indented like those above", line.text)
        return found

    def _error(self, line: _Line, expected: str, found: str) -> FileFormatError:
        shown = found if len(found) <= 60 else found[:57] + "..."
        return FileFormatError(self._path, f"line {line.number}", expected, shown or "nothing")

    # Lines ----------------------------------------------------------------------------------

    def _join(self, physical: list[str]) -> list[_Line]:
        """Lines without comments, blank lines and headers; brackets that stay open are joined."""
        found: list[_Line] = []
        pieces: list[str] = []
        depth = start = indent = 0
        for number, raw in enumerate(physical, 1):
            if not depth:
                if self._is_header(number, raw, not found):
                    if raw.startswith("..."):
                        self._refuse_more(number, physical[number:])
                        break
                    continue
                start, pieces, indent = number, [], len(raw) - len(raw.lstrip(" "))
            text, depth = self._uncomment(number, raw, depth)
            if text:
                pieces.append(text)
            if pieces and not depth:
                found.append(_Line(start, indent, " ".join(pieces)))
        if depth:
            line = _Line(start, indent, "")
            raise self._error(line, "a closing bracket", "the end of the file")
        return found

    def _is_header(self, number: int, raw: str, is_first: bool) -> bool:
        """Whether a line outside brackets is a directive or a document mark."""
        line = _Line(number, 0, raw)
        if raw.startswith("%"):
            if not is_first:
                raise self._error(line, "directives before all else", raw)
            return True
        if raw.startswith("---"):
            if raw[3:].strip() or not is_first:
                raise self._error(line, "one document, on lines below ---", raw)
            return True
        if raw[: len(raw) - len(raw.lstrip())].count("\t") and raw.strip():
            raise self._error(line, "indentation by spaces", "a tab")
        return raw.rstrip() == "..."

    def _refuse_more(self, number: int, rest: list[str]) -> None:
        for offset, raw in enumerate(rest, 1):
            if raw.strip() and not raw.lstrip().startswith("#"):
                raise self._error(_Line(number + offset, 0, ""), "one document", raw)

    def _uncomment(self, number: int, raw: str, depth: int) -> tuple[str, int]:
        """A line without its comment, and how many brackets are open at its end.

        Quotes and brackets count only where a value may begin: ``Bob's [old] camera`` has none.
        """
        before, quote, n = ",", "", 0
        while n < len(raw):
            c = raw[n]
            if quote:
                if c == "\\" and quote == '"':
                    n += 1
                elif c == quote:
                    quote = ""
            elif c == "#" and (n == 0 or raw[n - 1] in " \t"):
                raw = raw[:n]
                break
            elif c in "\"'" and before in ":-,[{":
                quote = c
            elif c in "[{" and (depth or before in ":-,"):
                depth += 1
            elif c in "]}" and depth:
                depth -= 1
            if not c.isspace():
                before = c
            n += 1
        if quote:
            raise self._error(_Line(number, 0, raw), "a closing quote", "the end of the line")
        if depth > _MAX_DEPTH:
            expected = f"at most {_MAX_DEPTH} brackets in each other"
            raise self._error(_Line(number, 0, raw), expected, "more")
        return raw.strip(), depth

    # Blocks ---------------------------------------------------------------------------------

    def _block(self, depth: int) -> Any:
        line = self._lines[self._at]
        if depth > _MAX_DEPTH:
            raise self._error(line, f"at most {_MAX_DEPTH} levels", "more")
        if line.text == "-" or line.text.startswith("- "):
            return self._list(line.indent, depth)
        if line.text[0] in "[{":
            self._at += 1
            return self._flow(line, line.text)
        return self._mapping(line.indent, depth)

    def _list(self, indent: int, depth: int) -> list[Any]:
        found: list[Any] = []
        while (line := self._here(indent)) is not None:
            if not (line.text == "-" or line.text.startswith("- ")):
                break
            rest = line.text[1:].lstrip()
            if rest and rest[0] not in "[{\"'" and (_split_key(rest) or rest.startswith("- ")):
                column = indent + len(line.text) - len(rest)
                self._lines[self._at] = _Line(line.number, column, rest)
                found.append(self._block(depth + 1))
            else:
                self._at += 1
                found.append(self._value(line, rest, indent, depth, may_align=False))
        return found

    def _mapping(self, indent: int, depth: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        while (line := self._here(indent)) is not None:
            pair = _split_key(line.text)
            if pair is None:
                raise self._error(line, "key: value", line.text)
            key = str(self._text(line, pair[0]))
            if key in found:
                raise self._error(line, "a key not used before", key)
            self._at += 1
            found[key] = self._value(line, pair[1], indent, depth, may_align=True)
        return found

    def _here(self, indent: int) -> _Line | None:
        """The next line if it belongs to a block of this indentation."""
        if self._at >= len(self._lines) or self._lines[self._at].indent < indent:
            return None
        line = self._lines[self._at]
        if line.indent > indent:
            raise self._error(line, f"an indentation of {indent} spaces", f"{line.indent}")
        return line

    def _value(self, line: _Line, text: str, indent: int, depth: int, *, may_align: bool) -> Any:
        """What stands behind a key or a dash: on its line, or as a block below it."""
        if text.startswith("!"):
            tag, _, text = text.partition(" ")
            text = text.strip()
            if tag not in _TAGS:
                raise self._error(line, "plain values or OpenCV's matrices", tag)
        if not text:
            below = self._lines[self._at] if self._at < len(self._lines) else None
            if below is None:
                return None
            is_list = below.text == "-" or below.text.startswith("- ")
            if below.indent > indent or (may_align and is_list and below.indent == indent):
                return self._block(depth + 1)
            return None
        if text[0] in "[{":
            return self._flow(line, text)
        if text[0] in "&*|>@`%":
            raise self._error(line, "a plain value (no anchors, aliases, block text)", text)
        return self._text(line, text)

    # Flow -----------------------------------------------------------------------------------

    def _flow(self, line: _Line, text: str) -> Any:
        tokens: list[str] = []
        at = depth = 0
        while at < len(text):
            match = _FLOW_TOKEN.match(text, at)
            if match is None:
                raise self._error(line, "a list in brackets", text[at:])
            tokens.append(match[1].rstrip())
            at = match.end()
            depth += (match[1] in "[{") - (match[1] in "]}")
            if depth > _MAX_DEPTH:
                raise self._error(line, f"at most {_MAX_DEPTH} brackets in each other", "more")
        tokens.reverse()
        found = self._flow_value(line, tokens)
        if tokens:
            raise self._error(line, "nothing behind the closing bracket", tokens[-1])
        return found

    def _flow_value(self, line: _Line, tokens: list[str]) -> Any:
        token = self._next(line, tokens)
        if token == "[":
            return self._flow_list(line, tokens)
        if token == "{":
            return self._flow_mapping(line, tokens)
        if token in "]},":
            raise self._error(line, "a value", token)
        return self._text(line, token)

    def _next(self, line: _Line, tokens: list[str]) -> str:
        if not tokens:
            raise self._error(line, "a closing bracket", "the end of the list")
        return tokens.pop()

    def _flow_list(self, line: _Line, tokens: list[str]) -> list[Any]:
        found: list[Any] = []
        while True:
            if tokens and tokens[-1] == "]":  # also behind a last comma
                tokens.pop()
                return found
            found.append(self._flow_value(line, tokens))
            end = self._next(line, tokens)
            if end == "]":
                return found
            if end != ",":
                raise self._error(line, "a comma or ]", end)

    def _flow_mapping(self, line: _Line, tokens: list[str]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        while True:
            token = self._next(line, tokens)
            if token == "}":
                return found
            if token[0] in "\"'":
                key, rest = str(self._text(line, token)), self._next(line, tokens)
                if not rest.startswith(":"):
                    raise self._error(line, "a colon", rest)
                rest = rest[1:].strip()
            else:  # OpenCV writes {a:1} without a space
                key, colon, rest = (part.strip() for part in token.partition(":"))
                if not colon or not key:
                    raise self._error(line, "key: value", token)
            if key in found:
                raise self._error(line, "a key not used before", key)
            is_bare = not rest and tokens and tokens[-1] not in ",}"
            found[key] = self._flow_value(line, tokens) if is_bare else self._text(line, rest)
            end = self._next(line, tokens)
            if end == "}":
                return found
            if end != ",":
                raise self._error(line, "a comma or }", end)

    # Scalars --------------------------------------------------------------------------------

    def _text(self, line: _Line, text: str) -> Any:
        """The value of a scalar."""
        if text[:1] in ('"', "'"):
            if re.fullmatch(_QUOTED, text) is None:
                raise self._error(line, "nothing behind the closing quote", text)
            if text[0] == "'":
                return text[1:-1].replace("''", "'")
            return _ESCAPE.sub(_unescape, text[1:-1])
        if _INTEGER.fullmatch(text):
            return int(text)
        if _REAL.fullmatch(text):
            return float(text)
        lower = text.lower()
        return _CONSTANTS.get(lower, text)


def _split_key(text: str) -> tuple[str, str] | None:
    """Key and value of ``key: value``; None where it is none."""
    if text[0] in "\"'":
        match = _QUOTED_KEY.match(text)
        return (match[1], text[match.end() :].strip()) if match else None
    key, colon, value = text.partition(":")
    if not colon or (value and value[0] not in " \t") or text[0] in _INDICATORS:
        return None
    return key.rstrip(), value.strip()


def _unescape(match: re.Match[str]) -> str:
    code = match[1] or match[2]
    return chr(int(code, 16)) if code else _ESCAPED.get(match[3], match[3])
