"""Time stamps: what counts as uniform, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.core.time_base import checked_times, uniform_rate_hz


@pytest.mark.parametrize("rate_hz", [24.0, 25.0, 30000 / 1001, 59.94, 60.0, 240.0])
@pytest.mark.parametrize("step_s", [0.0, 1e-3, 1 / 90000])
def test_rates_survive_the_rounding_of_containers(rate_hz: float, step_s: float) -> None:
    """Matroska rounds to 1 ms, MPEG to 1/90000 s."""
    times = np.arange(600) / rate_hz
    if step_s:
        times = np.round(times / step_s) * step_s

    found = uniform_rate_hz(times)

    if step_s == 1e-3 and rate_hz > 100:  # 1 ms is a quarter of such a frame
        assert found is None
    else:
        assert found == pytest.approx(rate_hz, rel=2e-4)


@pytest.mark.parametrize("times", [[], [0.0], [0.0, 1.0, 3.0], [0.0, 0.04, 0.08, 0.16]])
def test_too_few_or_uneven_times_have_no_rate(times: list[float]) -> None:
    assert uniform_rate_hz(np.array(times)) is None


@pytest.mark.parametrize(
    "times", [[0.0, 0.0], [1.0, 0.5], [0.0, np.nan], [np.inf], [0.0, np.inf, np.inf]]
)
def test_times_that_do_not_grow_are_refused(times: list[float]) -> None:
    with pytest.raises(ValueError, match="finite and strictly increasing"):
        checked_times(times)
