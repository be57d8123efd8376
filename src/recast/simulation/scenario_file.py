"""Scenario files: YAML to motions, with errors that name file, line and key."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from recast import storage
from recast.errors import InputError
from recast.simulation.motions import ScriptedMotion
from recast.simulation.scenario_schema import MOTION_SCHEMAS, VERSION, MotionSchema
from recast.simulation.yaml_lines import Node, located, place, read_yaml

_MEMBERS = ("version", "name", "motion", "description", "settings")
_WORD = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_LONGEST_WORD = 40  # names become folder names
_LARGEST_FILE = 100_000  # bytes


def read_scenario(path: str | Path) -> tuple[ScriptedMotion, ...]:
    """The motions of a scenario file, one a setting, in its order.

    Raises:
        InputError: the file cannot be read, or says something wrong: names file, line and key.
    """
    return _motions(read_yaml(_text(Path(path)), str(path)), str(path))


def scenario_record(motion: ScriptedMotion) -> dict[str, Any]:
    """A motion as the data of a scenario file with one setting; JSON-able."""
    kind, schema = next(
        (kind, schema) for kind, schema in MOTION_SCHEMAS.items() if type(motion) is schema.make
    )
    values = {name: getattr(motion, name) for name in schema.quantities}
    return {
        "version": VERSION,
        "name": motion.name,
        "motion": kind,
        "description": motion.description,
        "settings": {motion.setting: {k: v for k, v in values.items() if v is not None}},
    }


def motion_of_record(record: Mapping[str, Any], where: str = "scenario") -> ScriptedMotion:
    """The motion of a `scenario_record`.

    Raises:
        InputError: it says something wrong.
    """
    return _motions(located(record, where), where)[0]


def _text(path: Path) -> str:
    mend = "name a scenario file, see docs/scenarios.md"
    data = storage.read_bytes(path, _LARGEST_FILE)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(place(str(path), line), "file", "is not UTF-8 text", mend) from None


def _motions(root: Node, where: str) -> tuple[ScriptedMotion, ...]:
    if not isinstance(root.value, dict):
        mend = f"begin with version: {VERSION}, see docs/scenarios.md"
        raise InputError(place(where, root.line), "scenario", "is no list of keys", mend)
    version = _required(root, "version", where, f"write version: {VERSION}")
    if isinstance(version.value, bool) or version.value != VERSION:
        problem = f"is {_shown(version)}, this recast reads {VERSION}"
        raise InputError(place(where, version.line), "version", problem, f"write {VERSION}")
    _known_only(root, _MEMBERS, where)
    kinds = ", ".join(MOTION_SCHEMAS)
    kind = _required(root, "motion", where, f"choose one of {kinds}")
    if not isinstance(kind.value, str) or kind.value not in MOTION_SCHEMAS:
        raise InputError(
            place(where, kind.line), "motion", f"is {_shown(kind)}", f"choose one of {kinds}"
        )
    name = _required(root, "name", where, "give one, such as hard-cut-in")
    described = root.value.get("description", Node(""))
    if not isinstance(described.value, str):
        raise InputError(
            place(where, described.line), "description", f"is {_shown(described)}", "give a text"
        )
    settings = _required(root, "settings", where, "give at least one, such as a")
    if not isinstance(settings.value, dict) or not settings.value:
        problem = f"is {_shown(settings)}"
        mend = "give at least one, such as a, with its numbers below it"
        raise InputError(place(where, settings.line), "settings", problem, mend)
    return tuple(
        _motion(
            MOTION_SCHEMAS[kind.value],
            {
                "name": _word(name.value, name, "name", where),
                "setting": _word(key, setting, f"setting {key}", where),
                "description": " ".join(described.value.split()),
            },
            setting,
            where,
        )
        for key, setting in settings.value.items()
    )


def _motion(
    schema: MotionSchema, names: Mapping[str, str], setting: Node, where: str
) -> ScriptedMotion:
    if not isinstance(setting.value, dict):
        raise InputError(
            place(where, setting.line),
            f"setting {names['setting']}",
            f"is {_shown(setting)}",
            f"give {', '.join(schema.quantities)} below it",
        )
    _known_only(setting, tuple(schema.quantities), where)
    values: dict[str, Any] = dict(names)
    for key, quantity in schema.quantities.items():
        if key not in setting.value and quantity.optional:
            continue
        mend = f"give {quantity.range}"
        node = _required(setting, key, where, mend)
        at = place(where, node.line)
        if not isinstance(node.value, float):
            raise InputError(at, key, f"is {_shown(node)}", mend)
        fault = quantity.fault(node.value)
        if fault is not None:
            raise InputError(at, key, fault, mend)
        values[key] = node.value
    return schema.make(**values)


def _required(node: Node, key: str, where: str, mend: str) -> Node:
    if key not in node.value:
        raise InputError(place(where, node.line), key, "is missing", mend)
    found: Node = node.value[key]
    return found


def _known_only(node: Node, known: tuple[str, ...], where: str) -> None:
    for key, member in node.value.items():
        if key not in known:
            near = get_close_matches(key, known, 1)
            mend = f"did you mean {near[0]}?" if near else f"the keys are {', '.join(known)}"
            raise InputError(place(where, member.line), key, "is not known", mend)


def _word(text: Any, node: Node, field: str, where: str) -> str:
    if not isinstance(text, str) or len(text) > _LONGEST_WORD or not _WORD.fullmatch(text):
        problem = f"is {_shown(Node(text))}"
        mend = "use small letters, digits and single hyphens, 40 at most, in quotes if all digits"
        raise InputError(place(where, node.line), field, problem, mend)
    return text


def _shown(node: Node) -> str:
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
