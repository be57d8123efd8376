"""What the log has seen of a track: in words, and its best crops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.actors import Actor, BoxLidarSegmenter, observe
from recast.errors import InputError
from recast.logs import DrivingLog

Image = NDArray[np.uint8]

VIEWS = 3
"""Most crops of a track."""
_GREY = 128
_FADED = 0.35  # of the crop, beside the vehicle


@dataclass(frozen=True)
class Evidence:
    """What is known of a track.

    Attributes:
        lines: for people.
        crops: (H, W, 3) RGB with what is beside the vehicle faded, the best one first, and what
            each of them is.
    """

    lines: tuple[str, ...]
    crops: tuple[tuple[str, Image], ...] = ()


def track_evidence(log: DrivingLog, track_id: str, actor: Actor | None = None) -> Evidence:
    """Gather what a log has seen of a track, and what an actor in its place was made from.

    Args:
        actor: the vehicle that stands in its place; None for none.
    """
    if track_id not in log.tracks:
        return Evidence((f"track {track_id} is not in the log",))
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
        return Evidence((*lines, f"no view that could be cut out: {error.problem}"))
    lines += found.explain().splitlines()
    crops = tuple(
        (f"{one.view.camera}, frame {one.view.frame}", faded(one.rgba)) for one in found.views
    )
    return Evidence(tuple(lines), crops)


def actor_lines(actor: Actor) -> list[str]:
    """Generator of an actor, and the shares of its Gaussians by where they come from."""
    lines = [f"replaced by a vehicle of {actor.provenance.generator}"]
    if actor.shares is not None:
        seen, mirrored, invented = actor.shares.columns.mean(dim=0).tolist()
        lines.append(
            f"of its Gaussians {seen:.0%} were seen, {mirrored:.0%} mirrored and "
            f"{invented:.0%} invented"
        )
    return lines


def faded(rgba: NDArray[np.uint8]) -> Image:
    """A crop (H, W, 4) as a picture (H, W, 3): what the mask leaves out is nearly grey."""
    alpha = rgba[..., 3:].astype(np.float64) / 255
    share = _FADED + (1 - _FADED) * alpha
    return np.asarray(np.rint(share * rgba[..., :3] + (1 - share) * _GREY), np.uint8)
