"""Follow the markers of a filmed take, and turn their motion into FAPs.

    python examples/track_take.py TAKE [--out DIR]

TAKE is a folder with one video a camera, rig.json and markers.toml, as
``facewright synth take --out TAKE`` makes it. Writes markers.c3d and performance.fap into DIR
(default: TAKE) and prints what each marker's trajectory is worth.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from facewright.core.formats.c3d import write_c3d
from facewright.core.formats.fap import write_fap
from facewright.core.formats.markers_toml import read_marker_set
from facewright.core.formats.rig_json import read_rig
from facewright.tracking.gaps import fill_gaps
from facewright.tracking.labelling import label_tracks
from facewright.tracking.performance import analyse
from facewright.tracking.videos import track_videos


def main() -> None:
    """Track, label, fill, analyse, write."""
    parser = argparse.ArgumentParser(description="Track a marker take.")
    parser.add_argument("take", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    folder: Path = options.out or options.take
    rig = read_rig(options.take / "rig.json")
    marker_set = read_marker_set(options.take / "markers.toml")
    videos = [options.take / f"{name}.mp4" for name in rig]

    unlabelled = track_videos(videos, rig).trajectories
    named = label_tracks(unlabelled, marker_set, neutral_frame=0)
    tracks = fill_gaps(named.trajectories)
    performance = analyse(tracks, marker_set, neutral_frame=0)

    assert tracks.covariances is not None
    assert tracks.n_views is not None
    print(f"{'marker':16}{'cameras':>8}{'sd, mm':>8}{'moves, mm':>10}")
    for m, name in enumerate(tracks.names):
        p, sd = tracks.positions[:, m], np.sqrt(tracks.covariances[:, m].trace(axis1=1, axis2=2))
        if np.isnan(p).all():
            print(f"{name:16}{'never seen':>26}")
            continue
        views = tracks.n_views[:, m].mean()
        moves = np.linalg.norm(np.nanmax(p, axis=0) - np.nanmin(p, axis=0))
        print(f"{name:16}{views:8.1f}{np.nanmedian(sd):8.3f}{moves:10.2f}")
    print(f"{named.labelling.mean_distance_mm:.1f} mm from the average face, {performance.fapu}")
    write_c3d(folder / "markers.c3d", tracks)
    write_fap(folder / "performance.fap", performance.faps)


if __name__ == "__main__":
    main()
