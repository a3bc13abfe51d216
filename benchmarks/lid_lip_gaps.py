"""Do lids and lips meet without passing through each other, on many heads?

Heads are drawn from the built-in identities and driven by FAPs alone. What is measured knows
nothing of the drive: which skin is upper and which lower lid, and where the lips' rings run, is
told by `datasets_synthetic`, which moves its actors by other means.

- lids, in columns across the opening: the lowest place of the upper lid's skin above the highest of
  the lower lid's, each seen from the front without the other (below 0: how far they pass each
  other); and how much of the eyeball shows;
- lips, at 39 stations across the mouth: the height of the opening seen from the front, less what is
  open at rest; and by how much deeper the lips lie in each other than at rest.

Run: ``python benchmarks/lid_lip_gaps.py [--heads 20]``
"""

from __future__ import annotations

import argparse
import os
import platform
import time

import numpy as np
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.mpeg4 import fap_by_name
from facewright.datasets_synthetic.lid_motion import lid_layout
from facewright.datasets_synthetic.lip_motion import LipMotion
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.heads.raycast import RayScene
from facewright.retarget.drive import HeadDrive

Floats = NDArray[np.float64]

SEED = 100
LIMIT_MM = 0.2
_STEP_MM = 0.03
_COLUMN_MM = 0.4
_FRONT_MM = 300.0
_AHEAD = np.array([0.0, 0.0, -1.0])


def blinks(head: Head) -> dict[str, dict[str, float]]:
    """Full blinks, FAPs in mm of this head: by the upper lids, by both, and by far too much."""
    full = head.fapu.irisd

    def both(top: float, bottom: float) -> dict[str, float]:
        lids = {"close_t_l_eyelid": top, "close_t_r_eyelid": top}
        return lids | {"close_b_l_eyelid": bottom, "close_b_r_eyelid": bottom}

    return {
        "blink, upper lids": both(full, 0.0),
        "blink, both lids": both(0.8 * full, 0.3 * full),
        "blink, 160 %": both(1.6 * full, 0.0),
    }


def bilabials() -> dict[str, dict[str, float]]:
    """/m/ by FAP 1, in a smiling face, with a low jaw, and pressed by far too much."""
    spoken = {"viseme.select1": 1.0, "viseme.blend": 63.0}
    smile = {"expression.select1": 1.0, "expression.intensity1": 63.0}
    both_lips = {n: 0.0 for n in ("lower_t_midlip", "raise_b_midlip", "lower_t_lip_lm")}
    pressed = {"lower_t_midlip": 3.0, "lower_t_lip_lm": 3.0}
    pressed |= {"raise_b_midlip": 3.0, "raise_b_lip_lm": 3.0}
    return {
        "/m/": spoken,
        "/m/ in a smile": spoken | smile,
        "/m/, jaw 5 mm down": both_lips | {"open_jaw": 5.0, "raise_b_lip_lm": 0.0},
        "/m/, 3 mm pressed": pressed,
    }


def clip_of(head: Head, amounts: dict[str, float]) -> Clip:
    """One frame of FAPs in mm; fields of FAPs 1 and 2 as they are."""
    names = fap_by_name()
    values = [v / head.fapu.unit(names[n]) if n in names else v for n, v in amounts.items()]
    return Clip(np.zeros(1), tuple(amounts), np.array([values]))


