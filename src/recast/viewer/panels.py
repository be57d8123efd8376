"""Parts of the page: drive, time and camera; layers; two arms side by side; the exact view."""

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
from recast.viewer.drives import ViewedDrive
from recast.viewer.stage import LAYERS, Change, Playback, ViewerStage

if TYPE_CHECKING:
    import viser


BEHIND_EGO = "behind the ego"
ABOVE = "from above"
AT_ACTOR = "beside the actor"
_FOV = np.radians(60.0)
_FIRST_S = 1.0
_ABOVE_START, _AHEAD_OF_START = (-2.0, 0.0, 3.2), (14.0, 0.0, 0.8)
"""Metres from the rig: near the logged cameras, and above the roof of the ego."""
_FREE = "none"
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")


@dataclass(frozen=True)
class PlayLook:
    """A level camera.

    Attributes:
        eye, target: (3,) points in the world, metres.
        fov: vertical field of view, radians.
    """

    eye: Array
    target: Array
    fov: float = float(_FOV)


def look_names(drive: ViewedDrive) -> tuple[str, ...]:
    """Names of the places that a drive has."""
    names = []
    if drive.rig is not None:
        names += [BEHIND_EGO]
    if drive.controlled:
        names += [AT_ACTOR]
    return (*names, ABOVE, *drive.cameras)


def look(drive: ViewedDrive, name: str, step: int) -> PlayLook:
    """A camera by name at a step.

    Raises:
        KeyError: the drive has no such place.
    """
    if name == BEHIND_EGO and drive.rig is not None:
        return _from(drive.rig[step], (-9.0, 0.0, 4.0), (10.0, 0.0, 0.5))
    if name == AT_ACTOR and drive.controlled:
        return beside(drive, drive.controlled[0], step)
    if name == ABOVE:
        middle = _middle(drive, step)
        return PlayLook(middle + np.array([-12.0, 0.0, 32.0]), middle + np.array([4.0, 0.0, 0.0]))
    mount = drive.cameras[name]
    assert drive.rig is not None  # cameras are on a rig
    pose = drive.rig[step] @ mount.rig_from_camera
    return PlayLook(pose[:3, 3], pose[:3, 3] + 10 * pose[:3, 2], mount.fov)


def beside(drive: ViewedDrive, track: str, step: int) -> PlayLook:
    """A look at a track from ahead of it and to its left; from where it first is, before that."""
    poses = drive.poses[track]
    there = np.flatnonzero(~np.isnan(poses[:, 0, 0]))
    pose = poses[there[np.abs(there - step).argmin()]]
    reach = float(drive.sizes[track][0])
    return _from(pose, (1.1 * reach, 1.1 * reach, 0.45 * reach), (0.0, 0.0, 0.0))


def first_step(drive: ViewedDrive) -> int:
    """The step at which the page opens: a second after the start, when all is in motion."""
    return min(round(_FIRST_S / drive.dt), len(drive) - 1) if drive.rig is not None else 0


def first_look(drive: ViewedDrive) -> PlayLook:
    """What is seen when the page opens: what the camera that looks ahead sees.

    There a street is sharpest: from other places it shows what no image does.
    """

    def ahead(name: str) -> float:
        return float(drive.cameras[name].rig_from_camera[0, 2])

    name = max(drive.cameras, key=ahead, default=next(iter(look_names(drive))))
    return look(drive, name, first_step(drive))


def overview(drive: ViewedDrive) -> PlayLook:
    """A look along the drive from just above where it begins, for who cannot ride along."""
    if drive.rig is None:
        return first_look(drive)
    return _from(drive.rig[0], _ABOVE_START, _AHEAD_OF_START)


def _middle(drive: ViewedDrive, step: int) -> Array:
    if drive.rig is not None:
        return np.asarray(drive.rig[step][:3, 3], np.float64)
    poses = drive.at(step) or {key: p[~np.isnan(p[:, 0, 0])][0] for key, p in drive.poses.items()}
    places = [pose[:3, 3] for pose in poses.values()]
    return np.mean(places, axis=0) if places else np.zeros(3)


def _from(pose: Array, eye: tuple[float, ...], target: tuple[float, ...]) -> PlayLook:
    found = se3.apply(pose, np.array([eye, target]))
    return PlayLook(found[0], found[1])


