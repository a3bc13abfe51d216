"""What `facewright view` shows of each file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError
from .page import PageCurves, PageModel, PageSound, PageVideo
from .retarget import read_clip

if TYPE_CHECKING:
    from ..core.clip import Clip
    from ..core.markers import MarkerSet
    from ..core.trajectories import Trajectories
    from ..heads.head import Head
    from ..retarget.animation import HeadAnimation

VIDEOS = (".mp4", ".m4v", ".webm", ".mov")
SOUNDS = (".wav", ".flac", ".ogg", ".mp3", ".m4a", ".aif", ".aiff", ".opus")
CLIPS = (".fap", ".npz", ".csv")
_SHOWN = "a page shows .glb, .fap, .npz, ARKit .csv, .c3d, videos (.mp4, .webm) and a sound (.wav)"
_COMPARED = (
    "what can be compared side by side are clips (.fap, .npz, ARKit .csv), animated heads (.glb), "
    "markers (.c3d) and videos"
)
#: More heads than this are too small to compare, and slow to draw.
MAX_HEADS = 4
DEFAULT_HEAD = "ruth"
#: How a kind of file that a page does not show comes onto one.
_ADVICE = {
    **dict.fromkeys(
        (".usd", ".usda", ".usdc", ".usdz"),
        "a page cannot show USD: write the same as .glb (facewright retarget CLIP --out x.glb) "
        "and show that",
    ),
    **dict.fromkeys(
        (".obj", ".ply", ".vrm"),
        "this is a head at rest: give it by --head, with a clip that moves it",
    ),
    ".bvh": "a page cannot show BVH: show the clip that it was made of",
}


@dataclass
class Shown:
    """What a page shows, file by file.

    Attributes
    ----------
    models, videos : list
    clips : list of PageCurves
    sound : PageSound or None
    """

    models: list[PageModel] = field(default_factory=list)
    videos: list[PageVideo] = field(default_factory=list)
    clips: list[PageCurves] = field(default_factory=list)
    sound: PageSound | None = None

    def add(self, path: Path) -> None:
        """Add a file.

        Raises
        ------
        FileFormatError
            If it is damaged.
        InputError
            If it is of a kind that no page shows, or cannot be shown beside what there is.
        OSError
            If it cannot be read.
        """
        suffix = path.suffix.lower()
        kind = next((how for suffixes, how in _HOW.items() if suffix in suffixes), None)
        if kind is None:
            raise InputError(f"{path}: {_ADVICE.get(suffix, _SHOWN)}")
        kind(self, path)

    def add_heads(self, names: Sequence[str] | None) -> None:
        """Put the clips on heads: where heads are named, or no model is given that shows them.

        Clips and heads go together one by one; a single clip goes on all heads, a single head
        shows all clips.

        Raises
        ------
        FileFormatError, InputError, OSError
            If a head cannot be had, or a clip does not move it.
        """
        if not self.clips:
            if names:
                raise InputError(
                    f"--head {names[0]} needs a clip that moves it: .fap, .npz or ARKit .csv"
                )
            return
        if not names and self.models:
            return
        pairs = _pairs(self.clips, list(names or (DEFAULT_HEAD,)))
        if len(self.models) + len(pairs) > MAX_HEADS:
            raise InputError(
                f"{len(self.models) + len(pairs)} heads are too many: a page shows {MAX_HEADS}"
            )
        from .heads import find_head

        heads = {name: find_head(name) for _, name in pairs}
        for curves, name in pairs:
            head = heads[name]
            label = head.name if len(pairs) == 1 else f"{head.name}: {curves.label}"
            self.models.append(head_model(label, head, animated(head, curves.clip)))

    # each kind of file

    def _glb(self, path: Path) -> None:
        from ..core.formats.gltf import scene_from_glb
        from .page_points import feature_point_places, head_of
        from .page_size import rounded_glb

        if len(self.models) >= MAX_HEADS:
            raise InputError(f"{path}: a page shows at most {MAX_HEADS} heads")
        glb = path.read_bytes()
        scene_from_glb(glb, str(path))
        head = _built_in(head_of(glb))
        points: Mapping[str, str] = {} if head is None else feature_point_places(glb, head)
        self.models.append(PageModel(path.stem, rounded_glb(glb), points=points))

    def _video(self, path: Path) -> None:
        data = path.read_bytes()
        self.videos.append(PageVideo(path.stem, data))
        if len(self.videos) == 1 and self.sound is None and _has_sound(path):
            from ..core.audio import read_audio

            self.sound = PageSound(path.name, read_audio(path), is_in_video=True)

    def _sound(self, path: Path) -> None:
        from ..core.audio import read_audio

        if self.sound is not None and not self.sound.is_in_video:
            raise InputError(
                f"{path}: a page plays one sound, and has {self.sound.label}; {_COMPARED}"
            )
        self.sound = PageSound(path.name, read_audio(path))

    def _clip(self, path: Path) -> None:
        if len(self.clips) >= MAX_HEADS:
            raise InputError(f"{path}: a page compares at most {MAX_HEADS} clips")
        self.clips.append(PageCurves(path.name, read_clip(path)))

    def _markers(self, path: Path) -> None:
        from ..core.formats.c3d import read_c3d
        from ..core.formats.gltf import glb_bytes
        from .marker_scene import marker_scene
        from .page_points import ball_places

        tracks = read_c3d(path)
        if not tracks.names or not len(tracks.time_s):
            raise InputError(f"{path}: there are no markers in it to show")
        glb = glb_bytes(marker_scene(tracks, _marker_set_of(tracks)))
        self.models.append(PageModel(path.stem, glb, points=ball_places(glb, tracks.names)))


_HOW: dict[tuple[str, ...], Callable[[Shown, Path], None]] = {
    (".glb",): Shown._glb,
    VIDEOS: Shown._video,
    SOUNDS: Shown._sound,
    CLIPS: Shown._clip,
    (".c3d",): Shown._markers,
}


def animated(head: Head, clip: Clip) -> HeadAnimation:
    """A head as a clip moves it: by its shapes if the clip holds weights and it has any.

    Raises
    ------
    InputError
        If the clip holds nothing that moves the head.
    """
    from ..retarget.conversion import clip_kind, faps_of, has_known_shapes
    from ..retarget.drive import HeadDrive
    from ..retarget.shape_solver import ShapeDrive

    if clip_kind(clip, head) != "faps" and has_known_shapes(head):
        return ShapeDrive(head).animate(clip)
    return HeadDrive(head).animate(faps_of(clip, head))


def head_model(label: str, head: Head, animation: HeadAnimation) -> PageModel:
    """An animated head for a page, with its feature points."""
    from ..core.formats.gltf import glb_bytes
    from ..retarget.export import animation_glb
    from .page_points import feature_point_places
    from .page_size import rounded_glb

    glb = glb_bytes(animation_glb(head, animation, name=label))
    places = feature_point_places(glb, head)
    start_s = float(animation.time_s[0]) if len(animation.time_s) else 0.0
    return PageModel(label, rounded_glb(glb), start_s, points=places)


def _pairs(clips: Sequence[PageCurves], heads: Sequence[str]) -> list[tuple[PageCurves, str]]:
    if len(clips) == len(heads):
        return list(zip(clips, heads, strict=True))
    if len(heads) == 1:
        return [(clip, heads[0]) for clip in clips]
    if len(clips) == 1:
        return [(clips[0], head) for head in heads]
    raise InputError(
        f"{len(clips)} clips and {len(heads)} heads do not go together: give one --head for each "
        "clip, one for all clips, or one clip for all heads"
    )


def _built_in(name: str | None) -> Head | None:
    from ..heads.catalogue import BUILT_IN, built_in_head

    return built_in_head(name) if name in BUILT_IN and name is not None else None


def _has_sound(path: Path) -> bool:
    from ..core.video import open_container

    with open_container(path, "a video") as container:
        return bool(container.streams.audio)


def _marker_set_of(tracks: Trajectories) -> MarkerSet | None:
    """The ready marker set whose labels the markers bear."""
    from ..heads.marker_sets import READY_SETS, ready_marker_set

    for name in READY_SETS:
        ready = ready_marker_set(name)
        if tracks.names == ready.labels:
            return ready
    return None
