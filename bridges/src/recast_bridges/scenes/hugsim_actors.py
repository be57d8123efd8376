"""Actors of a HUGSIM scene: when they are where, and how their own axes lie."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import torch

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import Trajectory
from recast.logs.checks import LATEST_US
from recast.splats import Gaussians
from recast_bridges.scenes.hugsim_files import front_camera, read_recordings, read_unicycle

RECORDINGS_FILE = "meta_data.json"
MOVED_M = 1.0
"""An actor that goes farther than this shows which of its axes points forward."""
UPRIGHT = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
"""Own axes of an actor whose motion does not show them: x right, y forward, z up."""
_ACTOR = re.compile(r"dynamic_([A-Za-z0-9-]{1,64})\.pth")


@dataclass(frozen=True)
class Clock:
    """How the scene's times lie in the log.

    Attributes:
        start_us: time of the log, microseconds, ...
        origin: ... that is this time of the scene.
        unit: seconds of one unit of the scene's times.
    """

    start_us: int
    origin: float
    unit: float

    def __post_init__(self) -> None:
        """Refuse a unit that is no time; InputError names the option."""
        if not 1e-6 <= self.unit <= 1e3:
            raise InputError("command line", "`time_unit`", f"is {self.unit:g}", "give seconds")

    def times_us(self, times: Array) -> Array:
        """Microseconds of the log, whole and as float64, of the scene's times."""
        return self.start_us + np.round((times - self.origin) * self.unit * 1e6)


def actor_names(folder: Path) -> list[str]:
    """Names of the actors that have Gaussians, sorted."""
    found = (_ACTOR.fullmatch(one.name) for one in folder.glob("dynamic_*.pth"))
    return sorted(one[1] for one in found if one is not None)


def origin_of(folder: Path, pose: Array) -> float:
    """The scene's time of the image that was taken at a camera pose (4, 4); 0 without
    meta_data.json.

    Raises:
        InputError: see `read_recordings`.
    """
    if not (folder / RECORDINGS_FILE).exists():
        return 0.0
    recordings = read_recordings(folder / RECORDINGS_FILE)
    name, index = front_camera(recordings, pose)
    return float(recordings[name].times[index])


def read_motion(
    folder: Path, name: str, clock: Clock, world_from_scene: Array
) -> Trajectory | None:
    """`world_from_own` of an actor; None without its file.

    Raises:
        InputError: the file is broken, or its times are none of a log.
    """
    file = folder / f"unicycle_{name}.pth"
    if not file.exists():
        return None
    times, poses = read_unicycle(file)
    times_us = clock.times_us(times)
    if not np.all((times_us >= 0) & (times_us < LATEST_US)) or np.any(np.diff(times_us) <= 0):
        problem = "are not times of the log that increase"
        raise InputError(file, "train_timestamp", problem, "check the unit (`time_unit`)")
    return Trajectory(times_us.astype(np.int64), world_from_scene @ poses)


def own_axes(motion: Trajectory, track: Trajectory | None) -> Array | None:
    """The rotation (3, 3) from an actor's own axes to forward, left and up.

    The layout does not say how an actor's own axes lie. They are along its box, so one of 24
    rotations is nearest to what its track shows, or its way if it moves.

    Returns:
        None if there is no track and the actor hardly moves.
    """
    turns = motion.poses[:, :3, :3]
    if track is not None:
        inside = (motion.timestamps_us >= track.timestamps_us[0]) & (
            motion.timestamps_us <= track.timestamps_us[-1]
        )
        if not inside.any():
            return None
        true = track.at(motion.timestamps_us[inside])[:, :3, :3]
        turns = turns[inside]
    else:
        way = np.diff(motion.poses[:, :2, 3], axis=0)
        lengths = np.linalg.norm(way, axis=1)
        if lengths.sum() < MOVED_M:
            return None
        # The longer a step, the surer is its direction.
        true = se3.rotation_z(np.arctan2(way[:, 1], way[:, 0])) * lengths[:, None, None]
        turns = turns[:-1]
    mean = (true.swapaxes(1, 2) @ turns).sum(axis=0)
    return max(_axis_rotations(), key=lambda rotation: float((rotation * mean).sum()))


def _axis_rotations() -> list[Array]:
    """The 24 rotations that carry axes to axes."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        rotation = np.zeros((3, 3))
        rotation[range(3), order] = signs
        if np.linalg.det(rotation) > 0:
            found.append(rotation)
    return found


def turned(
    motion: Trajectory, gaussians: Gaussians, axes: Array | None
) -> tuple[Trajectory, Gaussians]:
    """Poses and Gaussians of an actor with axes forward, left, up; harmonics stay in scene axes.

    Args:
        axes: see `own_axes`; `UPRIGHT` if None.
    """
    turn = se3.from_rotation_translation(UPRIGHT if axes is None else axes, np.zeros(3))
    poses = motion.poses @ se3.inverse(turn)
    moved = gaussians.transformed(torch.from_numpy(turn))
    return Trajectory(motion.timestamps_us, poses), replace(moved, sh=gaussians.sh)
