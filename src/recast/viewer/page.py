"""The page: a viser server with everything on it."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from threading import Event, Thread

from recast.viewer.extra import LOOPBACK, close_server, open_server
from recast.viewer.inputs import ViewInputs
from recast.viewer.looks import first_look
from recast.viewer.panel_exact import ExactPanel
from recast.viewer.panel_layers import ComparePanel, LayersPanel
from recast.viewer.panel_play import PlayPanel, open_at
from recast.viewer.panel_run import RunPanel
from recast.viewer.panel_track import TrackPanel, escaped
from recast.viewer.playback import Change, Playback
from recast.viewer.stage import Stage

_LOG = logging.getLogger(__name__)

MOST_GAUSSIANS = 300_000
RATE = 30.0
"""Updates a second while it plays."""
_PICTURES_EVERY = 0.2
"""Seconds between two updates of the cameras' pictures and the LiDAR while it plays."""


class Page:
    """Serves the viewer until it is closed.

    Args:
        inputs: what is shown.
        most: number of Gaussians at most that browsers get of an arm.
        out: folder for scenario files.
        host: address to listen on; other machines see the page only if it is not this one's own.
        port: TCP port; the next free one is taken if it is in use.

    Attributes:
        pruned: how many Gaussians of the first arm are shown, in words.

    Raises:
        InputError: viser is not installed, or the address is none of this machine.
    """

    def __init__(
        self,
        inputs: ViewInputs,
        most: int = MOST_GAUSSIANS,
        out: Path = Path("scenarios"),
        host: str = LOOPBACK,
        port: int = 8080,
    ) -> None:
        self.server = open_server(host, port)
        self.playback = Playback(inputs)
        self._tracks: TrackPanel | None = None
        self._pictures_at = 0.0
        self._over = Event()
        self.stage = Stage(
            self.server, self.playback.inputs, most, [self.playback.arm], on_click=self._clicked
        )
        self.pruned = _share(self.stage.splats.kept, self.stage.splats.total)
        self._fill(out)
        open_at(self.server, first_look(self.playback.drive))
        self.playback.subscribe(self._changed)
        self.stage.show(self.playback.shown)
        self._thread = Thread(target=self._work, name="recast-viewer", daemon=True)
        self._thread.start()
        self._sending = Thread(target=self._send, name="recast-viewer-arms", daemon=True)
        self._sending.start()

    @property
    def url(self) -> str:
        """Address for a browser on this machine."""
        host = self.server.get_host()
        return f"http://{'localhost' if host == '0.0.0.0' else host}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop playing and serving."""
        self._over.set()
        self._thread.join(timeout=10.0)
        self._sending.join(timeout=10.0)
        self._exact.close()
        close_server(self.server)

    def _fill(self, out: Path) -> None:
        gui, playback = self.server.gui, self.playback
        gui.set_panel_label("recast view")
        gui.add_markdown(f"**{escaped(playback.inputs.title)}**  \n{self.pruned}")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Play"):
            self._play = PlayPanel(self.server, playback)
            self._exact = ExactPanel(self.server, playback)
            with gui.add_folder("Side by side", expand_by_default=False):
                self._compare = ComparePanel(self.server, playback)
        with tabs.add_tab("Layers"):
            LayersPanel(self.server, playback, self.stage)
        with tabs.add_tab("Track"):
            self._tracks = TrackPanel(self.server, playback)
        if playback.inputs.runner is not None:
            with tabs.add_tab("Run"):
                RunPanel(self.server, playback, playback.inputs.runner, out)

    def _clicked(self, track: str) -> None:
        if self._tracks is not None:
            self._tracks.show(track)

    def _changed(self, change: Change) -> None:
        if change == "playing":
            return
        now = time.monotonic()
        pictures = not self.playback.clock.playing or now - self._pictures_at >= _PICTURES_EVERY
        self.stage.show(self.playback.shown, pictures)
        if pictures:
            self._pictures_at = now
            self._compare.update()

    def _send(self) -> None:
        """The arms that are not shown yet, so that they are there when they are."""
        for arm in self.playback.inputs.scenes:
            if self._over.is_set():
                return
            try:
                self.stage.send([arm])
            except Exception:  # said again, and to the one who asks, when the arm is shown
                _LOG.warning("arm %s cannot be sent", arm, exc_info=True)

    def _work(self) -> None:
        before = time.monotonic()
        while not self._over.wait(1 / RATE):
            now = time.monotonic()
            self.playback.tick(now - before)
            before = now


def _share(kept: int, total: int) -> str:
    return f"{kept:,} of {total:,} Gaussians ({kept / total:.0%})" if total else "no Gaussians"
