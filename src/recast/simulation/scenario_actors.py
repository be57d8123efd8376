"""Motions and further actors of a scenario file: from its tree to `ScenarioActor`s."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from recast.errors import InputError
from recast.logs.checks import check_name
from recast.simulation.scenario_nodes import known_only, required, shown
from recast.simulation.scenario_parts import BuiltInMotion, ScenarioActor
from recast.simulation.scenario_schema import MOTION_SCHEMAS, MotionSchema
from recast.simulation.yaml_lines import Node, place

_MEMBERS = ("motion", "replaced", "settings")


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
        mend = f"give {', '.join(_MEMBERS)} below it"
        raise InputError(place(where, node.line), field, f"is {shown(node)}", mend)
    known_only(node, _MEMBERS, where)
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