class PlayPanel:
    """Scenario, arm, timeline, events and cameras.

    Args:
        server: server that gets the elements, within the container that is open.
    """

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._server, self._playback = server, playback
        self._riding: dict[int, str] = {}
        gui = server.gui
        self._scenario = gui.add_dropdown("Scenario", self._scenarios())
        self._arm = gui.add_dropdown("Arm", playback.arms)
        self._slider = gui.add_slider("Step", 0, _last(playback.drive), 1, 0)
        self._time = gui.add_markdown("")
        self._play = gui.add_button("Play")
        self._steps = gui.add_button_group("Step by", ("-10", "-1", "+1", "+10"))
        self._speed = gui.add_dropdown("Speed", _SPEEDS, initial_value="1")
        self._event = gui.add_dropdown("Moment", _events(playback.drive))
        self._go_event = gui.add_button("Go to the moment")
        self._look = gui.add_dropdown("Camera", look_names(playback.drive))
        self._go_look = gui.add_button_group("Camera:", ("go there", "follow", "release"))
        self._slider.on_update(lambda event: self._by_hand(event, self._slider.value))
        self._scenario.on_update(lambda event: self._select(event, scenario=self._scenario.value))
        self._arm.on_update(lambda event: self._select(event, arm=self._arm.value))
        self._play.on_click(lambda _: playback.play(not playback.playing))
        self._steps.on_click(lambda _: playback.by(int(self._steps.value)))
        self._speed.on_update(lambda _: setattr(playback, "speed", float(self._speed.value)))
        self._go_event.on_click(lambda _: self._to_event())
        self._go_look.on_click(lambda event: self._to_look(event.client))
        server.on_client_disconnect(lambda client: self._riding.pop(client.client_id, None))
        playback.subscribe(self._changed)
        self._changed("drive")

    def _scenarios(self) -> tuple[str, ...]:
        return tuple(self._playback.inputs.scenarios)

    def _by_hand(self, event: viser.GuiEvent, step: int) -> None:
        if event.client is not None:  # not the playback itself
            self._playback.go_to(step)

    def _select(
        self, event: viser.GuiEvent, scenario: str | None = None, arm: str | None = None
    ) -> None:
        if event.client is not None:
            self._playback.select(scenario, arm)

    def _changed(self, change: Change) -> None:
        playback, drive = self._playback, self._playback.drive
        if change == "drive":
            self._scenario.options = self._scenarios()
            self._scenario.value = playback.scenario
            self._arm.options = playback.arms
            self._arm.value = playback.arm
            self._slider.max = _last(drive)
            self._event.options = _events(drive)
            self._look.options = look_names(drive)
        if change in ("drive", "step"):
            step = playback.step
            self._slider.value = step
            self._time.content = f"{step * drive.dt:.1f} of {(len(drive) - 1) * drive.dt:.1f} s"
            self._ride()
        if change == "playing":
            self._play.label = "Pause" if playback.playing else "Play"

    def _to_event(self) -> None:
        number = _events(self._playback.drive).index(self._event.value)
        if self._playback.drive.events:
            self._playback.go_to(self._playback.drive.events[number].step)

    def _to_look(self, client: viser.ClientHandle | None) -> None:
        if client is None:
            return
        what = self._go_look.value
        if what == "release":
            self._riding.pop(client.client_id, None)
            return
        if what == "follow":
            self._riding[client.client_id] = self._look.value
        aim(client, look(self._playback.drive, self._look.value, self._playback.step))

    def _ride(self) -> None:
        """Take along the windows that follow a camera."""
        clients, drive = self._server.get_clients(), self._playback.drive
        for number, name in tuple(self._riding.items()):
            if number in clients and name in look_names(drive):
                aim(clients[number], look(drive, name, self._playback.step))


def aim(client: viser.ClientHandle, where: PlayLook) -> None:
    """Put a window's camera somewhere."""
    with client.atomic():
        client.camera.position = where.eye
        client.camera.look_at = where.target
        client.camera.fov = where.fov


def open_at(server: viser.ViserServer, where: PlayLook) -> None:
    """Have windows begin with a look."""
    server.initial_camera.position = where.eye
    server.initial_camera.look_at = where.target
    server.initial_camera.fov = where.fov


def _last(drive: ViewedDrive) -> int:
    return max(len(drive) - 1, 1)


def _events(drive: ViewedDrive) -> tuple[str, ...]:
    return tuple(f"{e.step * drive.dt:.1f} s: {e.label}" for e in drive.events) or (_FREE,)


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
