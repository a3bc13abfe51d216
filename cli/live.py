"""`facewright view --live`: a head in the browser that sliders move."""

from __future__ import annotations

import io
import socket
import threading
import time
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import InputError
from ..core.formats.live_link_csv import ARKIT_SHAPES
from ..core.mpeg4 import fap_by_name, fap_table
from ..heads.expressions import EXPRESSIONS, VISEMES
from .live_pose import FAP_GROUPS, Pose, PoseDrive, fap_file, slider_range
from .live_view import HeadView
from .options import note

if TYPE_CHECKING:
    import viser

    from ..heads.head import Head

DEFAULT_HEAD = "ruth"
_HOST = "127.0.0.1"


def show_live(name: str | None, port: int) -> None:
    """Serve a head with sliders until Ctrl-C.

    Parameters
    ----------
    name : str or None
        A built-in head or a file.
    port : int

    Raises
    ------
    FileFormatError, OSError
        If the head's file cannot be read.
    InputError
        If viser is not installed, the port is in use, or the head cannot be had.
    """
    from .heads import check_head, find_head

    _need_viser()
    _need_port(port)
    check_head(name or DEFAULT_HEAD)
    head = find_head(name or DEFAULT_HEAD)
    with _quiet():
        live = LiveHead(head, port)
    try:
        note(f"head {live.drive.head.name} at http://localhost:{live.port} (Ctrl-C ends)")
        while True:
            time.sleep(0.2)
    except KeyboardInterrupt:
        note("ended")
    finally:
        with _quiet():
            live.stop()


def _quiet() -> redirect_stdout[io.StringIO]:
    """Keep viser's own words from stdout, which is for results."""
    return redirect_stdout(io.StringIO())


def _need_viser() -> None:
    from importlib.util import find_spec

    if find_spec("viser") is None:
        raise InputError('--live needs the package viser: pip install "facewright[live]"')


def _need_port(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError as error:
            raise InputError(
                f"port {port} cannot be used ({error.strerror}): choose another by --port"
            ) from error


class LiveHead:
    """A server that shows a head and sliders that move it.

    Sliders may be moved from Python too: ``live.sliders["open_jaw"].value = 500``. The head is
    posed in a thread of its own that skips what is overtaken.

    Parameters
    ----------
    head : Head
    port : int
        On this machine only.

    Attributes
    ----------
    drive : PoseDrive
    server : viser.ViserServer
    sliders : dict from a FAP's, shape's, expression's or viseme's name to its slider
    posed : PosedHead
        What is shown.
    n_posed : int
        How often it was posed.

    Raises
    ------
    InputError
        If the head lacks feature points.
    """

    def __init__(self, head: Head, port: int) -> None:
        import viser

        self.drive = PoseDrive(head)
        self.server = viser.ViserServer(host=_HOST, port=port, label="facewright", verbose=False)
        self.sliders: dict[str, Any] = {}
        self.n_posed = 0
        self._kinds: dict[str, str] = {}
        self._is_due = threading.Event()
        self._is_ended = False
        self._view = HeadView(self.server, head)
        self._build_panel()
        self.posed = self.drive.posed(Pose())
        self._worker = threading.Thread(target=self._work, name="posing", daemon=True)
        self._worker.start()

    @property
    def port(self) -> int:
        """Where it is served."""
        return int(self.server.get_port())

    def pose(self) -> Pose:
        """What the sliders say."""
        found: dict[str, dict[str, float]] = {"faps": {}, "weights": {}, "looks": {}}
        for name, slider in self.sliders.items():
            found[self._kinds[name]][name] = float(slider.value)
        return Pose(**found)

    def reset(self) -> None:
        """All sliders to 0."""
        for slider in self.sliders.values():
            slider.value = 0.0

    def fap_file(self) -> bytes:
        """The pose as a .fap file of one frame."""
        return fap_file(self.drive.faps(self.pose()))

    def stop(self) -> None:
        """End the server. It may be called again."""
        if self._is_ended:
            return
        self._is_ended = True
        self._is_due.set()
        self._worker.join()
        self.server.stop()

    def _work(self) -> None:
        while True:
            self._is_due.wait()
            self._is_due.clear()
            if self._is_ended:
                return
            posed = self.drive.posed(self.pose())
            self._view.show(posed)
            self.posed = posed
            self.n_posed += 1

    def _build_panel(self) -> None:
        gui = self.server.gui
        head = self.drive.head
        gui.set_panel_label(f"facewright · {head.name}")
        reset = gui.add_button("Reset")
        save = gui.add_button("Save pose as .fap")
        reset.on_click(lambda _: self.reset())
        save.on_click(self._send)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Expressions"):
            self._add("looks", EXPRESSIONS)
            with gui.add_folder("Visemes", expand_by_default=False):
                self._add("looks", VISEMES[1:])
        with tabs.add_tab("FAPs"):
            for title, first, last in FAP_GROUPS:
                names = tuple(fap.name for fap in fap_table()[first - 1 : last])
                with gui.add_folder(title, expand_by_default=first == FAP_GROUPS[0][1]):
                    self._add("faps", names)
        with tabs.add_tab("ARKit"):
            if not self.drive.has_shapes:
                gui.add_markdown("This head has no such shapes: weights move it as FAPs.")
            self._add("weights", ARKIT_SHAPES)

    def _add(self, kind: str, names: tuple[str, ...]) -> None:
        for name in names:
            low, high = slider_range(fap_by_name()[name]) if kind == "faps" else (0.0, 1.0)
            step = 0.01 if high <= 1 else 10.0 ** np.floor(np.log10(high) - 2)
            slider = self.server.gui.add_slider(
                name.replace("_", " "), low, high, float(step), 0.0, hint=_hint(kind, name)
            )
            slider.on_update(lambda _: self._is_due.set())
            self.sliders[name] = slider
            self._kinds[name] = kind

    def _send(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            event.client.send_file_download("pose.fap", self.fap_file(), save_immediately=True)


def _hint(kind: str, name: str) -> str | None:
    if kind != "faps":
        return None
    fap = fap_by_name()[name]
    unit = "1e-5 rad" if fap.fapu == "AU" else f"{fap.fapu}/1024"
    points = " and ".join(fap.feature_points)
    return f"FAP {fap.number}, {unit}" + (f", feature point {points}" if points else "")
