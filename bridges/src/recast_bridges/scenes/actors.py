"""Actors of imported scenes: which track of the log each is, and its colours in its own frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import read_json
from recast.geometry import se3
from recast.logs import DrivingLog, Track, Trajectory
from recast.logs.checks import BOX_SIDE
from recast.scene.actor import SceneActor
from recast.scene.street_scene import CLOCK_TOLERANCE_US, stands
from recast.splats import Gaussians
from recast.splats.gaussians import rotate_harmonics
from recast_bridges.scenes.checkpoint import CheckpointTable

TURNING = "harmonics of actors turn with the actor; in the checkpoint they do not"
FAR_M = 2.0
"""A median distance above this is no match: training moves boxes by decimetres."""
SUSPICIOUS_M = 0.5
"""A match this far away is one that training alone hardly explains."""
SAME_M = 1.0
"""A track this near (median over an actor's time) is the actor, if actors may also be no track."""
OVERLAP = 0.5
"""Share of an actor's poses at whose times the track must be there."""


def check_share(share: float) -> None:
    """Refuse a share of time that is not in [0, 1]; InputError names the option."""
    if not 0 <= share <= 1:
        raise InputError("command line", "`share`", f"is {share}", "give a number from 0 to 1")


def read_track_names(path: Path | None) -> dict[str, str]:
    """A JSON object of the log's track ids by the checkpoint's names; none without a file. Raises
    InputError: the file is missing or holds something else."""
    if path is None:
        return {}
    value = read_json(path)
    if not isinstance(value, dict) or not all(isinstance(name, str) for name in value.values()):
        raise InputError(
            path, "JSON", "is not an object of texts", 'write {"obj_003": "track of the log", ...}'
        )
    return value


def check_names(
    table: CheckpointTable,
    found: Sequence[str],
    tracks: Mapping[str, str],
    leave_out: Sequence[str],
) -> None:
    """Refuse names, to be left out or told the track of, that the checkpoint does not have. Raises
    InputError: naming the first one."""
    for name in (*leave_out, *tracks):
        if name not in found:
            raise InputError(
                table.path,
                f"actor {name}",
                "is not in the checkpoint",
                f"choose one of {', '.join(found) or 'none'}",
            )


def track_of(
    table: CheckpointTable, log: DrivingLog, name: str, candidates: Sequence[str]
) -> Track:
    """The log's track for an actor: the first of `candidates` that there is. Raises InputError:
    none of them is in the log."""
    for candidate in candidates:
        if candidate in log.tracks:
            return log.tracks[candidate]
    raise InputError(
        table.path,
        f"actor {name}",
        f"is not a track of log {log.name} (looked for {', '.join(candidates)})",
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
    return replace(gaussians, sh=rotate_harmonics(gaussians.sh, torch.from_numpy(turn).float()))


def choose_tracks(
    models: CheckpointTable,
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
                f"actor {name}: {track_id} is not a track of log {log.name}, or named twice",
                "correct the tracks file",
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
            near = "no track is present at its times"
            if found is not None:
                near = f"{found} is nearest, {distance:.1f} m away"
            raise models.fault(
                "RigidNodes",
                f"actor {name} is not a track of log {log.name}: {near}",
                "give the log it was trained on and its first frame (`first_frame`), name its "
                "track in a file (`tracks`), or `leave_out` it",
            )
        chosen[name] = found
        distances.append(distance)
    return chosen, max(distances)


def find_tracks(
    table: CheckpointTable,
    log: DrivingLog,
    trajectories: Mapping[str, Trajectory],
    given: Mapping[str, str],
    by_name: bool,
) -> tuple[dict[str, str], list[str]]:
    """The log's tracks of actors by name: as the user said, of the same name, or at their place.

    Args:
        trajectories: `world_from_actor` by name.
        given: track ids that the user named.
        by_name: whether an actor and a track of the same name are the same.

    Returns:
        Track ids, of actors that have one; warnings.

    Raises:
        InputError: a track that the user named is not there, or is named twice.
    """
    tracks = {name: given[name] for name in trajectories if name in given}
    for name, named in tracks.items():
        if named not in log.tracks or list(tracks.values()).count(named) > 1:
            problem = f"track {named} is not in log {log.name}, or named twice"
            raise table.fault(name, problem, "correct the tracks file")
    for name in trajectories:
        if by_name and name in log.tracks and name not in (*tracks, *tracks.values()):
            tracks[name] = name
    rest = {name: one for name, one in trajectories.items() if name not in tracks}
    places = tracks_at_places(log, rest, list(tracks.values()))
    distance = max((distance for distance, _ in places.values()), default=0.0)
    far = f"actors lie as far as {distance:.2f} m from their tracks"
    tracks |= {name: track_id for name, (_, track_id) in places.items()}
    return tracks, [far] if distance > SUSPICIOUS_M else []


def as_tracks(
    table: CheckpointTable,
    log: DrivingLog,
    found: Mapping[str, SceneActor],
    tracks: Mapping[str, str],
) -> tuple[dict[str, SceneActor], list[str]]:
    """The actors of a scene by track id with the sizes of the tracks, and what to tell of it.

    Args:
        found: actors by name; one that is no track of the log keeps its name and size.
        tracks: the log's track ids by name.

    Raises:
        InputError: an actor that is no track has the name of a track that belongs to another actor.
    """
    actors: dict[str, SceneActor] = {}
    for name, actor in found.items():
        key = tracks.get(name, name)
        if name not in tracks and name in tracks.values():
            raise table.fault(
                name,
                "has the name of a track that belongs to another actor",
                "leave this actor out",
            )
        size = log.tracks[key].size if name in tracks else actor.size
        actors[key] = replace(actor, track_id=key, size=size)
    unknown = ", ".join(name for name in found if name not in tracks)
    told = (
        f"{unknown}: not tracks of the log, so they keep their names and the sizes of their shapes"
    )
    return actors, [told] if unknown else []


def extent(means: Tensor) -> Array:
    """Length, width, height (3,) in metres of a box around the origin with 99 % of (N, 3)."""
    sides = 2 * np.quantile(means.abs().numpy(), 0.99, axis=0).astype(np.float64)
    return np.clip(sides, max(0.1, BOX_SIDE[0]), BOX_SIDE[1])


def tracks_at_places(
    log: DrivingLog, trajectories: Mapping[str, Trajectory], taken: Sequence[str]
) -> dict[str, tuple[float, str]]:
    """The track within `SAME_M` of each trajectory that has one, and its distance in metres.

    Args:
        trajectories: `world_from_actor` by the actor's name.
        taken: tracks that are not to be given.
    """
    moving = {name: one for name, one in trajectories.items() if not stands(one)}
    near = list(match_tracks(log, moving, taken).items())
    near += [(name, _nearest(log, one)) for name, one in trajectories.items() if stands(one)]
    found: dict[str, tuple[float, str]] = {}
    given = set(taken)
    for name, (distance, track_id) in sorted(near, key=lambda one: one[1][0]):
        if track_id is not None and distance <= SAME_M and track_id not in given:
            found[name] = distance, track_id
            given.add(track_id)
    return found


def _nearest(log: DrivingLog, standing: Trajectory) -> tuple[float, str | None]:
    """Median distance, over a track's time, of the track that is nearest to a place."""
    place = standing.poses[0, :3, 3]
    distances = [
        (float(np.median(np.linalg.norm(one.trajectory.poses[:, :3, 3] - place, axis=1))), key)
        for key, one in log.tracks.items()
    ]
    return min(distances, default=(float("inf"), None))


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
    """Median distance in metres of each track that is there at enough of the times."""
    found = {}
    times, places = trajectory.timestamps_us, trajectory.poses[:, :3, 3]
    for track_id, track in log.tracks.items():
        known = track.trajectory.timestamps_us
        # As `pose_at` has it: the ends hold for as long as sensors may differ.
        there = (times >= known[0] - CLOCK_TOLERANCE_US) & (times <= known[-1] + CLOCK_TOLERANCE_US)
        if there.sum() < max(OVERLAP * len(times), 1):
            continue
        own = [np.interp(times[there], known, one) for one in track.trajectory.poses[:, :3, 3].T]
        found[track_id] = float(np.median(np.linalg.norm(np.stack(own, 1) - places[there], axis=1)))
    return found
