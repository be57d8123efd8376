"""What the log has seen of a track, in words and crops, and the part of the page that tells it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from recast.actors import Actor, BoxLidarSegmenter, observe
from recast.arrays import Image
from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.viewer.playback import Playback

if TYPE_CHECKING:
    import viser


VIEWS = 3
"""Most crops of a track."""
_GREY = 128
_FADED = 0.35  # of the crop, beside the vehicle
_MOST_KEPT = 64


@dataclass(frozen=True)
class TrackEvidence:
    """What is known of a track.

    Attributes:
        lines: text for people.
        crops: (H, W, 3) RGB with what is beside the vehicle faded, the best one first, and what
            each of them is.
    """

    lines: tuple[str, ...]
    crops: tuple[tuple[str, Image], ...] = ()


def track_evidence(log: DrivingLog, track_id: str, actor: Actor | None = None) -> TrackEvidence:
    """Gather what a log has seen of a track, and what an actor in its place was made from.

    Args:
        actor: the vehicle that stands in its place; None for none.
    """
    if track_id not in log.tracks:
        return TrackEvidence((f"track {track_id} is not in the log",))
    track = log.tracks[track_id]
    times = track.trajectory.timestamps_us
    length, width, height = track.size.tolist()
    lines = [
        f"{track.category}, {length:.1f} x {width:.1f} x {height:.1f} m, "
        f"labelled for {(times[-1] - times[0]) / 1e6:.1f} s",
    ]
    if actor is not None:
        lines += actor_lines(actor)
    try:
        found = observe(log, track_id, segmenter=BoxLidarSegmenter(), views=VIEWS)
    except InputError as error:
        return TrackEvidence((*lines, f"no view could be cut out: {error.problem}"))
    lines += found.explain().splitlines()
    crops = tuple(
        (f"{one.view.camera}, frame {one.view.frame}", faded(one.rgba)) for one in found.views
    )
    return TrackEvidence(tuple(lines), crops)


def actor_lines(actor: Actor) -> list[str]:
    """Generator of an actor, and the shares of its Gaussians by where they come from."""
    lines = [f"replaced by a vehicle made by {actor.provenance.generator}"]
    if actor.shares is not None:
        seen, mirrored, invented = actor.shares.columns.mean(dim=0).tolist()
        lines.append(
            f"Gaussians of the vehicle: {seen:.0%} seen, {mirrored:.0%} mirrored, "
            f"{invented:.0%} invented"
        )
    return lines


def faded(rgba: NDArray[np.uint8]) -> Image:
    """A crop (H, W, 4) as a picture (H, W, 3): what the mask leaves out is nearly grey."""
    alpha = rgba[..., 3:].astype(np.float64) / 255
    share = _FADED + (1 - _FADED) * alpha
    return np.asarray(np.rint(share * rgba[..., :3] + (1 - share) * _GREY), np.uint8)


class TrackPanel:
    """Evidence and crops of the track that was clicked at.

    Args:
        server: server that gets the elements, within the container that is open.
        playback: playback that knows the log and the arm.
    """

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._server, self._playback = server, playback
        self._lock = Lock()
        self._gather = lru_cache(maxsize=_MOST_KEPT)(self._evidence)
        tracks = sorted({track for drive in playback.inputs.drives for track in drive.poses})
        gui = server.gui
        self._tracks = gui.add_dropdown("Track", tuple(tracks) or ("none",))
        self._show = gui.add_button("Show this track in the log")
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

    def _evidence(self, track: str, arm: str) -> TrackEvidence:
        inputs = self._playback.inputs
        if inputs.log is None:
            return TrackEvidence(("no log was given: use --log",))
        return track_evidence(inputs.log, track, inputs.actors.get(arm, {}).get(track))


def escaped(line: str) -> str:
    """A line that Markdown shows as it is."""
    return "".join(f"\\{one}" if one in "\\`*_{}[]<>#|~$" else one for one in line)
