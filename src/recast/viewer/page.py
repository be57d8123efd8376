"""The page, a viser server with everything on it, and a replay, one HTML file without a server.

The package viser is optional."""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from recast.core import files
from recast.core.errors import InputError
from recast.core.web_server import refusal_of
from recast.viewer.drives import ViewInputs
from recast.viewer.panel_run import RunPanel, TrackPanel, escaped
from recast.viewer.panels import (
    ComparePanel,
    ExactPanel,
    LayersPanel,
    PlayPanel,
    first_look,
    first_step,
    open_at,
    overview,
)
from recast.viewer.stage import Change, Playback, Shown, ViewerStage

if TYPE_CHECKING:
    import viser


_LOG = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
MOST_GAUSSIANS = 300_000
RENEW_EVERY = 5.0
"""Seconds between two looks at what a run has made meanwhile."""
RATE = 30.0
"""Updates a second while it plays."""
_PICTURES_EVERY = 0.2
"""Seconds between two updates of the cameras' pictures and the LiDAR while it plays."""


class Page:
    """Serves the viewer until it is closed.

    Args:
        most: number of Gaussians at most that browsers get of an arm.
        out: folder for scenario files.
        host: address to listen on; other machines see the page only if it is not this one's own.
        port: TCP port; the next free one is taken if it is in use.
        names: further names of this machine that browsers may use, in lower case.

    Attributes:
        pruned: number of Gaussians of the first arm that are shown, in words.

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
        names: Collection[str] = (),
    ) -> None:
        self.server = open_server(host, port, names)
        self._most, self._out = most, out
        self._over = Event()
        self._open(inputs)
        open_at(self.server, first_look(self.playback.drive))
        self._thread = Thread(target=self._work, name="recast-viewer", daemon=True)
        self._thread.start()
        self._renewing = Thread(target=self._renew, name="recast-viewer-renewal", daemon=True)
        self._renewing.start()

    def _open(self, inputs: ViewInputs) -> None:
        """Fill the page."""
        self.playback = playback = Playback(inputs)
        self._tracks: TrackPanel | None = None
        self._runs: RunPanel | None = None
        self._pictures_at = 0.0
        playback.go_to(first_step(playback.drive))
        self.stage = ViewerStage(
            self.server, playback.inputs, self._most, [playback.arm], on_click=self._clicked
        )
        self.pruned = _share(self.stage.splats.kept, self.stage.splats.total)
        self._fill(self._out)
        playback.subscribe(self._changed)
        self.stage.show(playback.shown)
        self._sending = Thread(target=self._send, name="recast-viewer-arms", daemon=True)
        self._sending.start()

    @property
    def url(self) -> str:
        """Address for a browser on this machine."""
        host = self.server.get_host()
        return f"http://{'localhost' if host == '0.0.0.0' else host}:{self.server.get_port()}"

    def _repr_html_(self) -> str:
        """The page in a notebook."""
        return f'<iframe src="{self.url}" width="100%" height="600"></iframe>'

    def close(self) -> None:
        """Stop playing and serving."""
        self._over.set()
        for thread in (self._thread, self._renewing, self._sending):
            thread.join(timeout=10.0)
        self._exact.close()
        close_server(self.server)

    def _fill(self, out: Path) -> None:
        gui, playback = self.server.gui, self.playback
        gui.main_panel.dock_right()
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
                self._runs = RunPanel(self.server, playback, playback.inputs.runner, out)

    def _clicked(self, track: str) -> None:
        if self._tracks is not None:
            self._tracks.show(track)

    def _changed(self, change: Change) -> None:
        if change == "playing":
            return
        now = time.monotonic()
        pictures = not self.playback.playing or now - self._pictures_at >= _PICTURES_EVERY
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
                self.stage.splats.add([arm])
            except Exception:  # said again, and to the one who asks, when the arm is shown
                _LOG.warning("arm %s cannot be sent", arm, exc_info=True)

    def _renew(self) -> None:
        """Show what a run that goes on has made meanwhile, while nothing plays or is run."""
        while (renew := self.playback.inputs.renew) and not self._over.wait(RENEW_EVERY):
            if self.playback.playing or (self._runs is not None and self._runs.busy):
                continue
            try:
                inputs = renew()
                if inputs is not None:
                    self._replace(inputs)
            except Exception:  # such as a file that is being replaced: the next look may do
                _LOG.warning("what is new cannot be shown", exc_info=True)

    def _replace(self, inputs: ViewInputs) -> None:
        """Show other inputs, and the drives that were run from the page."""
        self._sending.join()
        self._exact.close()
        shown, own = self.playback.shown, self.playback.added
        self.server.scene.reset()
        self.server.gui.reset()
        self._open(inputs)
        first = self.playback.shown
        for scenario, arm, drive in own:
            if arm in inputs.scenes:
                self.playback.add(scenario, arm, drive)
        there = shown.arm in self.playback.inputs.scenarios.get(shown.scenario, {})
        wanted = shown if there else first
        self.playback.select(wanted.scenario, wanted.arm)
        self.playback.go_to(wanted.step)

    def _work(self) -> None:
        before = time.monotonic()
        while not self._over.wait(1 / RATE):
            now = time.monotonic()
            self.playback.tick(now - before)
            before = now


def _share(kept: int, total: int) -> str:
    return f"{kept:,} of {total:,} Gaussians ({kept / total:.0%})" if total else "no Gaussians"


def require_viser() -> None:
    """Refuse early if the extra is missing.

    Raises:
        InputError: viser is not installed.
    """
    try:
        import viser  # noqa: F401
    except ImportError:
        raise InputError(
            "viser", "module", "is not installed", "pip install 'recast-sim[viewer]'"
        ) from None


def open_server(
    host: str = LOOPBACK, port: int = 8080, names: Collection[str] = ()
) -> viser.ViserServer:
    """Start a viser server that prints nothing, answers no page of another site, and cannot be
    shared through viser's tunnel.

    Args:
        host: address to listen on.
        port: TCP port; the next free one is taken if it is in use.
        names: see `recast.core.web_server.refusal_of`.

    Raises:
        InputError: viser is not installed, or the address is not one of this machine.
    """
    require_viser()
    import viser

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> str | None:
            """Nothing: a page must not open a tunnel to the outside."""
            return None

    _require_own(host)  # viser itself would wait for ever
    with redirect_stdout(StringIO()), _handshakes_checked(host, names):
        server = Server(host=host, port=port, verbose=False)
    server.gui.configure_theme(
        control_width="large", dark_mode=True, show_logo=False, show_share_button=False
    )
    return server


@contextmanager
def _handshakes_checked(listening: str, names: Collection[str]) -> Iterator[None]:
    """Servers that viser starts meanwhile answer nobody else than `refusal_of` lets ask.

    viser has no setting for it: its WebSocket takes every page that a browser shows. A version of
    viser that listens in another way is refused rather than left open.
    """
    from websockets.asyncio import server as listener
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    serve, used = listener.serve, []

    def checked(answer: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        def process(connection: Any, request: Any) -> Any:
            hosts, origins = (request.headers.get_all(key) for key in ("Host", "Origin"))
            refused = refusal_of(listening, hosts, origins, names)
            if refused is not None:
                return Response(403, "Forbidden", Headers(), f"{refused}\n".encode())
            response = answer(connection, request)
            if response is not None:  # a page in whose frame it lies could guide a click
                response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
            return response

        return process

    def guarded(*args: Any, process_request: Any, **options: Any) -> Any:
        used.append(process_request)
        return serve(*args, process_request=checked(process_request), **options)

    listener.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        listener.serve = serve  # type: ignore[misc]
    if not used:
        raise InputError(
            "viser",
            "version",
            "cannot be protected from other web pages",
            "pip install 'viser~=1.1'",
        )


def close_server(server: viser.ViserServer) -> None:
    """Stop a server, again without a word."""
    with redirect_stdout(StringIO()):
        server.stop()


def _require_own(host: str) -> None:
    """Refuse an address that is none of this machine's."""
    try:
        with socket.socket() as trial:
            trial.bind((host, 0))
    except OSError as error:
        raise InputError(
            "`host`",
            host,
            f"cannot be used as the server's address ({error.strerror or error})",
            "give an IPv4 address of this machine",
        ) from None


