"""`facewright synth board`: shots of a calibration board whose truth is known exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import note, writable_folder
from .progress import Ticks

BoardOption = Annotated[
    str,
    typer.Option(
        "--board",
        metavar="BOARD",
        # a word longer than this column of an 80-character terminal would be cut
        help="chessboard:9x6:25 (columns x rows, mm), circles:7x6:20 (with :asymmetric if its "
        "rows are shifted), or charuco: columns x rows, square mm, marker mm and dictionary, "
        "parted by colons.",
    ),
]


def board(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")],
    board: BoardOption = "chessboard:9x6:25",
    cameras: Annotated[int, typer.Option(min=1, max=8, help="1: one lens; more: a rig.")] = 1,
    views: Annotated[int, typer.Option(min=1, max=5000, help="Pictures, or frames.")] = 20,
    poor: Annotated[bool, typer.Option("--poor", help="Frontal views in the middle only.")] = False,
    video: Annotated[
        bool, typer.Option("--video", help="A moving board: one video a camera.")
    ] = False,
    bow: Annotated[
        float, typer.Option(min=-20, max=20, help="How far the board's middle stands back, mm.")
    ] = 0.0,
    ideal: Annotated[
        bool, typer.Option("--ideal", help="No noise, no blur, even light, plain background.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="The same seed makes the same shots.")] = 0,
) -> None:
    """Shots of a calibration board: pictures or videos, rig.json, board.toml, truth.npz.

    BOARD is one of chessboard:COLSxROWS:MM, circles:COLSxROWS:MM[:asymmetric],
    charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY[:legacy]; for example
    charuco:8x5:30:22:DICT_5X5_100.
    """
    from ..core.boards import parse_board
    from ..datasets_synthetic.boards import IDEAL_LOOK, make_board_shots, shoot_board

    shots = make_board_shots(
        parse_board(board),
        seed,
        n_cameras=cameras,
        n_views=views,
        poor=poor,
        moving=video,
        bow_mm=(bow, bow),
        look=IDEAL_LOOK if ideal else None,
    )
    folder = writable_folder(out)
    with Ticks(cameras * views, "shooting") as tick:
        shoot_board(shots, folder, video=video, on_picture=tick)
    pictures = "cam*.mp4" if video else "cam*/view_*.png"
    note(f"wrote {folder}/ rig.json board.toml truth.npz {pictures}")
