"""`facewright demo`: the whole path over a capture whose truth is known exactly."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import HeadOption, JsonOption, note, writable_folder
from .synth_take import SecondsOption, SeedOption, run_take
from .tables import print_table, write_json

if TYPE_CHECKING:
    from ..datasets_synthetic.film import FilmedTake
    from .evaluation import Stage

MAX_MBIT_PER_S = 2.0
MIN_TRACKING_RATE = 120.0


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")] = Path(
        "demo"
    ),
    seconds: SecondsOption = 4.0,
    seed: SeedOption = 0,
    head: HeadOption = "ruth",
    json_file: JsonOption = None,
) -> None:
    """Film a synthetic actor, track, animate another head; say how far each stage was off.

    Writes rig.json, markers.toml, truth.npz, cam*.mp4, markers.c3d, performance.fap, head.glb,
    preview.mp4 and report.html. Needs no input.
    """
    from ..core.formats.markers_toml import read_marker_set
    from ..core.formats.rig_json import read_rig
    from ..datasets_synthetic.take_settings import TakeSettings
    from ..heads.catalogue import built_in_identity
    from ..tracking.long_takes import LongSettings
    from .animate import run_animate
    from .evaluation import evaluate, load_truth

    built_in_identity(head)
    folder = writable_folder(out)
    start = time.perf_counter()
    take = run_take(folder, TakeSettings(seconds=seconds), seed)
    filming_s = time.perf_counter() - start
    marker_file = take.marker_set
    assert marker_file is not None
    result = run_animate(
        take.videos, read_rig(take.rig), read_marker_set(marker_file), folder, LongSettings(),
        head=head,
    )  # fmt: skip
    assert result.track.trajectories is not None
    truth = load_truth(take.truth)
    stages = _filming(take, len(truth["time_s"]), filming_s)
    stages += evaluate(take.videos, truth, result.track.trajectories, result.performance)
    rate = float(result.facts["camera_frames_per_second"])
    stages += _speeds(rate, result.facts)
    rows = [(s.stage, s.quantity, s.unit, s.value, _limit(s), _verdict(s)) for s in stages]
    print_table(("stage", "measured", "unit", "value", "limit", ""), rows)
    note(f"all in {time.perf_counter() - start:.0f} s; open {folder / 'report.html'}")
    if json_file is not None:
        write_json(
            json_file,
            {"stages": [s.as_dict() for s in stages], "camera_frames_per_second": rate},
        )


def _limit(stage: Stage) -> str:
    if stage.limit is None:
        return ""
    return f"{'≥' if stage.at_least else '≤'} {stage.limit:g}"


def _verdict(stage: Stage) -> str:
    if stage.limit is None:
        return ""
    return "ok" if stage.passed else "MISSED"


def _filming(take: FilmedTake, n_frames: int, seconds: float) -> list[Stage]:
    from ..core.video import probe_video
    from .evaluation import Stage

    mbit = max(path.stat().st_size * 8e-6 / probe_video(path).duration_s for path in take.videos)
    rate = n_frames * len(take.videos) / seconds
    return [
        Stage("filming", "camera frames per second", "1/s", rate),
        Stage("filming", "largest video", "Mbit/s", mbit, MAX_MBIT_PER_S),
    ]


def _speeds(tracking_rate: float, facts: dict[str, float]) -> list[Stage]:
    from .evaluation import Stage

    rate, least = tracking_rate, MIN_TRACKING_RATE
    preview = facts["preview_frames_per_second"]
    return [
        Stage("tracking", "camera frames per second", "1/s", rate, least, at_least=True),
        Stage("preview", "pictures per second", "1/s", preview),
    ]