def lid_gaps(head: Head, v: Floats, side: str) -> tuple[Floats, float]:
    """Signed gaps in columns (n,) mm; and the visible area of the eyeball, mm²."""
    layout, eye = lid_layout(side), head.eyes[side]
    sign = np.zeros(len(v))
    sign[layout.rows] = layout.sign
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    upper = skin[(sign[skin] > 0).any(axis=1) & (sign[skin] >= 0).all(axis=1)]
    lower = skin[(sign[skin] < 0).any(axis=1) & (sign[skin] <= 0).all(axis=1)]
    xs = np.arange(-0.95, 0.96, _COLUMN_MM / eye.radius) * eye.radius + eye.centre[0]
    ys = np.arange(-0.8, 0.6, _STEP_MM / eye.radius) * eye.radius + eye.centre[1]
    was_open = _shows(head, head.mesh.vertices, skin, side, xs, ys).sum(axis=1) * _STEP_MM
    xs = xs[was_open > 1.0]
    ball = head.mesh.triangles[head.mesh.groups[f"eye_{side}"]]
    edges = []
    for triangles, lowest in ((upper, True), (lower, False)):
        seen = _depths(v, triangles, xs, ys) < _depths(v, ball, xs, ys)
        row = np.where(
            seen.any(axis=1),
            np.argmax(seen, axis=1) if lowest else seen.shape[1] - 1 - seen[:, ::-1].argmax(axis=1),
            0,
        )
        edges.append(ys[row])
    area = _shows(head, v, skin, side, xs, ys).sum() * _STEP_MM * _COLUMN_MM
    return edges[0] - edges[1], float(area)


def _shows(
    head: Head, v: Floats, skin: NDArray[np.int32], side: str, xs: Floats, ys: Floats
) -> NDArray[np.bool_]:
    ball = head.mesh.triangles[head.mesh.groups[f"eye_{side}"]]
    return np.asarray(_depths(v, ball, xs, ys) < _depths(v, skin, xs, ys))


def _depths(v: Floats, triangles: NDArray[np.int32], xs: Floats, ys: Floats) -> Floats:
    x, y = np.meshgrid(xs, ys, indexing="ij")
    start = np.stack([x.ravel(), y.ravel(), np.full(x.size, _FRONT_MM)], axis=1)
    t, *_ = RayScene(v, triangles).cast(start, np.tile(_AHEAD, (x.size, 1)))
    return np.asarray(t.reshape(x.shape), dtype=np.float64)


def measure(seed: int) -> dict[str, tuple[float, float, float]]:
    """For each gesture: largest gap and largest crossing, mm; visible eye, mm² (NaN for lips)."""
    head = make_head(random_identity(np.random.default_rng(seed), f"seed {seed}"))
    drive = HeadDrive(head)
    found = {}
    for name, amounts in blinks(head).items():
        v = drive.animate(clip_of(head, amounts)).vertices(0)
        sides = [lid_gaps(head, v, side) for side in ("left", "right")]
        gaps = np.concatenate([g for g, _ in sides])
        crossing = max(float(-gaps.min()), 0.0)
        found[name] = (float(gaps.max()), crossing, sum(a for _, a in sides))
    lips = LipMotion(head)
    opening0, room0 = (h[1:-1] for h in lips.heights(np.array(head.mesh.vertices)))
    for name, amounts in bilabials().items():
        v = drive.animate(clip_of(head, amounts)).vertices(0)
        opening, room = (h[1:-1] for h in lips.heights(v))
        gap = float((opening - np.maximum(opening0, 0.0)).max())
        crossing = float((np.minimum(room0, 0.0) - room).max())
        found[name] = (max(gap, 0.0), max(crossing, 0.0), np.nan)
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--heads", type=int, default=20)
    n = parser.parse_args().heads
    print(
        f"{platform.machine()}, {os.cpu_count()} cores; Python {platform.python_version()}, ",
        end="",
    )
    print(f"NumPy {np.__version__}; {n} heads, seeds from {SEED}")
    start = time.perf_counter()
    rows = [measure(SEED + i) for i in range(n)]
    print(f"{(time.perf_counter() - start) / n:.1f} s a head\n")
    print(
        "| gesture | gap mm: median | worst | crossing mm: median | worst | eye shows mm² | "
        "heads within 0.2 mm |"
    )
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name in rows[0]:
        gap, crossing, eye = np.array([r[name] for r in rows]).T
        within = int(((gap <= LIMIT_MM) & (crossing <= LIMIT_MM)).sum())
        shows = "" if np.isnan(eye).all() else f"{eye.max():.2f}"
        print(
            f"| {name} | {np.median(gap):.2f} | {gap.max():.2f} | {np.median(crossing):.2f} | "
            f"{crossing.max():.2f} | {shows} | {within} of {n} |"
        )


if __name__ == "__main__":
    main()
