"""The working folder of a long take: what is finished of it, for which inputs and settings.

``OUT.part/`` holds ``manifest.json`` (sizes and times of the inputs, the settings) and a file for
each finished chunk. A run that was killed goes on from there; where inputs or settings are others,
it begins anew.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.files import atomic_path, atomic_write
from ..core.trajectories import Trajectories

VERSION = 1
_UPPER = np.triu_indices(3)


def part_folder(out: Path) -> Path:
    """Where unfinished work on a file lies: beside it."""
    return out.with_name(f"{out.name}.part")


class ChunkFiles:
    """Reads and writes a working folder.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def begin(self, asked: Mapping[str, Any]) -> bool:
        """Open the folder for a piece of work; whether an earlier run left some of the same."""
        text = json.dumps({"version": VERSION, **asked}, sort_keys=True, indent=1)
        manifest = self.folder / "manifest.json"
        if manifest.is_file() and manifest.read_text("utf-8") == text:
            return any(self.folder.glob("*.npz"))
        for path in self.folder.iterdir():  # of other inputs or settings
            path.unlink()
        with atomic_write(manifest) as stream:
            stream.write(text)
        return False

    def has(self, kind: str, index: int) -> bool:
        """Whether a chunk is finished."""
        return self._path(kind, index).is_file()

    def write(self, kind: str, index: int, tracks: Trajectories, **more: NDArray[Any]) -> None:
        """Keep a chunk, and arrays that belong to it."""
        assert tracks.covariances is not None
        assert tracks.residual_px is not None
        assert tracks.n_views is not None
        with atomic_path(self._path(kind, index)) as part, open(part, "wb") as stream:
            np.savez(
                stream,
                time_s=tracks.time_s,
                names=np.array(tracks.names, dtype=np.str_),
                positions=tracks.positions,
                # half of them say it all, and nobody needs seven digits of an error
                covariances=tracks.covariances[..., *_UPPER].astype(np.float32),
                source=tracks.source,
                residual_px=tracks.residual_px.astype(np.float32),
                n_views=tracks.n_views.astype(np.uint8),
                **more,  # type: ignore[arg-type]
            )

    def read(self, kind: str, index: int) -> tuple[Trajectories, dict[str, NDArray[Any]]]:
        """A finished chunk, and the arrays that were kept with it."""
        with np.load(self._path(kind, index), allow_pickle=False) as file:
            arrays = dict(file)
        upper = arrays.pop("covariances").astype(np.float64)
        covariances = np.empty((*upper.shape[:2], 3, 3))
        covariances[..., *_UPPER] = upper
        covariances[..., *_UPPER[::-1]] = upper
        tracks = Trajectories(
            arrays.pop("time_s"),
            tuple(str(n) for n in arrays.pop("names")),
            arrays.pop("positions"),
            covariances,
            arrays.pop("source"),
            arrays.pop("residual_px"),
            arrays.pop("n_views"),
        )
        return tracks, arrays

    def remove(self) -> None:
        """All is done: away with it."""
        shutil.rmtree(self.folder)

    def remove_if_fruitless(self) -> None:
        """Away with it if nothing in it is worth going on from."""
        if not any(self.folder.glob("*.npz")):
            self.remove()

    def _path(self, kind: str, index: int) -> Path:
        return self.folder / f"{kind}_{index:05d}.npz"


def file_facts(path: Path) -> list[int | str]:
    """What tells whether a file is still the same: name, size, time of its last change."""
    stat = path.stat()
    return [str(path.resolve()), stat.st_size, stat.st_mtime_ns]
