"""The part of the page that switches layers, compares arms, and shows the exact view."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.scene import SceneRasterizer, StreetScene
from recast.viewer.inputs import ViewedDrive
from recast.viewer.playback import Change, Playback
from recast.viewer.stage import LAYERS, ViewerStage

if TYPE_CHECKING:
    import viser

_LOG = logging.getLogger(__name__)


_NOTHING = np.full((90, 160, 3), 40, np.uint8)
WIDEST = 640
"""Pixels of an exact picture."""
REST = 0.4
"""Seconds for which a camera must not have moved."""
_BEFORE_ALL = 0.05  # metres, depth at which the picture covers everything else
_LOOK_EVERY = 0.1


class LayersPanel:
    """A checkbox for each layer."""

    def __init__(self, server: viser.ViserServer, playback: Playback, stage: ViewerStage) -> None:
        for layer in LAYERS:
            box = server.gui.add_checkbox(
                layer.capitalize() if layer.islower() else layer, layer in stage.layers
            )

            def switch(
                _: viser.GuiEvent, layer: str = layer, box: viser.GuiCheckboxHandle = box
            ) -> None:
                (stage.layers.add if box.value else stage.layers.discard)(layer)
                playback.refresh()

            box.on_update(switch)


class ComparePanel:
    """The pictures of one camera in two arms, side by side, at the step that is shown."""

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._playback = playback
        gui = server.gui
        names = dict.fromkeys(
            name
            for drive in playback.inputs.drives
            for name, mount in drive.cameras.items()
            if mount.film is not None
        )
        self._on = gui.add_checkbox("Show images", False, disabled=not names)
        self._camera = gui.add_dropdown("Camera", tuple(names) or ("none",))
        self._arms = [gui.add_dropdown(side, playback.arms) for side in ("First", "Second")]
        self._panes = [gui.add_image(_NOTHING, format="jpeg", visible=False) for _ in self._arms]
        self._arms[-1].value = playback.arms[-1]
        self._on.on_update(lambda _: self._switch())
        for handle in (self._camera, *self._arms):
            handle.on_update(lambda _: self.update())
        playback.subscribe(self._changed)

    def _changed(self, change: Change) -> None:
        if change == "drive":
            for handle in self._arms:
                wanted = handle.value
                handle.options = self._playback.arms
                handle.value = wanted if wanted in self._playback.arms else self._playback.arms[0]

    def _switch(self) -> None:
        for pane in self._panes:
            pane.visible = self._on.value
        self.update()

    def update(self) -> None:
        """Show the pictures of the step that is shown."""
        if not self._on.value:
            return
        drives = self._playback.inputs.scenarios[self._playback.scenario]
        step = self._playback.step
        for arm, pane in zip(self._arms, self._panes, strict=True):
            drive = drives.get(arm.value)
            pane.image = _NOTHING if drive is None else _picture(drive, self._camera.value, step)


def _picture(drive: ViewedDrive, camera: str, step: int) -> NDArray[np.uint8]:
    mount = drive.cameras.get(camera)
    if mount is None or mount.film is None or len(mount.film) == 0:
        return _NOTHING
    return mount.film[min(step, len(mount.film) - 1)]


@dataclass(frozen=True)
class Browser:
    """The camera of one browser window.

    Attributes:
        world_from_camera: (4, 4), OpenCV axes.
        fov: vertical field of view, radians.
        aspect: width over height.
    """

    world_from_camera: Array
    fov: float
    aspect: float

    def pinhole(self, widest: int = WIDEST) -> PinholeCamera:
        """The same view at most `widest` pixels wide and high."""
        width = widest if self.aspect >= 1 else max(1, round(widest * self.aspect))
        height = max(1, round(width / self.aspect))
        focal = height / 2 / math.tan(self.fov / 2)
        return PinholeCamera(width, height, focal, focal, width / 2, height / 2)


class ExactView:
    """Draws scenes by arm; one picture at a time, as the rasterizer uses all cores.

    Args:
        scenes: scenes by arm; None for arms without Gaussians.
    """

    def __init__(self, scenes: Mapping[str, StreetScene | None]) -> None:
        self._scenes = scenes
        self._rasterizers: dict[str, SceneRasterizer] = {}
        self._lock = Lock()

    def can(self, arm: str) -> bool:
        """Whether an arm has something to draw."""
        return self._scenes.get(arm) is not None

    def picture(self, arm: str, drive: ViewedDrive, step: int, browser: Browser) -> Image:
        """The scene of an arm (H, W, 3) RGB at a step of a drive, as a browser sees it.

        Raises:
            KeyError: the arm has no Gaussians.
        """
        scene = self._scenes.get(arm)
        if scene is None:
            raise KeyError(arm)
        poses = {key: pose for key, pose in drive.at(step).items() if key in scene.actors}
        with self._lock:
            if arm not in self._rasterizers:
                self._rasterizers[arm] = SceneRasterizer(scene)
            image = self._rasterizers[arm].render(
                browser.pinhole(),
                se3.inverse(browser.world_from_camera),
                poses,
                shapes_us=int(drive.times_us[step]),
            )
        return np.asarray(np.rint(image.rgb * 255), np.uint8)


class ExactPanel:
    """A checkbox, and a thread that draws; close it.

    Args:
        server: server that gets the checkbox, within the container that is open.
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
            if not self._on.value or playback.playing or not self._view.can(playback.arm):
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
        picture = self._view.picture(playback.arm, playback.drive, playback.step, browser(client))
        if self._moved.get(client.client_id) == moved:  # it still rests
            depth = np.full(picture.shape[:2], _BEFORE_ALL)
            client.scene.set_background_image(picture, format="jpeg", depth=depth)
            self._drawn.add(client.client_id)


def browser(client: viser.ClientHandle) -> Browser:
    """The camera of a window."""
    camera = client.camera
    pose = se3.from_rotation_translation(se3.quat_to_matrix(camera.wxyz), camera.position)
    return Browser(pose, camera.fov, camera.aspect)
