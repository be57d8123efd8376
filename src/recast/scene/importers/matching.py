"""Which track of a log an actor with known poses is, told by where it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from recast.logs import DrivingLog, Trajectory
from recast.scene.dynamic import pose_at
from recast.scene.importers.table import Table

FAR_M = 2.0
"""A median distance above this is no match: training moves boxes by decimetres."""
SUSPICIOUS_M = 0.5
"""A match this far away is one that training alone hardly explains."""
OVERLAP = 0.5
"""Share of an actor's poses at whose times the track must be there."""


@dataclass(frozen=True)
class Match:
    """The nearest track of an actor.

    Attributes:
        track_id: in the log; None where none is there at the actor's times.
        distance: median distance in metres between their centres.
    """

    track_id: str | None
    distance: float


def choose_tracks(
    models: Table,
    log: DrivingLog,
    trajectories: Mapping[str, Trajectory],
    given: Mapping[str, str],
) -> tuple[dict[str, str], float]:
    """The log's track ids of rigid actors, and the largest of their median distances in metres.

    Args:
        trajectories: by actor.
        given: track ids that the user named.

    Raises:
        InputError: an actor is no track of the log, or two are said to be the same.
    """
    named = {name: given[name] for name in trajectories if name in given}
    for name, track_id in named.items():
        if track_id not in log.tracks or list(named.values()).count(track_id) > 1:
            raise models.fault(
                "RigidNodes", f"actor {name}: {track_id} is no track of log {log.name}, or named "
                "twice", "mend the file of tracks",
            )  # fmt: skip
    rest = {name: own for name, own in trajectories.items() if name not in named}
    matches = match_tracks(log, rest, list(named.values()))
    chosen, distances = {}, [0.0]
    for name in trajectories:
        if name in named:
            chosen[name] = named[name]
            continue
        match = matches[name]
        if match.track_id is None or match.distance > FAR_M:
            near = "none is there at its times"
            if match.track_id is not None:
                near = f"{match.track_id} is nearest, {match.distance:.1f} m away"
            raise models.fault(
                "RigidNodes", f"actor {name} is no track of log {log.name}: {near}",
                "give the log it was trained on and its first frame (--first-frame), name its "
                "track in a file (--tracks), or --leave-out it",
            )  # fmt: skip
        chosen[name] = match.track_id
        distances.append(match.distance)
    return chosen, max(distances)


def match_tracks(
    log: DrivingLog, trajectories: Mapping[str, Trajectory], taken: Sequence[str] = ()
) -> dict[str, Match]:
    """The track for each trajectory; no track is given twice, the closest pairs come first.

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
    matches: dict[str, Match] = {}
    given = set(taken)
    for distance, name, track_id in distances:
        if distance <= FAR_M and name not in matches and track_id not in given:
            matches[name] = Match(track_id, distance)
            given.add(track_id)
    for name in trajectories:
        if name not in matches:
            own = [(d, track_id) for d, other, track_id in distances if other == name]
            nearest = min(own, default=(float("inf"), None))
            matches[name] = Match(nearest[1], nearest[0])
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
