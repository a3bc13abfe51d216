"""Phones in time."""

from __future__ import annotations

import pytest

from facewright.core.phones import ARPABET, PhoneTrack


def test_phones_follow_one_another() -> None:
    track = PhoneTrack(("SIL", "M", "AA"), [0.0, 0.1, 0.2], [0.1, 0.2, 0.5])  # type: ignore[arg-type]

    assert len(track) == 3
    assert not track.start_s.flags.writeable
    assert len(ARPABET) == len(set(ARPABET)) == 39


@pytest.mark.parametrize(
    ("phones", "start", "end", "said"),
    [
        (("QQ",), [0.0], [1.0], "unknown phones: QQ"),
        (("AA", "M"), [0.0, 0.4], [0.5, 0.9], "overlap"),
        (("AA",), [0.5], [0.5], "ascending"),
        (("AA",), [0.0], [float("nan")], "finite"),
        (("AA", "M"), [0.0], [0.5], "start_s"),
    ],
)
def test_what_is_no_track_is_refused(
    phones: tuple[str, ...], start: list[float], end: list[float], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        PhoneTrack(phones, start, end)  # type: ignore[arg-type]
