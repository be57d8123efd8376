"""Scenario files: YAML to motions and further actors, with errors that name file, line and key."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from recast.core import files
from recast.core.errors import InputError
from recast.logs.checks import check_name
from recast.simulation.actor_motion import AnyMotion
from recast.simulation.scenario import (
    MOTION_SCHEMAS,
    VERSION,
    BuiltInMotion,
    MotionSchema,
    Scenario,
    ScenarioActor,
    ScriptedMotion,
    further_actors,
    kind_of,
    motion_numbers,
    target_motion,
)
from recast.simulation.yaml_lines import Node, located, place, read_yaml

_WORD = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_LONGEST_WORD = 40  # names become folder names
_ACTOR_KEYS = ("motion", "replaced", "settings")
_FILE_KEYS = ("version", "name", "motion", "description", "settings", "actors")
_LARGEST_FILE = 100_000  # bytes


def read_scenario(path: str | Path) -> tuple[ScriptedMotion, ...]:
    """The motions of a scenario file, one a setting, in its order.

    Raises:
        InputError: the file cannot be read, or says something wrong: names file, line and key.
    """
    return _motions(read_yaml(_text(Path(path)), str(path)), str(path))


def scenario_record(motion: ScriptedMotion) -> dict[str, Any]:
    """A motion or a `Scenario` as the data of a scenario file with one setting; JSON-able.

    Raises:
        InputError: a motion is none that a file can describe.
    """
    target = target_motion(motion)
    record = {
        "version": VERSION,
        "name": motion.name,
        "motion": _kind(target),
        "description": motion.description,
        "settings": {motion.setting: motion_numbers(target)},
    }
    actors = {
        actor.track_id: {
            "motion": _kind(actor.motion),
            **({"replaced": True} if actor.replaced else {}),
            "settings": {motion.setting: motion_numbers(actor.motion)},
        }
        for actor in further_actors(motion)
    }
    return {**record, "actors": actors} if actors else record


def motion_of_record(record: Mapping[str, Any], where: str = "scenario") -> ScriptedMotion:
    """The motion, or the `Scenario`, of a `scenario_record`.

    Raises:
        InputError: it says something wrong.
    """
    return _motions(located(record, where), where)[0]


def _kind(motion: AnyMotion) -> str:
    kind = kind_of(motion)
    if kind is None:
        problem = f"is a {type(motion).__name__}, which no scenario file can describe"
        raise InputError("scenario", f"motion {motion.name}", problem, "use a motion of recast")
    return kind


def _text(path: Path) -> str:
    mend = "name a scenario file, see docs/scenarios.md"
    data = files.read_bytes(path, _LARGEST_FILE)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(place(str(path), line), "file", "is not UTF-8 text", mend) from None


def _motions(root: Node, where: str) -> tuple[ScriptedMotion, ...]:
    if not isinstance(root.value, dict):
        mend = f"begin with version: {VERSION}, see docs/scenarios.md"
        raise InputError(place(where, root.line), "scenario", "is no list of keys", mend)
    version = required(root, "version", where, f"write version: {VERSION}")
    if isinstance(version.value, bool) or version.value != VERSION:
        problem = f"is {shown(version)}, this recast reads {VERSION}"
        raise InputError(place(where, version.line), "version", problem, f"write {VERSION}")
    known_only(root, _FILE_KEYS, where)
    schema = read_schema(root, where)
    name = required(root, "name", where, "give one, such as hard-cut-in")
    described = root.value.get("description", Node(""))
    if not isinstance(described.value, str):
        raise InputError(
            place(where, described.line), "description", f"is {shown(described)}", "give a text"
        )
    settings = required(root, "settings", where, "give at least one, such as a")
    if not isinstance(settings.value, dict) or not settings.value:
        problem = f"is {shown(settings)}"
        mend = "give at least one, such as a, with its numbers below it"
        raise InputError(place(where, settings.line), "settings", problem, mend)
    names = {
        "name": word(name.value, name, "name", where),
        "description": " ".join(described.value.split()),
    }
    made: list[ScriptedMotion] = []
    for key, setting in settings.value.items():
        named = {**names, "setting": word(key, setting, f"setting {key}", where)}
        target = read_motion(schema, named, setting, where)
        actors = read_actors(root, key, tuple(settings.value), where)
        made.append(Scenario(motion=target, actors=actors, **named) if actors else target)
    return tuple(made)


def read_actors(
    root: Node, setting: str, settings: tuple[str, ...], where: str
) -> tuple[ScenarioActor, ...]:
    """The further actors of a file in one of its settings; none without a member `actors`.

    Args:
        settings: of the target. Each actor has the same ones.
        where: the file, for errors.

    Raises:
        InputError: names file, line and key.
    """
    actors = root.value.get("actors")
    if actors is None:
        return ()
    if not isinstance(actors.value, dict) or not actors.value:
        mend = "give track ids with their motions below it, or leave it out"
        raise InputError(place(where, actors.line), "actors", f"is {shown(actors)}", mend)
    return tuple(
        _actor(track_id, node, setting, settings, where) for track_id, node in actors.value.items()
    )


def _actor(
    track_id: str, node: Node, setting: str, settings: tuple[str, ...], where: str
) -> ScenarioActor:
    field = f"actor {track_id}"
    try:
        check_name("track id", track_id)
    except ValueError as error:
        raise InputError(place(where, node.line), field, str(error), "name a track") from None
    if not isinstance(node.value, dict):
        mend = f"give {', '.join(_ACTOR_KEYS)} below it"
        raise InputError(place(where, node.line), field, f"is {shown(node)}", mend)
    known_only(node, _ACTOR_KEYS, where)
    schema = read_schema(node, where)
    replaced = node.value.get("replaced", Node(False))
    if not isinstance(replaced.value, bool):
        at = place(where, replaced.line)
        raise InputError(at, "replaced", f"is {shown(replaced)}", "write true or false")
    if "settings" not in node.value and not schema.needs_numbers:
        numbers = Node(None, node.line)
    else:
        mend = f"give {', '.join(settings)}, as for the target"
        given = required(node, "settings", where, mend)
        if not isinstance(given.value, dict):
            raise InputError(place(where, given.line), "settings", f"is {shown(given)}", mend)
        known_only(given, settings, where)
        numbers = required(given, setting, where, mend)
    names = {"name": node.value["motion"].value, "setting": setting, "description": ""}
    return ScenarioActor(track_id, read_motion(schema, names, numbers, where), replaced.value)


def read_schema(node: Node, where: str) -> MotionSchema:
    """What the member `motion` of a mapping names.

    Raises:
        InputError: names file, line and key.
    """
    kinds = ", ".join(MOTION_SCHEMAS)
    kind = required(node, "motion", where, f"choose one of {kinds}")
    if not isinstance(kind.value, str) or kind.value not in MOTION_SCHEMAS:
        raise InputError(
            place(where, kind.line), "motion", f"is {shown(kind)}", f"choose one of {kinds}"
        )
    return MOTION_SCHEMAS[kind.value]


def read_motion(
    schema: MotionSchema, names: Mapping[str, str], setting: Node, where: str
) -> BuiltInMotion:
    """One motion with the numbers of one setting.

    Args:
        names: its name, setting and description.
        setting: the mapping of its numbers; may be empty if the motion needs none.
        where: the file, for errors.

    Raises:
        InputError: names file, line and key.
    """
    given = {} if setting.value is None and not schema.needs_numbers else setting.value
    if not isinstance(given, dict):
        raise InputError(
            place(where, setting.line),
            f"setting {names['setting']}",
            f"is {shown(setting)}",
            f"give {', '.join(schema.quantities) or 'nothing'} below it",
        )
    node = Node(given, setting.line)
    known_only(node, tuple(schema.quantities), where)
    values: dict[str, Any] = dict(names)
    for key, quantity in schema.quantities.items():
        if key not in given and quantity.optional:
            continue
        mend = f"give {quantity.range}"
        number = required(node, key, where, mend)
        at = place(where, number.line)
        if not isinstance(number.value, float):
            raise InputError(at, key, f"is {shown(number)}", mend)
        fault = quantity.fault(number.value)
        if fault is not None:
            raise InputError(at, key, fault, mend)
        values[key] = number.value
    try:
        return schema.make(**values)
    except ValueError as error:
        key, _, problem = str(error).partition(": ")
        problem, _, mend = problem.partition("; ")
        at = place(where, given.get(key, setting).line)
        raise InputError(at, key, problem, mend) from None


def required(node: Node, key: str, where: str, mend: str) -> Node:
    """The member `key` of a mapping; `mend` says what to write if it is missing."""
    if key not in node.value:
        raise InputError(place(where, node.line), key, "is missing", mend)
    found: Node = node.value[key]
    return found


def known_only(node: Node, known: tuple[str, ...], where: str) -> None:
    """Refuse members of a mapping with other keys than `known`."""
    for key, member in node.value.items():
        if key not in known:
            near = get_close_matches(key, known, 1)
            mend = f"did you mean {near[0]}?" if near else f"the keys are {', '.join(known)}"
            raise InputError(place(where, member.line), key, "is not known", mend)


def word(text: Any, node: Node, field: str, where: str) -> str:
    """A name of small letters, digits and hyphens; `node` is where it stands."""
    if not isinstance(text, str) or len(text) > _LONGEST_WORD or not _WORD.fullmatch(text):
        problem = f"is {shown(Node(text))}"
        mend = "use small letters, digits and single hyphens, 40 at most, in quotes if all digits"
        raise InputError(place(where, node.line), field, problem, mend)
    return text


def shown(node: Node) -> str:
    """A value as an error shows it."""
    value = node.value
    if value is None:
        return "empty"
    if isinstance(value, dict):
        return "a list of keys"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, float):
        return f"the number {value:g}"
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(str(value))
    return text if len(text) <= 40 else f"{text[:36]}...'"
