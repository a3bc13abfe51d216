"""Errors that a user can mend. The command shows them as one line and exits with 1."""

from __future__ import annotations

from pathlib import Path


class FacewrightError(Exception):
    """Something in the input that the user can put right."""


class InputError(FacewrightError, ValueError):
    """The inputs, each readable by itself, do not fit together or do not suffice."""


class FileFormatError(FacewrightError, ValueError):
    """A file's contents are not what its format promises."""

    def __init__(self, path: Path | str, where: str, expected: str, found: str) -> None:
        super().__init__(path, where, expected, found)  # all in args: survives a process pool

    def __str__(self) -> str:
        path, where, expected, found = self.args
        return f"{path}, {where}: expected {expected}, found {found}"
