"""The exact view of each window: drawn by the project's rasterizer once its camera rests."""

from __future__ import annotations

import logging
import time
from threading import Event, Thread
from typing import TYPE_CHECKING

import numpy as np

from recast.geometry import se3
from recast.viewer.exact import Browser, ExactView
from recast.viewer.playback import Change, Playback

if TYPE_CHECKING:
    import viser

REST = 0.4
"""Seconds for which a camera must not have moved."""
_BEFORE_ALL = 0.05  # metres, depth at which the picture covers everything else
_LOOK_EVERY = 0.1

_LOG = logging.getLogger(__name__)


class ExactPanel:
    """A checkbox, and a thread that draws; close it.

    Args:
        server: gets the checkbox, within the container that is open.
        playback: what is shown; nothing is drawn while it plays.
    """

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._server, self._playback = server, playback
        self._view = ExactView(playback.inputs.scenes)
        self._moved: dict[int, float] = {}
        self._drawn: set[int] = set()
        self._over = Event()
        self._on = server.gui.add_checkbox("Exact view", False)
        self._on.on_update(lambda _: self._changed("layers"))
        playback.subscribe(self._changed)
        server.on_client_connect(self._follow)
        server.on_client_disconnect(self._forget)
        self._thread = Thread(target=self._work, name="recast-exact-view", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._over.set()
        self._thread.join(timeout=10.0)

    def _follow(self, client: viser.ClientHandle) -> None:
        self._moved[client.client_id] = time.monotonic()
        client.camera.on_update(lambda _: self._clear(client))

    def _forget(self, client: viser.ClientHandle) -> None:
        self._moved.pop(client.client_id, None)
        self._drawn.discard(client.client_id)

    def _changed(self, change: Change) -> None:
        if change != "playing":
            for client in self._server.get_clients().values():
                self._clear(client)

    def _clear(self, client: viser.ClientHandle) -> None:
        self._moved[client.client_id] = time.monotonic()
        if client.client_id in self._drawn:
            self._drawn.discard(client.client_id)
            client.scene.set_background_image(None)

    def _work(self) -> None:
        while not self._over.wait(_LOOK_EVERY):
            playback = self._playback
            if not self._on.value or playback.clock.playing or not self._view.can(playback.arm):
                continue
            for client in self._server.get_clients().values():
                number = client.client_id
                moved = self._moved.get(number, time.monotonic())
                if number not in self._drawn and time.monotonic() - moved >= REST:
                    try:
                        self._draw(client, moved)
                    except Exception:  # one window may not end the view of the others
                        _LOG.warning("exact view failed", exc_info=True)
                        self._drawn.add(number)

    def _draw(self, client: viser.ClientHandle, moved: float) -> None:
        playback = self._playback
        picture = self._view.picture(
            playback.arm, playback.drive, playback.clock.step, browser(client)
        )
        if self._moved.get(client.client_id) == moved:  # it still rests
            depth = np.full(picture.shape[:2], _BEFORE_ALL)
            client.scene.set_background_image(picture, format="jpeg", depth=depth)
            self._drawn.add(client.client_id)


def browser(client: viser.ClientHandle) -> Browser:
    """The camera of a window."""
    camera = client.camera
    pose = se3.from_rotation_translation(se3.quat_to_matrix(camera.wxyz), camera.position)
    return Browser(pose, camera.fov, camera.aspect)
