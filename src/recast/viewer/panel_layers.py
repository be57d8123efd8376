"""The part of the page that switches layers, compares arms, and shows the exact view."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from recast.viewer.inputs import Drive
from recast.viewer.playback import Change, Playback
from recast.viewer.stage import LAYERS, Stage

if TYPE_CHECKING:
    import viser

_NOTHING = np.full((90, 160, 3), 40, np.uint8)


class LayersPanel:
    """A checkbox for each layer."""

    def __init__(self, server: viser.ViserServer, playback: Playback, stage: Stage) -> None:
        for layer in LAYERS:
            box = server.gui.add_checkbox(layer.capitalize() if layer.islower() else layer,
                                          layer in stage.layers)  # fmt: skip

            def switch(_: viser.GuiEvent, layer: str = layer,
                       box: viser.GuiCheckboxHandle = box) -> None:  # fmt: skip
                (stage.layers.add if box.value else stage.layers.discard)(layer)
                playback.refresh()

            box.on_update(switch)


class ComparePanel:
    """The pictures of one camera in two arms, side by side, at the step that is shown."""

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._playback = playback
        gui = server.gui
        names = dict.fromkeys(
            name for arms in playback.inputs.scenarios.values() for drive in arms.values()
            for name, mount in drive.cameras.items() if mount.film is not None
        )  # fmt: skip
        self._on = gui.add_checkbox("Show pictures", False, disabled=not names)
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
        step = self._playback.clock.step
        for arm, pane in zip(self._arms, self._panes, strict=True):
            drive = drives.get(arm.value)
            pane.image = _NOTHING if drive is None else _picture(drive, self._camera.value, step)


def _picture(drive: Drive, camera: str, step: int) -> NDArray[np.uint8]:
    mount = drive.cameras.get(camera)
    if mount is None or mount.film is None or len(mount.film) == 0:
        return _NOTHING
    return mount.film[min(step, len(mount.film) - 1)]
