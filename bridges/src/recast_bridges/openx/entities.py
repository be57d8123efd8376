"""Who moves where and when in a scenario or a rollout, as OpenSCENARIO sees it.

An entity's pose is that of its reference point: of vehicles the middle of the rear axle on the
ground, of others the middle of the box on the ground. Logs do not tell an actor's axles: the rear
one is taken to lie 0.3 of the length behind the middle, which moves no box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.simulation.actor_motion import BaseScript
from recast.simulation.history import prepare
from recast.simulation.rollout import Rollout
from recast.simulation.scenario_file import scenario_name
from recast.simulation.setup import RolloutSetup

EGO_HEIGHT = 1.777
"""Metres, nuPlan's Chrysler Pacifica; rollouts know length and width alone."""
PEDESTRIAN, CYCLIST = "pedestrian", "cyclist"
_AXLE_SHARE = 0.3


@dataclass(frozen=True)
class Entity:
    """A road user.

    Attributes:
        track_id: id of the track in the log; None for the ego.
        category: category as in `Track.category`; "car" for the ego.
        size: (3,) length, width, height, metres.
        centre: (3,) box centre from the reference point, in its axes, metres.
        times: (T,) seconds from the start; an entity with one time has a start and no path.
        poses: (T, 4, 4) `world_from_reference`.
        speed: speed at the first pose, m/s.
    """

    track_id: str | None
    category: str
    size: Array
    centre: Array
    times: Array
    poses: Array
    speed: float

    @property
    def boxes(self) -> Array:
        """(T, 4, 4) `world_from_box`, the box centres."""
        return self.poses @ se3.from_rotation_translation(np.eye(3), self.centre)


@dataclass(frozen=True)
class Played:
    """A scenario or a rollout as paths.

    Attributes:
        name: name, for people.
        description: description, for people.
        duration: length in seconds.
        entities: the road users, the ego first.
    """

    name: str
    description: str
    duration: float
    entities: tuple[Entity, ...]


def played_scenario(setup: RolloutSetup) -> Played:
    """A scenario on a log: the actors' scripts, and the start of the ego, whom a planner drives.

    Raises:
        InputError: it is refused on this log (`prepare`), or an actor reacts and so has no path.
    """
    prepared = prepare(setup)
    for track_id, motion in setup.controlled.items():
        if not isinstance(motion, BaseScript):
            problem = (
                f"{motion.name} of track {track_id} reacts: its path is unknown before it runs"
            )
            raise InputError(setup.log.name, "motion", problem, "export a rollout of this scenario")
    steps = len(prepared.actor) - 1
    times: Array = np.arange(steps + 1) * np.float64(setup.dt)
    vehicle = setup.vehicle
    size = np.array([vehicle.length, vehicle.width, EGO_HEIGHT])
    ego_pose = prepared.surface.ego_poses(prepared.ego[None, :3])
    ego = _ego(size, vehicle.centre_offset, times[:1], ego_pose, float(prepared.ego[3]))
    scripts = {setup.track_id: (prepared.actor, prepared.world_from_actor)}
    scripts |= {one.track_id: (one.states, one.world_from_actor) for one in prepared.further}
    actors = [
        _actor(setup.track_of(key).category, key, setup.track_of(key).size, times, boxes, states)
        for key, (states, boxes) in scripts.items()
    ]
    others = [] if not setup.keep_other_actors else list(setup.log.tracks)
    logged = [
        _logged(setup.log, key, prepared.start_timestamp_us, times)
        for key in others
        if key not in scripts
    ]
    name = f"{scenario_name(setup.motion)} of track {setup.track_id} in {setup.log.name}"
    return Played(name, setup.description, float(times[-1]), _present(ego, *actors, *logged))


def played_rollout(rollout: Rollout, log: DrivingLog) -> Played:
    """A rollout as it was driven, the ego by its planner.

    Args:
        log: log of the rollout, for the categories and for the logged motion of other actors.

    Raises:
        InputError: the log lacks a track of the rollout.
    """
    ids = [rollout.track_id, *rollout.other_actors]
    for track_id in ids:
        if track_id not in log.tracks:
            mend = "give the log that the rollout was run on"
            raise InputError(log.name, f"track {track_id}", "is not in the log", mend)
    times: Array = np.arange(rollout.steps_run + 1) * np.float64(rollout.dt)
    size = np.array([*rollout.ego_size, EGO_HEIGHT])
    ego = _ego(
        size, rollout.ego_centre_offset, times, rollout.world_from_rig, float(rollout.ego[0, 3])
    )
    category = log.tracks[rollout.track_id].category
    actors = [
        _actor(
            category,
            rollout.track_id,
            rollout.actor_size,
            times,
            rollout.world_from_actor,
            rollout.actor,
        )
    ]
    actors += [
        _actor(one.category, one.track_id, one.size, times, one.world_from_actor, one.states)
        for one in rollout.controlled
    ]
    logged = [_logged(log, key, rollout.start_timestamp_us, times) for key in rollout.other_actors]
    text = f"{rollout.arm}, driven by {rollout.planner}"
    if rollout.cut_reason is not None:
        text += f"; ended early: {rollout.cut_reason}"
    return Played(rollout.name, text, float(times[-1]), _present(ego, *actors, *logged))


def _ego(size: Array, offset: float, times: Array, poses: Array, speed: float) -> Entity:
    centre = np.array([offset, 0.0, size[2] / 2])
    return Entity(None, "car", size, centre, times, poses, max(speed, 0.0))


def _actor(
    category: str, track_id: str, size: Array, times: Array, boxes: Array, states: Array
) -> Entity:
    ahead = 0.0 if category == PEDESTRIAN else _AXLE_SHARE * size[0]
    centre = np.array([ahead, 0.0, size[2] / 2])
    poses = boxes @ se3.from_rotation_translation(np.eye(3), -centre)
    return Entity(track_id, category, size, centre, times, poses, float(states[0, 3]))


def _logged(log: DrivingLog, name: str, start_us: int, times: Array) -> Entity | None:
    """A track on its logged motion at those of the times at which it is labelled; None if never."""
    track = log.tracks[name]
    stamps = start_us + np.rint(times * 1e6).astype(np.int64)
    first, last = track.trajectory.timestamps_us[[0, -1]]
    there = (stamps >= first) & (stamps <= last)
    if not there.any():
        return None
    boxes = track.trajectory.at(stamps[there])
    steps = np.linalg.norm(np.diff(boxes[:2, :3, 3], axis=0), axis=1)
    apart = np.diff(times[there][:2])
    states = np.zeros((1, 4))
    states[0, 3] = steps[0] / apart[0] if len(steps) else 0.0
    return _actor(track.category, name, track.size, times[there], boxes, states)


def _present(*entities: Entity | None) -> tuple[Entity, ...]:
    return tuple(one for one in entities if one is not None)