REPLAY_MB = 15.0
"""Default size of a replay at most, in 1e6 bytes."""
_PAUSE = 1.0  # seconds at the end of each arm
_REPLAYED_EVERY = 5  # steps
_TRIES = 6
_MARGIN = 0.95
_PAGE = 900_000  # bytes of a replay without a scene
_GAUSSIAN = 36  # bytes, at least: 28 in base 64, of which zstd saves little


@dataclass(frozen=True)
class ReplaySize:
    """What a replay came to.

    Attributes:
        bytes: size of the file in bytes.
        kept: number of Gaussians in the file.
        total: number of Gaussians that there were.
    """

    bytes: int
    kept: int
    total: int


def write_replay(
    inputs: ViewInputs,
    path: str | Path,
    *,
    scenario: str | None = None,
    most_mb: float = REPLAY_MB,
    most: int = MOST_GAUSSIANS,
) -> ReplaySize:
    """Write the drive of one scenario as an HTML file that plays by itself, arm after arm.

    Arms without Gaussians are left out if others have some.

    The number of Gaussians is lowered until the file is small enough. While it works, it holds a
    port of this machine that only this machine reaches.

    Args:
        path: file to write; one that is there is replaced.
        scenario: name of the scenario; None for the first.
        most_mb: largest size of the file, in 1e6 bytes.
        most: largest number of Gaussians.

    Raises:
        InputError: viser is not installed, there is no such scenario, the file would be too large
            even without Gaussians, or the disk refuses.
    """
    name = next(iter(inputs.scenarios)) if scenario is None else scenario
    if name not in inputs.scenarios:
        raise InputError(
            "replay",
            f"scenario {name}",
            "is not in the run",
            f"choose one of {', '.join(inputs.scenarios)}",
        )
    limit = round(most_mb * 1e6)
    most = min(most, max(limit - _PAGE, 0) // _GAUSSIAN)  # what surely does not fit is not tried
    shown = _only(inputs, name)
    for _ in range(_TRIES):
        html, kept, total = _recorded(shown, name, most)
        size = len(html.encode())
        if size <= limit or kept == 0:
            break
        most = round(kept * max(limit - _PAGE, 0) / max(size - _PAGE, 1) * _MARGIN)
    if size > limit:
        raise InputError(
            "replay",
            "size",
            f"is at least {size / 1e6:.1f} MB",
            f"set `replay_mb` above {most_mb:g}",
        )
    files.write_text(Path(path), html)
    return ReplaySize(size, kept, total)


def _only(inputs: ViewInputs, scenario: str) -> ViewInputs:
    """One scenario, with the arms that have Gaussians; without what only a page can show."""
    drives = inputs.scenarios[scenario]
    drawn = {arm: drive for arm, drive in drives.items() if inputs.scenes.get(arm) is not None}
    drives = drawn or drives
    scenes = {arm: inputs.scenes.get(arm) for arm in drives}
    return replace(inputs, scenes=scenes, scenarios={scenario: drives}, actors={}, runner=None)


def _recorded(inputs: ViewInputs, scenario: str, most: int) -> tuple[str, int, int]:
    """The page, and how many Gaussians it has of how many."""
    server = open_server(LOOPBACK, 8099)
    try:
        stage = ViewerStage(server, inputs, most, inputs.scenes)
        drives = inputs.scenarios[scenario]
        open_at(server, overview(next(iter(drives.values()))))
        first = next(iter(drives))
        stage.show(Shown(scenario, first, 0))
        recording = server.get_scene_serializer()
        for arm, drive in drives.items():
            if drive.rig is not None and len(drives) > 1:  # the label rides on the ego
                server.scene.add_label("/ego/box/arm", arm, position=(0.0, 0.0, 2.0))
            for step in range(len(drive)):
                stage.show(Shown(scenario, arm, step), step % _REPLAYED_EVERY == 0)
                recording.insert_sleep(drive.dt)
            recording.insert_sleep(_PAUSE)
        return recording.as_html(dark_mode=True), stage.splats.kept, stage.splats.total
    finally:
        close_server(server)
