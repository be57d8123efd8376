"""The part of the page that chooses drive and time, and sends the camera to places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from recast.arrays import Array
from recast.geometry import se3
from recast.viewer.inputs import ViewedDrive
from recast.viewer.playback import Change, Playback

if TYPE_CHECKING:
    import viser


BEHIND_EGO = "behind the ego"
ABOVE = "from above"
AT_ACTOR = "beside the actor"
_FOV = np.radians(60.0)
_OVERVIEW = 30  # steps
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


def first_look(drive: ViewedDrive) -> PlayLook:
    """What is seen when the page opens."""
    name = next(iter(look_names(drive)))
    return look(drive, name, 0)


def overview(drive: ViewedDrive) -> PlayLook:
    """A look over all of a drive's first seconds from behind, for who cannot ride along."""
    if drive.rig is None:
        return first_look(drive)
    middle = drive.rig[min(len(drive) // 2, _OVERVIEW)]
    return _from(middle, (-20.0, 0.0, 8.0), (14.0, 0.0, 0.0))


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
        playback: playback that the panel steers.
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
