"""How far a command is: a bar on a terminal, plain lines otherwise; always on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")

_REFRESH_S = 0.1
_LINE_EVERY_S = 10.0


def progress(iterable: Iterable[T], total: int | None, label: str) -> Iterator[T]:
    """Pass the items of `iterable` through and show how many there were.

    Parameters
    ----------
    iterable : iterable
    total : int or None
        How many items are expected; None where that is unknown.
    label : str
        What is being done: ``"tracking"``.
    """
    if sys.stderr.isatty():
        return _bar(iterable, total, label)
    return _lines(iterable, total, label)


class Ticks:
    """Turns a solver's `on_frame` calls into the steps of a progress display.

    Use it in a ``with`` block around the work.
    """

    def __init__(self, total: int | None, label: str) -> None:
        self._done = False
        self._bar = progress(iter(self._until_done, True), total, label)

    def _until_done(self) -> bool:
        return self._done

    def __call__(self, *_: object) -> None:
        next(self._bar, None)

    def __enter__(self) -> Ticks:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._done = True
        if kind is None:
            next(self._bar, None)  # says that it is finished
        close = getattr(self._bar, "close", None)
        if close is not None:
            close()


def _bar(iterable: Iterable[T], total: int | None, label: str) -> Iterator[T]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    # refreshed from the loop: no thread that draws while someone else writes to the terminal
    bar = Progress(*columns, console=Console(stderr=True), auto_refresh=False)
    with bar:
        task = bar.add_task(label, total=total)
        drawn_s = 0.0
        done = 0
        for done, item in enumerate(iterable, start=1):
            yield item
            if time.monotonic() - drawn_s > _REFRESH_S:
                bar.update(task, completed=done, refresh=True)
                drawn_s = time.monotonic()
        bar.update(task, completed=done, total=done, refresh=True)


def _lines(iterable: Iterable[T], total: int | None, label: str) -> Iterator[T]:
    start_s = said_s = time.monotonic()
    of_total = "" if total is None else f" of {total}"
    done = 0
    for done, item in enumerate(iterable, start=1):
        yield item
        if time.monotonic() - said_s > _LINE_EVERY_S:
            said_s = time.monotonic()
            print(f"{label}: {done}{of_total}", file=sys.stderr, flush=True)
    took_s = time.monotonic() - start_s
    print(f"{label}: {done} done in {took_s:.1f} s", file=sys.stderr, flush=True)
