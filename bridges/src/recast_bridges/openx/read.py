"""OpenSCENARIO files that `write_openscenario` wrote, read back and compared."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import read_text
from recast.geometry import se3
from recast.logs.checks import BOX_SIDE, WORLD_REACH
from recast_bridges.openx.entities import Entity, Played
from recast_bridges.openx.openscenario import EGO, TRACK

MOST_BYTES = 1 << 28
"""Of an XML file, at most."""
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
