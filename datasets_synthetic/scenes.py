"""A take's acting, scene by scene, each from neutral to neutral, drawn when it is asked for."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from ..core.audio import Audio
from ..core.clip import Clip
from ..core.head_motion import HeadMotion
from ..core.phones import PhoneTrack
from ..core.rigid import quaternion_from_rotation
from ..heads.head import Head
from .acting_speech import FIRST_SOUND_S
from .performances import Performance, random_performance, smooth_pulse
from .voices import make_voice

SCENE_S = 30.0
_CLOSING_S = 0.6  # the end of a scene that is not the last: back to neutral
_VOICE_RATE_HZ = 24_000
_SHORTEST_PHRASE_S = 1.2


@dataclass(frozen=True, eq=False)
class Scene:
    """A piece of acting, and its sound if it has one."""

    performance: Performance
    sound: Audio | None


class Scenes:
    """The scenes of a take; the last two are kept.

    Parameters
    ----------
    head : Head
    seed : int
    seconds : float
        Length of the take.
    style : str
        As `random_performance` takes it.
    talker : str or None
        Whose voice is heard: ``man``, ``woman`` or ``child``; None for a silent take.
    """

    def __init__(
        self, head: Head, seed: int, *, seconds: float, style: str, talker: str | None
    ) -> None:
        self._head, self._seed, self._seconds = head, seed, seconds
        self._style, self._talker = style, talker
        self._kept: OrderedDict[int, Scene] = OrderedDict()

    def scene(self, number: int) -> Scene:
        """A scene; times in it start at 0."""
        if number not in self._kept:
            self._kept[number] = self._draw(number)
            if len(self._kept) > 2:
                self._kept.popitem(last=False)
        return self._kept[number]

    def performance(self, number: int) -> Performance:
        """What is acted in a scene."""
        return self.scene(number).performance

    def sound(self, number: int) -> Audio | None:
        """What is heard in a scene."""
        return self.scene(number).sound

    def _draw(self, number: int) -> Scene:
        rest_s = self._seconds - number * SCENE_S
        is_last = rest_s <= SCENE_S
        # a little longer than the take: cameras that start late see the actor to the end
        seconds = max(rest_s, 0.0) + 1.0 if is_last else SCENE_S
        rng = np.random.default_rng([self._seed, 2, number])
        sound, phones = None, None
        length_s = min(seconds, SCENE_S) - _CLOSING_S - FIRST_SOUND_S
        if self._talker is not None and length_s > _SHORTEST_PHRASE_S:
            seed = int(rng.integers(2**31))
            voice = make_voice(seed, talker=self._talker, seconds=length_s, rate_hz=_VOICE_RATE_HZ)
            sound, phones = _later(voice.audio, voice.truth.phones, FIRST_SOUND_S)
        acted = random_performance(
            rng, self._head, seconds=seconds, style=self._style, phones=phones
        )
        return Scene(acted if is_last else back_to_neutral(acted, _CLOSING_S), sound)


def _later(sound: Audio, phones: PhoneTrack, delay_s: float) -> tuple[Audio, PhoneTrack]:
    """The same after a silence, of a whole number of samples."""
    n = round(delay_s * sound.rate_hz)
    shift_s = n / sound.rate_hz
    samples = np.concatenate([np.zeros(n, np.float32), sound.samples])
    moved = PhoneTrack(phones.phones, phones.start_s + shift_s, phones.end_s + shift_s)
    return Audio(samples, sound.rate_hz), moved


def back_to_neutral(performance: Performance, closing_s: float) -> Performance:
    """A performance whose last seconds lead back to the neutral face, looking along +z."""
    from scipy.spatial.transform import Rotation

    t = performance.weights.time_s
    # all is over two samples before the end, so that the next scene joins smoothly
    end_s = float(t[-1]) - 2 * float(t[1] - t[0])
    share = 1 - smooth_pulse(t, end_s - closing_s, closing_s, 1e6, 1.0)
    motion = performance.head_motion
    turns = Rotation.from_matrix(motion.rotation).as_rotvec() * share[:, None]
    return replace(
        performance,
        weights=Clip(t, performance.weights.channels, performance.weights.values * share[:, None]),
        head_motion=HeadMotion(
            t,
            quaternion_from_rotation(Rotation.from_rotvec(turns).as_matrix()),
            motion.translation * share[:, None],
        ),
    )
