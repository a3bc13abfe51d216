"""Do random adults have the proportions that have been measured of people?

Draws 200 adults, half of each sex, measures every distance that has a published mean and standard
deviation, and prints for each the share within two standard deviations of the published mean
(95 % of a normal population), the difference of the means in published standard deviations, and
the ratio of the spreads. Run: ``python benchmarks/anthropometry.py``
"""

from __future__ import annotations

import platform
import time

import numpy as np
from numpy.typing import NDArray

from facewright.heads.identity import make_head, random_identity
from facewright.heads.measurements import SEXES, measure, measurement_table, published_norm

N_OF_EACH_SEX = 100
SEED = 20_000
ADULT_YEARS = 30.0  # the norms of adults do not change with age


def measured_adults(sex: str) -> tuple[dict[str, NDArray[np.float64]], float]:
    """All measurements, (N,) mm each, of random adults, and the seconds that one takes."""
    rows = []
    start = time.perf_counter()
    for i in range(N_OF_EACH_SEX):
        person = random_identity(np.random.default_rng(SEED + i), female=sex == "female")
        rows.append(measure(make_head(person).mesh))
    seconds = (time.perf_counter() - start) / N_OF_EACH_SEX
    return {name: np.array([r[name] for r in rows]) for name in rows[0]}, seconds


def main() -> None:
    print(f"machine: {platform.machine()}, Python {platform.python_version()}")
    print(f"{N_OF_EACH_SEX} adults of each sex, 23 to 67 years, seeds from {SEED}\n")
    columns = "mean mm | SD mm | within ±2 SD | Δ mean / SD | SD ratio"
    print(f"| distance | sex | published mean ± SD | {columns} | source |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | --- |")
    found = {sex: measured_adults(sex) for sex in SEXES}
    shares = []
    for name in measurement_table():
        for sex in SEXES:
            norm = published_norm(name, sex, ADULT_YEARS)
            if norm is None:
                continue
            mm = found[sex][0][name]
            within = float(np.mean(np.abs(mm - norm.mean) < 2 * norm.sd))
            shares.append(within)
            mean, sd = float(mm.mean()), float(mm.std(ddof=1))
            print(
                f"| {name} | {sex} | {norm.mean:.1f} ± {norm.sd:.1f} | {mean:.1f} | {sd:.1f} "
                f"| {within:.0%} | {(mean - norm.mean) / norm.sd:+.2f} | {sd / norm.sd:.2f} "
                f"| {norm.source} |"
            )
    good = sum(share >= 0.9 for share in shares)
    print(f"\n{good} of {len(shares)} rows have at least 90 % within two standard deviations;")
    print(f"mean {np.mean(shares):.1%}, lowest {min(shares):.0%}.")
    seconds = np.mean([s for _, s in found.values()])
    print(f"{1000 * seconds:.0f} ms to draw, paint, build and measure a head.")


if __name__ == "__main__":
    main()
