"""From exceptions to exit codes: one line for the user, a traceback only with --debug."""

from __future__ import annotations

import functools
import inspect
import logging
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from ..core.errors import FacewrightError

BAD_INPUT = 1
INTERRUPTED = 130  # 128 + SIGINT, as shells report it

DebugOption = Annotated[bool, typer.Option("--debug", help="Show a traceback when it fails.")]


@contextmanager
def user_errors(debug: bool) -> Iterator[None]:
    """Turn what a user can mend into one line on stderr and an exit code.

    `FacewrightError`, `OSError` and a lack of memory exit with 1, Ctrl-C with 130. Anything else
    is a fault of ours and passes through, with its traceback.

    Raises
    ------
    SystemExit
        With the exit code.
    """
    try:
        yield
    except BrokenPipeError:
        raise  # the reader of our output has left (`facewright info x | head`): typer ends quietly
    except (FacewrightError, OSError, MemoryError) as error:
        show_error(error, debug)
        _drop_unwritable_results()
        raise SystemExit(BAD_INPUT) from None
    except KeyboardInterrupt as error:
        show_error(error, debug, "interrupted; nothing half-written")
        raise SystemExit(INTERRUPTED) from None


@contextmanager
def warnings_shown() -> Iterator[None]:
    """Show what our modules log as warnings, one line each on stderr, for as long as it lasts."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setLevel(logging.WARNING)
    handler.setFormatter(logging.Formatter("facewright: %(message)s"))
    logger = logging.getLogger(__name__.partition(".")[0])
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def error_line(error: BaseException) -> str:
    """What an error says, in one line: the file first where the system names one."""
    if isinstance(error, OSError) and error.strerror:
        file = error.filename2 or error.filename
        text = error.strerror if file is None else f"{_wanted_path(file)}: {error.strerror}"
    elif isinstance(error, MemoryError):
        text = f"not enough memory: {error}" if str(error) else "not enough memory"
    else:
        text = str(error) or type(error).__name__
    return " ".join(line.strip() for line in text.splitlines())


def guarded(function: Callable[..., None]) -> Callable[..., None]:
    """A command's function with `user_errors` around it and an option `--debug`.

    ``facewright --debug COMMAND`` has the same effect as ``facewright COMMAND --debug``. A function
    that has a parameter `debug` of its own is told.
    """
    # typer reads types from the signature: evaluate them here, where the function's names are known
    signature = inspect.signature(function, eval_str=True)
    is_told = "debug" in signature.parameters

    @functools.wraps(function)
    def run(ctx: typer.Context, debug: bool, **options: Any) -> None:
        debug = debug or bool(ctx.find_root().params.get("debug"))
        if is_told:
            options["debug"] = debug
        with warnings_shown(), user_errors(debug):
            function(**options)
            sys.stdout.flush()  # a full disk or a reader that has left shows here, not at the exit

    keyword = inspect.Parameter.KEYWORD_ONLY
    added = {"ctx": inspect.Parameter("ctx", keyword, annotation=typer.Context)}
    added |= {n: p.replace(kind=keyword) for n, p in signature.parameters.items()}
    added["debug"] = inspect.Parameter("debug", keyword, default=False, annotation=DebugOption)
    run.__signature__ = signature.replace(parameters=list(added.values()))  # type: ignore[attr-defined]
    run.__annotations__ = {n: p.annotation for n, p in added.items()} | {"return": None}
    return run


def show_error(error: BaseException, debug: bool, line: str | None = None) -> None:
    """One line on stderr; after the traceback if `debug`."""
    if debug:
        traceback.print_exception(error)
    # Frames that failed keep their locals alive: dropping them ends progress bars before we speak.
    traceback.clear_frames(error.__traceback__)
    print(f"facewright: {line or error_line(error)}", file=sys.stderr, flush=True)


def _drop_unwritable_results() -> None:
    """If stdout is on a full disk, give up what is left, or Python would complain at its exit."""
    try:
        sys.stdout.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _wanted_path(path: str | bytes | int) -> str:
    """The path the user asked for, where the system names our unfinished file beside it."""
    if not isinstance(path, str):
        return str(path)
    unfinished = re.fullmatch(r"\.(.+)\.\d+\.part(\.[^.]+)?", Path(path).name)
    if unfinished is None:
        return path
    return str(Path(path).with_name(unfinished[1] + (unfinished[2] or "")))
