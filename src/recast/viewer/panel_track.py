"""The part of the page that tells of a track what the log has seen of it."""

from __future__ import annotations

from functools import lru_cache
from threading import Lock
from typing import TYPE_CHECKING

from recast.viewer.evidence import Evidence, track_evidence
from recast.viewer.playback import Playback

if TYPE_CHECKING:
    import viser

_MOST_KEPT = 64


class TrackPanel:
    """Evidence and crops of the track that was clicked at.

    Args:
        server: gets the elements, within the container that is open.
        playback: knows the log and the arm.
    """

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._server, self._playback = server, playback
        self._lock = Lock()
        self._gather = lru_cache(maxsize=_MOST_KEPT)(self._evidence)
        tracks = sorted({t for arms in playback.inputs.scenarios.values()
                         for drive in arms.values() for t in drive.poses})  # fmt: skip
        gui = server.gui
        self._tracks = gui.add_dropdown("Track", tuple(tracks) or ("none",))
        self._show = gui.add_button("Show what was seen of it")
        self._crops: list[viser.GuiImageHandle] = []
        self._folder = gui.add_folder("Best views in the log")
        self._text = gui.add_markdown("Click on a box, or choose a track.")
        self._show.on_click(lambda _: self.show(self._tracks.value))

    def show(self, track: str) -> None:
        """Tell of a track."""
        with self._lock:
            self._text.content = f"looking at track `{track}` ..."
            found = self._gather(track, self._playback.arm)
            self._text.content = f"**Track `{track}`**\n\n" + "\n".join(
                f"- {escaped(line)}" for line in found.lines
            )
            for crop in self._crops:
                crop.remove()
            with self._folder:
                self._crops = [
                    self._server.gui.add_image(picture, label=label, format="jpeg")
                    for label, picture in found.crops
                ]

    def _evidence(self, track: str, arm: str) -> Evidence:
        inputs = self._playback.inputs
        if inputs.log is None:
            return Evidence(("no log was named: give --log",))
        return track_evidence(inputs.log, track, inputs.actors.get(arm, {}).get(track))


def escaped(line: str) -> str:
    """A line that Markdown shows as it is."""
    return "".join(f"\\{one}" if one in "\\`*_{}[]<>#|~$" else one for one in line)
