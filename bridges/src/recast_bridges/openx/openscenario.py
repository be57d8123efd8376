"""OpenSCENARIO XML 1.2 (ASAM): entities with boxes, starts, and paths with a time at each vertex.

Numbers are written in full, so that what is read back is the same but for the rounding of angles.
Entities that appear late or leave early are deleted and added by events. Names become letters,
digits and %XX, so that no name of a log can end an attribute, hold what XML forbids, or name a
parameter ($); the track id itself is told as a property where XML can hold it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from urllib.parse import quote

import numpy as np

from recast.arrays import Array
from recast.core.files import write_bytes
from recast_bridges.openx.entities import CYCLIST, PEDESTRIAN, Entity, Played

EGO, TRACK = "ego", "track-"
"""Name of the ego, and what the names of tracks begin with."""
_DATE = "2000-01-01T00:00:00"  # the same scenario gives the same bytes
_KINDS = {"car": "car", "van": "van", "truck": "truck", "bus": "bus", "tram": "tram"}
_KINDS |= {CYCLIST: "bicycle", "misc": "car"}


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
