"""The `facewright` command: what there is, and nothing else.

A command is a function in a module of its own, named after it, whose imports at the top are light:
what is slow to import is imported inside the function, so that ``facewright --help`` is instant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated

import typer

from .. import __version__
from .animate import animate
from .calibrate_board import board as calibrate_board
from .calibrate_rig import rig as calibrate_rig
from .calibrate_tsai import tsai as calibrate_tsai
from .demo import demo
from .doctor import doctor
from .errors import DebugOption, guarded
from .faps import faps
from .head import head as prepare_head
from .info import info
from .retarget import retarget
from .synth_board import board
from .synth_head import head
from .synth_photos import photos
from .synth_scan import scan
from .synth_take import take
from .synth_voice import voice
from .track import track
from .view import view

#: Every command in the order of the help text; "group name" makes a group of commands.
COMMANDS: dict[str, Callable[..., None]] = {
    "demo": demo,
    "info": info,
    "doctor": doctor,
    "synth take": take,
    "synth head": head,
    "synth board": board,
    "synth photos": photos,
    "synth scan": scan,
    "synth voice": voice,
    "calibrate tsai": calibrate_tsai,
    "calibrate board": calibrate_board,
    "calibrate rig": calibrate_rig,
    "track": track,
    "faps": faps,
    "animate": animate,
    "head": prepare_head,
    "retarget": retarget,
    "view": view,
}

#: What each group is about.
GROUPS: dict[str, str] = {
    "calibrate": "Cameras from known points and boards, and how sure they are, in mm.",
    "synth": "Make people and captures whose truth is known exactly.",
}


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"facewright {__version__}")
        raise typer.Exit


def _about(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
    debug: DebugOption = False,
) -> None:
    """Turn a captured performance into an animated head."""


def build_app(commands: Mapping[str, Callable[..., None]]) -> typer.Typer:
    """The command line of some commands, each with its error lines and `--debug`."""
    settings = {"help_option_names": ["-h", "--help"]}
    root = typer.Typer(
        name="facewright",
        callback=_about,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,  # a traceback is Python's own, and shows no local values
        context_settings=settings,
    )
    groups: dict[str, typer.Typer] = {}
    for name, function in commands.items():
        group, _, word = name.rpartition(" ")
        if group and group not in groups:
            groups[group] = typer.Typer(
                help=GROUPS[group], no_args_is_help=True, context_settings=settings
            )
            # a callback keeps a group of one command a group
            groups[group].callback()(lambda: None)
            root.add_typer(groups[group], name=group)
        (groups[group] if group else root).command(word)(guarded(function))
    return root


app = build_app(COMMANDS)
