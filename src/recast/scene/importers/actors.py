"""Actors of imported scenes: which track of the log each is, and its colours in its own frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import read_json
from recast.geometry import se3
from recast.logs import DrivingLog, Track, Trajectory
from recast.scene.dynamic import pose_at
from recast.scene.importers.checkpoint import Table
from recast.splats import Gaussians
from recast.splats.sh import rotate

TURNING = "harmonics of actors turn with the actor; in the checkpoint they do not"
FAR_M = 2.0
"""A median distance above this is no match: training moves boxes by decimetres."""
SUSPICIOUS_M = 0.5
"""A match this far away is one that training alone hardly explains."""
OVERLAP = 0.5
"""Share of an actor's poses at whose times the track must be there."""


def check_share(share: float) -> None:
    """Refuse a share of time that is not in [0, 1]; InputError names the option."""
    if not 0 <= share <= 1:
        raise InputError("command line", "`share`", f"is {share}", "give a number from 0 to 1")


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
                table.path,
                f"actor {name}",
                "is not in the checkpoint",
                f"choose of {', '.join(found) or 'none'}",
            )


def track_of(table: Table, log: DrivingLog, name: str, candidates: Sequence[str]) -> Track:
    """The log's track for an actor: the first of `candidates` that there is.

    Raises:
        InputError: none of them is in the log.
    """
    for candidate in candidates:
        if candidate in log.tracks:
            return log.tracks[candidate]
    raise InputError(
        table.path,
        f"actor {name}",
        f"is no track of log {log.name} (looked for {', '.join(candidates)})",
        "give the log it was trained on, name its track in a file (`tracks`), or `leave_out` it",
    )


def colours_in_own_frame(
    gaussians: Gaussians, trajectory: Trajectory, world_from_scene: Array, share: float
) -> Gaussians:
    """Turn harmonics of view directions in scene axes into the actor's frame.

    Both published trainers evaluate an actor's harmonics in the axes of the scene; ours turn with
    the actor. They agree while it stands as it does at `share` of its trajectory.
    """
    first, last = (int(time) for time in trajectory.timestamps_us[[0, -1]])
    world_from_actor = trajectory.at(first + round(share * (last - first)))
    turn = se3.inverse(world_from_actor)[:3, :3] @ world_from_scene[:3, :3]
    return replace(gaussians, sh=rotate(gaussians.sh, torch.from_numpy(turn).float()))


def choose_tracks(
    models: Table,
    log: DrivingLog,
    trajectories: Mapping[str, Trajectory],
    given: Mapping[str, str],
) -> tuple[dict[str, str], float]:
    """The log's track ids of rigid actors, and the largest of their median distances in metres.

    Args:
        trajectories: `world_from_actor` by actor.
        given: track ids that the user named.

    Raises:
        InputError: an actor is no track of the log, or two are said to be the same.
    """
    named = {name: given[name] for name in trajectories if name in given}
    for name, track_id in named.items():
        if track_id not in log.tracks or list(named.values()).count(track_id) > 1:
            raise models.fault(
                "RigidNodes",
                f"actor {name}: {track_id} is no track of log {log.name}, or named twice",
                "mend the file of tracks",
            )
    rest = {name: own for name, own in trajectories.items() if name not in named}
    matches = match_tracks(log, rest, list(named.values()))
    chosen, distances = {}, [0.0]
    for name in trajectories:
        if name in named:
            chosen[name] = named[name]
            continue
        distance, found = matches[name]
        if found is None or distance > FAR_M:
            near = "none is there at its times"
            if found is not None:
                near = f"{found} is nearest, {distance:.1f} m away"
            raise models.fault(
                "RigidNodes",
                f"actor {name} is no track of log {log.name}: {near}",
                "give the log it was trained on and its first frame (`first_frame`), name its "
                "track in a file (`tracks`), or `leave_out` it",
            )
        chosen[name] = found
        distances.append(distance)
    return chosen, max(distances)


def match_tracks(
    log: DrivingLog, trajectories: Mapping[str, Trajectory], taken: Sequence[str] = ()
) -> dict[str, tuple[float, str | None]]:
    """The nearest track of each trajectory and the median distance of their centres, metres.

    No track within `FAR_M` is given twice, the closest pairs come first; None where no track is
    there at the trajectory's times.

    Args:
        trajectories: `world_from_actor` by the actor's name.
        taken: tracks that are not to be given.
    """
    distances = sorted(
        (distance, name, track_id)
        for name, trajectory in trajectories.items()
        for track_id, distance in _distances(log, trajectory).items()
        if track_id not in taken
    )
    matches: dict[str, tuple[float, str | None]] = {}
    given = set(taken)
    for distance, name, track_id in distances:
        if distance <= FAR_M and name not in matches and track_id not in given:
            matches[name] = distance, track_id
            given.add(track_id)
    for name in trajectories:
        if name not in matches:
            own = [(d, track_id) for d, other, track_id in distances if other == name]
            matches[name] = min(own, default=(float("inf"), None))
    return matches


def _distances(log: DrivingLog, trajectory: Trajectory) -> dict[str, float]:
    found = {}
    for track_id, track in log.tracks.items():
        first, last = track.trajectory.timestamps_us[[0, -1]]
        times = trajectory.timestamps_us
        if last < times[0] or times[-1] < first:
            continue
        gaps = [
            float(np.linalg.norm(there[:3, 3] - pose[:3, 3]))
            for time, pose in zip(times, trajectory.poses, strict=True)
            if (there := pose_at(track.trajectory, int(time))) is not None
        ]
        if len(gaps) >= OVERLAP * len(times):
            found[track_id] = float(np.median(gaps))
    return found
