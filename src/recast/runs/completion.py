"""Who beside the target is made complete, and why others stay reconstructed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from recast.actors import DEFAULT_GENERATOR, GENERATORS
from recast.actors.generate import PEOPLE_GENERATOR
from recast.actors.observe import why_not_seen
from recast.actors.people.generator import require_person
from recast.core.errors import InputError
from recast.logs import DrivingLog, Track, all_track_points
from recast.logs.types import PEOPLE, VEHICLES
from recast.reconstruction import SceneConfig
from recast.reconstruction.views import modelled_tracks

ALL, NEAR = "all", "near"
_COST = "about a minute of CPU time"
"""With one camera of 621x188 50 s, a person 15 s; what is in the store costs nothing."""
_UNMADE = ("trailer", "motorcyclist")
"""Categories of traffic that no generator makes."""
_CYCLE = 2.8, 1.1
"""Metres of length and width below which a vehicle's box is that of a motorcycle: Waymo's labels do
not tell it from a car, and the smallest cars are wider."""
_NEAR = 30.0
"""Metres from the recorded ego within which a rollout shows a vehicle's sides."""


def makeable(generators: Iterable[str]) -> tuple[str, ...]:
    """Categories of tracks that all generators of some names make: files, libraries and models hold
    vehicles; what code of users' own makes is not known, so that it may be all."""
    found: tuple[str, ...] = (*VEHICLES, *PEOPLE, *_UNMADE)
    for name in generators:
        known = GENERATORS.is_own(name) or name.startswith(tuple(GENERATORS.prefixes))
        known = known or GENERATORS.place(name) is not None
        if known:
            own = {PEOPLE_GENERATOR: PEOPLE, DEFAULT_GENERATOR: (*VEHICLES, *PEOPLE)}
            found = tuple(one for one in found if one in own.get(name, VEHICLES))
    return found


def require_made(generator: str, track: Track, where: str) -> None:
    """Refuse a track that one of recast's own generators cannot make.

    Args:
        where: what the generator was given for, for the message.

    Raises:
        InputError: it is a person and the generator makes vehicles, or the other way round; a box
            of a group, of a bicycle without a rider or of a motorcycle; or a category that none
            makes: trailers, motorcyclists and "misc".
    """
    if not GENERATORS.is_own(generator):
        return
    category, makes = track.category, makeable([generator])
    never = (*PEOPLE, *_UNMADE, "misc")
    if category not in makes and (category in never or "car" not in makes):
        raise InputError(
            where,
            f"track {track.track_id}",
            f"is {category}: {generator} makes {', '.join(makes)}",
            "give `arm` native, and oracle on a synthetic log; or another `generator`",
            "docs/scenarios.md#people",
        )
    _require_box(track)


def _require_box(track: Track) -> None:
    """Refuse a box that nothing of the track's category has. Raises InputError."""
    if track.category in PEOPLE:
        require_person(track.category, track.size, track.track_id)
    elif track.category in VEHICLES and np.all(track.size[:2] < _CYCLE):
        length, width, height = (float(side) for side in track.size)
        box = f"{length:.2f} x {width:.2f} x {height:.2f} m"
        raise InputError(
            f"track {track.track_id}",
            track.category,
            f"has a box of {box}: a motorcycle?",
            "leave it reconstructed (arm native)",
            "docs/scenarios.md#complete-vehicles",
        )


@dataclass(frozen=True)
class CompletedVehicles:
    """The choice.

    Attributes:
        tracks: ids of the road users beside the target that are made complete.
        left: why others stay as reconstructed, by track id.
    """

    tracks: tuple[str, ...] = ()
    left: tuple[tuple[str, str], ...] = ()

    def explain(self) -> list[str]:
        """Lines for people; none if nothing was asked for."""
        lines = []
        if self.tracks:
            named = ", ".join(self.tracks)
            lines.append(f"complete beside the target: tracks {named}; {_COST} each")
        lines += [f"track {key} stays as reconstructed: {why}" for key, why in self.left]
        return lines


def choose_completed(
    log: DrivingLog,
    target: str,
    words: Sequence[str],
    config: SceneConfig,
    generators: Iterable[str] = (DEFAULT_GENERATOR,),
) -> CompletedVehicles:
    """Choose among cars, vans, trucks and buses, pedestrians and cyclists.

    Args:
        target: id of the target, which is always made complete.
        words: "all", "near" (within 30 m of the recorded ego), or track ids.
        config: settings of the street: which images may be looked at.
        generators: names of those that have to make all of them.

    Raises:
        InputError: a track is not in the log, is of a category that is not made, or is seen too
            little.
    """
    generators = tuple(generators)
    makes = makeable(generators)
    named = [word for word in words if word not in (ALL, NEAR)]
    for key in named:
        if key not in log.tracks:
            mend = f"give {ALL}, {NEAR}, or one of {', '.join(log.tracks)}"
            raise InputError("`complete`", f"track {key}", "is not in the log", mend)
        track = log.tracks[key]
        if track.category not in makes:
            problem = f"is a {track.category}, which {', '.join(generators)} does not make"
            mend = f"name tracks of the categories {', '.join(makes)}"
            raise InputError("`complete`", f"track {key}", problem, mend)
    named = list(dict.fromkeys(named))
    asked = [key for key in _asked(log, words) if key not in (*named, target)]
    wide = [key for key in asked if log.tracks[key].category in makes]
    points = all_track_points(log, {key: log.tracks[key] for key in (*named, *wide)})
    known = all(GENERATORS.is_own(name) for name in generators)
    whys = {key: _why_not(log, key, len(own.points), config, known) for key, own in points.items()}
    for key in named:
        if whys[key] is not None:
            raise InputError("`complete`", f"track {key}", str(whys[key]), "leave it out")
    modelled = modelled_tracks(log, config) if wide else frozenset()
    for key in wide:
        if whys[key] is None and key not in modelled:
            whys[key] = "the street has no model of it: it stands still, and is seen too little"
    for key in asked:
        if (category := log.tracks[key].category) not in makes:
            whys[key] = f"it is a {category}, which {', '.join(generators)} does not make"
    found = [key for key, why in whys.items() if why is None and key != target]
    return CompletedVehicles(
        tuple(found), tuple((key, why) for key, why in whys.items() if why is not None)
    )


def _why_not(
    log: DrivingLog, key: str, points: int, config: SceneConfig, known: bool
) -> str | None:
    try:
        if known:  # users' own code may make what recast's does not
            _require_box(log.tracks[key])
    except InputError as error:
        return error.problem
    return why_not_seen(log, key, points, config)


def _asked(log: DrivingLog, words: Sequence[str]) -> list[str]:
    """Road users that "all" or "near" stand for, in the order of the log."""
    kinds = (*VEHICLES, *PEOPLE, *_UNMADE)
    found = [key for key, track in log.tracks.items() if track.category in kinds]
    if ALL in words:
        return found
    return [key for key in found if NEAR in words and _distance(log, key) <= _NEAR]


def _distance(log: DrivingLog, track: str) -> float:
    """Least metres between a track's labels and the recorded ego; inf if they share no time."""
    path, ego = log.tracks[track].trajectory, log.world_from_rig
    times = path.timestamps_us
    shared = (times >= ego.timestamps_us[0]) & (times <= ego.timestamps_us[-1])
    if not shared.any():
        return np.inf
    apart = path.poses[shared, :2, 3] - ego.at(times[shared])[:, :2, 3]
    return float(np.linalg.norm(apart, axis=1).min())
