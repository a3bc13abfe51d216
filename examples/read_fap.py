"""List what a .fap file gives: each FAP, its range, and what that is in millimetres or degrees.

    python examples/read_fap.py FILE.fap [--head NAME]

FAPs are in units of a face, so millimetres depend on whose: those of a built-in head here.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from facewright.core.formats.fap import read_fap
from facewright.core.mpeg4 import fap_by_name
from facewright.heads.catalogue import built_in_head


def main() -> None:
    """Read and print."""
    parser = argparse.ArgumentParser(description="List the FAPs of a file.")
    parser.add_argument("file", type=Path)
    parser.add_argument("--head", default="average")
    options = parser.parse_args()
    clip = read_fap(options.file)
    fapu = built_in_head(options.head).fapu

    print(f"{len(clip.time_s)} frames, {clip.time_s[-1]:g} s, units of head {options.head}")
    for name in clip.channels:
        values = clip[name][~np.isnan(clip[name])]
        fap = fap_by_name().get(name)  # None for the fields of FAPs 1 and 2, which have no unit
        if not len(values) or fap is None:
            continue
        low, high = (float(v) * fapu.unit(fap) for v in (values.min(), values.max()))
        unit = "mm"
        if fap.fapu == "AU":
            low, high, unit = np.rad2deg(low), np.rad2deg(high), "°"
        print(f"{fap.number:3d} {name:24}{low:8.2f} to {high:7.2f} {unit}")


if __name__ == "__main__":
    main()
