"""Actors of imported scenes: which track of the log each is, and its colours in its own frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog, Track, Trajectory
from recast.scene.importers.placing import Array
from recast.scene.importers.table import Table
from recast.splats import Gaussians
from recast.splats.sh import rotate
from recast.storage import read_json

TURNING = "harmonics of actors turn with the actor; in the checkpoint they do not"


def check_share(share: float) -> None:
    """Refuse a share of time that is not in [0, 1].

    Raises:
        InputError: naming the option.
    """
    if not 0 <= share <= 1:
        raise InputError("command line", "--share", f"is {share}", "give a number from 0 to 1")


def read_track_names(path: Path | None) -> dict[str, str]:
    """A JSON object of the log's track ids by the checkpoint's names; none without a file.

    Raises:
        InputError: the file is missing or holds something else.
    """
    if path is None:
        return {}
    value = read_json(path)
    if not isinstance(value, dict) or not all(isinstance(name, str) for name in value.values()):
        raise InputError(
            path, "JSON", "is no object of texts", 'write {"obj_003": "track of the log", ...}'
        )
    return value


def check_names(
    table: Table, found: Sequence[str], tracks: Mapping[str, str], leave_out: Sequence[str]
) -> None:
    """Refuse names, to be left out or told the track of, that the checkpoint does not have.

    Raises:
        InputError: naming the first one.
    """
    for name in (*leave_out, *tracks):
        if name not in found:
            raise InputError(
                table.path, f"actor {name}", "is not in the checkpoint",
                f"choose of {', '.join(found) or 'none'}",
            )  # fmt: skip


def track_of(table: Table, log: DrivingLog, name: str, candidates: Sequence[str]) -> Track:
    """The log's track for an actor: the first of `candidates` that there is.

    Raises:
        InputError: none of them is in the log.
    """
    for candidate in candidates:
        if candidate in log.tracks:
            return log.tracks[candidate]
    raise InputError(
        table.path, f"actor {name}",
        f"is no track of log {log.name} (looked for {', '.join(candidates)})",
        "give the log it was trained on, name its track in a file (--tracks), or --leave-out it",
    )  # fmt: skip


def time_at(trajectory: Trajectory, share: float) -> int:
    """The time at a share in [0, 1] of a trajectory."""
    first, last = (int(time) for time in trajectory.timestamps_us[[0, -1]])
    return first + round(share * (last - first))


def colours_in_own_frame(
    gaussians: Gaussians, trajectory: Trajectory, world_from_scene: Array, share: float
) -> Gaussians:
    """Turn harmonics of view directions in scene axes into the actor's frame.

    Both published trainers evaluate an actor's harmonics in the axes of the scene; ours turn with
    the actor. They agree while it stands as it does at `share` of its trajectory.
    """
    world_from_actor = trajectory.at(time_at(trajectory, share))
    turn = se3.inverse(world_from_actor)[:3, :3] @ world_from_scene[:3, :3]
    return replace(gaussians, sh=rotate(gaussians.sh, torch.from_numpy(turn).float()))
