"""Who moves where and when in a scenario or a rollout, as OpenSCENARIO sees it.

An entity's pose is that of its reference point: of vehicles the middle of the rear axle on the
ground, of others the middle of the box on the ground. Logs do not tell an actor's axles: the rear
one is taken to lie 0.3 of the length behind the middle, which moves no box.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import read_text, write_bytes
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.logs.checks import BOX_SIDE, WORLD_REACH
from recast.simulation.actor_motion import BaseScript
from recast.simulation.history import prepare
from recast.simulation.rollout import Rollout
from recast.simulation.scenario import scenario_name
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
    if setup.traffic == "idm":
        problem = "gives way: its paths are unknown before it runs"
        mend = "export a rollout of this scenario, or replay the traffic"
        raise InputError(setup.log.name, "traffic", problem, mend)
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
    name = f"{scenario_name(setup.motion)} of track {setup.track_id} in {setup.log.name}"
    return Played(name, setup.description, float(times[-1]), (ego, *actors))


def played_rollout(rollout: Rollout, log: DrivingLog) -> Played:
    """A rollout as it was driven, the ego by its planner.

    Args:
        log: log of the rollout, for the target's category.

    Raises:
        InputError: the log lacks the target.
    """
    if rollout.track_id not in log.tracks:
        mend = "give the log that the rollout was run on"
        raise InputError(log.name, f"track {rollout.track_id}", "is not in the log", mend)
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
    text = f"{rollout.arm}, driven by {rollout.planner}"
    if rollout.cut_reason is not None:
        text += f"; ended early: {rollout.cut_reason}"
    return Played(rollout.name, text, float(times[-1]), (ego, *actors))


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


# OpenSCENARIO XML 1.2 (ASAM): entities with boxes, starts, and paths with a time at each vertex.
#
# Numbers are written in full, so that what is read back is the same but for the rounding of angles.
# Entities that appear late or leave early are deleted and added by events. Names become letters,
# digits and %XX, so that no name of a log can end an attribute, hold what XML forbids, or name a
# parameter ($); the track id itself is told as a property where XML can hold it.

EGO, TRACK = "ego", "track-"
"""Name of the ego, and what the names of tracks begin with."""
_DATE = "2000-01-01T00:00:00"  # the same scenario gives the same bytes
_KINDS = {"car": "car", "van": "van", "truck": "truck", "bus": "bus", "tram": "tram"}
_KINDS |= {CYCLIST: "bicycle", "motorcyclist": "motorbike", "trailer": "trailer", "misc": "car"}


def write_openscenario(path: str | Path, played: Played, road: str | None = None) -> None:
    """Write a scenario, whole or not at all.

    Args:
        road: name of an OpenDRIVE file beside it; None for no road network.

    Raises:
        InputError: the disk refuses.
    """
    root = ET.Element("OpenSCENARIO")
    text = _plain(f"{played.name}. {played.description}".strip())
    _add(root, "FileHeader", revMajor=1, revMinor=2, date=_DATE, description=text, author="recast")
    _add(root, "ParameterDeclarations")
    _add(root, "CatalogLocations")
    network = _add(root, "RoadNetwork")
    if road is not None:
        _add(network, "LogicFile", filepath=road)
    entities = _add(root, "Entities")
    storyboard = _add(root, "Storyboard")
    actions = _add(_add(storyboard, "Init"), "Actions")
    for one in played.entities:
        _object(entities, one)
    for one in played.entities:
        if one.times[0] > 0:  # it comes later
            _entity_action(_add(actions, "GlobalAction"), one, None)
    for one in played.entities:
        if one.times[0] == 0:
            _start(actions, one)
    act = _add(_add(storyboard, "Story", name="story"), "Act", name="act")
    for one in played.entities:
        _maneuvers(act, one, played.duration)
    _trigger(act, "StartTrigger", 0.0)
    _trigger(storyboard, "StopTrigger", played.duration)
    ET.indent(root)
    data = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    write_bytes(path, data + b"\n")


def _add(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    return ET.SubElement(parent, tag, {name: str(value) for name, value in attributes.items()})


def _plain(text: str) -> str:
    """Text without what XML cannot hold, and without the $ that would name a parameter."""
    return "".join(c if c.isprintable() and c != "$" else "?" for c in text)


def entity_name(one: Entity) -> str:
    """The name that a file calls it by; no track is called as the ego is."""
    return EGO if one.track_id is None else f"{TRACK}{quote(one.track_id, safe='')}"


def _object(entities: ET.Element, one: Entity) -> None:
    length, width, height = (float(side) for side in one.size)
    scenario_object = _add(entities, "ScenarioObject", name=entity_name(one))
    if one.category == PEDESTRIAN:
        what = {"pedestrianCategory": PEDESTRIAN, "mass": 80, "model3d": ""}
        body = _add(scenario_object, "Pedestrian", name=quote(one.category, safe=""), **what)
    else:
        what = {"vehicleCategory": _KINDS.get(one.category, "car")}
        body = _add(scenario_object, "Vehicle", name=quote(one.category, safe=""), **what)
    box = _add(body, "BoundingBox")
    _add(box, "Center", **dict(zip("xyz", (float(c) for c in one.centre), strict=True)))
    _add(box, "Dimensions", width=width, length=length, height=height)
    if one.category != PEDESTRIAN:
        _add(body, "Performance", maxSpeed=100, maxAcceleration=20, maxDeceleration=20)
        axles = _add(body, "Axles")
        wheel = {"wheelDiameter": 0.6, "trackWidth": width, "positionZ": 0.3}
        front = 2 * float(one.centre[0])
        _add(axles, "FrontAxle", maxSteering=0.6, positionX=front, **wheel)
        _add(axles, "RearAxle", maxSteering=0, positionX=0, **wheel)
    properties = _add(body, "Properties")
    _add(properties, "Property", name="category", value=_plain(one.category))
    _add(properties, "Property", name="track_id", value=_plain(one.track_id or ""))


def _position(parent: ET.Element, pose: Array) -> None:
    """`world_from_reference` (4, 4) as a WorldPosition: heading, then pitch, then roll."""
    turn = pose[:3, :3]
    angles = {
        "h": np.arctan2(turn[1, 0], turn[0, 0]),
        "p": np.arctan2(-turn[2, 0], np.hypot(turn[0, 0], turn[1, 0])),
        "r": np.arctan2(turn[2, 1], turn[2, 2]),
    }
    place = dict(zip("xyz", pose[:3, 3], strict=True))
    numbers = {name: float(value) for name, value in (place | angles).items()}
    _add(_add(parent, "Position"), "WorldPosition", **numbers)


def _entity_action(parent: ET.Element, one: Entity, pose: Array | None) -> None:
    """Add an entity at a pose, or delete it if there is none."""
    action = _add(parent, "EntityAction", entityRef=entity_name(one))
    if pose is None:
        _add(action, "DeleteEntityAction")
    else:
        _position(_add(action, "AddEntityAction"), pose)


def _start(actions: ET.Element, one: Entity) -> None:
    private = _add(actions, "Private", entityRef=entity_name(one))
    _position(_add(_add(private, "PrivateAction"), "TeleportAction"), one.poses[0])
    speed = _add(_add(_add(private, "PrivateAction"), "LongitudinalAction"), "SpeedAction")
    how = {"dynamicsShape": "step", "dynamicsDimension": "time", "value": 0}
    _add(speed, "SpeedActionDynamics", **how)
    _add(_add(speed, "SpeedActionTarget"), "AbsoluteTargetSpeed", value=one.speed)


def _maneuvers(act: ET.Element, one: Entity, duration: float) -> None:
    """What one entity does after the start; nothing for an ego that somebody else drives."""
    name, first, last = entity_name(one), float(one.times[0]), float(one.times[-1])
    if one.track_id is None and len(one.times) == 1:
        return
    group = _add(act, "ManeuverGroup", name=f"{name}-group", maximumExecutionCount=1)
    actors = _add(group, "Actors", selectTriggeringEntities="false")
    _add(actors, "EntityRef", entityRef=name)
    maneuver = _add(group, "Maneuver", name=f"{name}-maneuver")
    if first > 0:
        event = _event(maneuver, f"{name}-appears")
        _entity_action(_add(_add(event, "Action", name="add"), "GlobalAction"), one, one.poses[0])
        _trigger(event, "StartTrigger", first)
    if len(one.times) > 1:
        event = _event(maneuver, f"{name}-path")
        action = _add(_add(event, "Action", name="follow"), "PrivateAction")
        follow = _add(_add(action, "RoutingAction"), "FollowTrajectoryAction")
        trajectory = _add(_add(follow, "TrajectoryRef"), "Trajectory", name=name, closed="false")
        line = _add(_add(trajectory, "Shape"), "Polyline")
        for time, pose in zip(one.times, one.poses, strict=True):
            _position(_add(line, "Vertex", time=float(time)), pose)
        timing = {"domainAbsoluteRelative": "absolute", "scale": 1, "offset": 0}
        _add(_add(follow, "TimeReference"), "Timing", **timing)
        _add(follow, "TrajectoryFollowingMode", followingMode="position")
        _trigger(event, "StartTrigger", first)
    if last < duration:
        event = _event(maneuver, f"{name}-leaves")
        _entity_action(_add(_add(event, "Action", name="delete"), "GlobalAction"), one, None)
        _trigger(event, "StartTrigger", last)


def _event(maneuver: ET.Element, name: str) -> ET.Element:
    return _add(maneuver, "Event", name=name, priority="parallel", maximumExecutionCount=1)


def _trigger(parent: ET.Element, tag: str, seconds: float) -> None:
    group = _add(_add(parent, tag), "ConditionGroup")
    how = {"name": "time", "delay": 0, "conditionEdge": "none"}
    value = _add(_add(group, "Condition", **how), "ByValueCondition")
    _add(value, "SimulationTimeCondition", value=seconds, rule="greaterOrEqual")


MOST_BYTES = 1 << 28
"""Bytes of an XML file, at most."""
_LONGEST_TIME = 1e6  # seconds
_MEND = "give a file that recast wrote"


class XmlFile:
    """An XML file without a document type, so that it defines no entities and names no files.

    Raises:
        InputError: it is missing, too large, no XML, or has another root or a document type. Also
            from the methods: an element or an attribute is missing, or a number is none.
    """

    def __init__(self, path: str | Path, root: str) -> None:
        self.path = Path(path)
        text = read_text(path, MOST_BYTES)
        if "<!DOCTYPE" in text:
            raise self.fault("DOCTYPE", "is not supported")
        try:
            self.root = ET.fromstring(text)
        except (ET.ParseError, ValueError, RecursionError) as error:
            raise self.fault("XML", f"cannot be read ({error})") from None
        if self.root.tag != root:
            raise self.fault("XML", f"is {self.root.tag}, not {root}")

    def fault(self, field: str, problem: str) -> InputError:
        """The error of a member."""
        return InputError(self.path, field, problem, _MEND)

    def one(self, parent: ET.Element, way: str) -> ET.Element:
        """The element below another, such as "BoundingBox/Center"."""
        found = parent.find(way)
        if found is None:
            raise self.fault(parent.tag, f"lacks {way}")
        return found

    def text(self, element: ET.Element, name: str) -> str:
        """An attribute."""
        if name not in element.attrib:
            raise self.fault(element.tag, f"lacks {name}")
        return element.attrib[name]

    def number(self, element: ET.Element, name: str, low: float, high: float) -> float:
        """An attribute that is a number from `low` to `high`."""
        text = self.text(element, name)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise self.fault(element.tag, f"{name} is {text[:40]!r}, not {low:g} to {high:g}")
        return value


def read_openscenario(path: str | Path) -> Played:
    """The entities of a file, with their paths; `name` is empty, the description the file's.

    Raises:
        InputError: no file of `write_openscenario`, see `XmlFile`.
    """
    file = XmlFile(path, "OpenSCENARIO")
    duration = _seconds(file, file.one(file.root, "Storyboard/StopTrigger"))
    actions = file.one(file.root, "Storyboard/Init/Actions")
    starts = {file.text(one, "entityRef"): one for one in actions.findall("Private")}
    acts = file.root.findall("Storyboard/Story/Act/ManeuverGroup")
    groups = {file.text(file.one(one, "Actors/EntityRef"), "entityRef"): one for one in acts}
    entities: dict[str, Entity] = {}
    for element in file.root.findall("Entities/ScenarioObject"):
        name = file.text(element, "name")
        if name in entities:
            raise file.fault("ScenarioObject", f"{name!r} is given twice")
        entities[name] = _entity(file, element, name, starts.get(name), groups.get(name))
    if not entities:
        raise file.fault("Entities", "holds no entity")
    text = file.text(file.one(file.root, "FileHeader"), "description")
    return Played("", text, duration, tuple(entities.values()))


def _entity(
    file: XmlFile,
    element: ET.Element,
    name: str,
    start: ET.Element | None,
    group: ET.Element | None,
) -> Entity:
    body = next(iter(element), None)
    if body is None or body.tag not in ("Vehicle", "Pedestrian"):
        raise file.fault("ScenarioObject", f"{name!r} is not a vehicle or pedestrian")
    if name != EGO and not name.startswith(TRACK):
        raise file.fault("ScenarioObject", f"{name!r} is not the name of a track")
    sides = file.one(body, "BoundingBox/Dimensions")
    size = [file.number(sides, side, *BOX_SIDE) for side in ("length", "width", "height")]
    middle = file.one(body, "BoundingBox/Center")
    centre = [file.number(middle, axis, -BOX_SIDE[1], BOX_SIDE[1]) for axis in "xyz"]
    line = [] if group is None else group.findall(".//Polyline/Vertex")
    if line:
        times = np.array([file.number(one, "time", 0, _LONGEST_TIME) for one in line])
        if np.any(np.diff(times) <= 0):
            raise file.fault("Vertex", f"times of {name!r} do not increase")
        poses = np.stack([_pose(file, one) for one in line])
    else:
        added = None if group is None else group.find(".//AddEntityAction")
        where = added if added is not None else start
        if where is None:
            raise file.fault("Init", f"{name!r} has no start position")
        event = None if group is None else group.find("Maneuver/Event")
        begins = 0.0 if added is None or event is None else _seconds(file, event)
        times, poses = np.array([begins]), _pose(file, file.one(where, ".//Position/.."))[None]
    speed = 0.0
    if start is not None:
        speed = file.number(file.one(start, ".//AbsoluteTargetSpeed"), "value", 0, WORLD_REACH)
    return Entity(
        track_id=None if name == EGO else unquote(name.removeprefix(TRACK)),
        category=unquote(file.text(body, "name")),
        size=np.array(size),
        centre=np.array(centre),
        times=times,
        poses=poses,
        speed=speed,
    )


def _pose(file: XmlFile, parent: ET.Element) -> Array:
    place = file.one(parent, "Position/WorldPosition")
    point = [file.number(place, axis, -WORLD_REACH, WORLD_REACH) for axis in "xyz"]
    h, p, r = (file.number(place, axis, -10, 10) for axis in "hpr")
    # A turn about z is one about y, or x, once the axes are renamed around.
    about_y = np.roll(se3.rotation_z(p), (-1, -1), (0, 1))
    about_x = np.roll(se3.rotation_z(r), (1, 1), (0, 1))
    return se3.from_rotation_translation(se3.rotation_z(h) @ about_y @ about_x, point)


def _seconds(file: XmlFile, parent: ET.Element) -> float:
    """When a trigger below an element fires."""
    return file.number(file.one(parent, ".//SimulationTimeCondition"), "value", 0, _LONGEST_TIME)


def largest_difference(one: Played, other: Played) -> tuple[float, float]:
    """Metres between box corners, and seconds between times, of the same entities; at most.

    Raises:
        ValueError: they have other entities, or paths of other lengths.
    """
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3) / 2
    metres, seconds = 0.0, abs(one.duration - other.duration)
    for a, b in zip(one.entities, other.entities, strict=True):
        if (a.track_id, a.category, a.times.shape) != (b.track_id, b.category, b.times.shape):
            raise ValueError(
                f"entities {a.track_id} and {b.track_id} differ in id, category or path length"
            )
        corners = [se3.apply(entity.boxes, (signs * entity.size)[None]) for entity in (a, b)]
        apart = corners[0] - corners[1]
        metres = max(metres, float(np.linalg.norm(apart, axis=-1).max()))
        seconds = max(seconds, float(np.abs(a.times - b.times).max()))
    return metres, seconds
