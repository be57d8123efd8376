"""The paper's experiments as files: its seven arms, its sizes, and its nine Waymo segments.

The word "paper" names the files of arms and of the configuration; see docs/reproduce.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.metrics.scene_level.frames import FrameRule, logged_frames
from recast.reconstruction import SceneConfig
from recast.reconstruction.views import modelled_tracks
from recast.simulation import camera_mounts

PAPER = "paper"
"""The word for the paper's file, where a file of arms or a configuration is asked for."""
AUTO_TRACK = "auto"
"""The word for the target that `choose_target` chooses."""
SEGMENTS: Mapping[str, str] = {
    "002": "segment-1005081002024129653_5313_150_5333_150",
    "011": "segment-10153695247769592104_787_000_807_000",
    "034": "segment-10625026498155904401_200_000_220_000",
    "046": "segment-10923963890428322967_1445_000_1465_000",
    "137": "segment-1306458236359471795_2524_330_2544_330",
    "152": "segment-13310437789759009684_2645_000_2665_000",
    "161": "segment-1352150727715827110_3710_250_3730_250",
    "162": "segment-1357883579772440606_2365_000_2385_000",
    "177": "segment-13940755514149579648_821_157_841_157",
}
"""Waymo Open Dataset segments by the paper's numbers, read as numbers of the training list that
Street Gaussians, EmerNeRF and DriveStudio share (the paper does not say which list it means)."""


def paper_arms() -> Path:
    """The file of the seven arms."""
    return Path(__file__).parent / "arms.yaml"


def paper_config() -> Path:
    """The configuration: three forward cameras of 960x640, 30,000 steps, GTRS-Dense, K = 5."""
    return Path(__file__).parent / "config.json"


def choose_target(log: DrivingLog) -> str:
    """The target where the paper names none: the vehicle with the most logged images that count.

    Images count as in the scene-level evaluation (`FrameRule`); among equals, the first by id.

    Raises:
        InputError: no vehicle has such an image.
    """
    cameras = [(name, mount.camera) for name, mount in camera_mounts(log).items()]
    counts = {
        track: sum(1 for _ in logged_frames(log, track, cameras, FrameRule()))
        for track in sorted(modelled_tracks(log, SceneConfig()))
    }
    best = max(counts, key=lambda track: counts[track], default=None)
    if best is None or counts[best] == 0:
        raise InputError(
            log.name,
            "track auto",
            "no vehicle is seen well enough",
            "name a track of `recast log info`",
        )
    return best
