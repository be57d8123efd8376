"""Scenario files: YAML to motions, with errors that name file, line and key."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from recast import storage
from recast.errors import InputError
from recast.simulation.actor_motion import AnyMotion
from recast.simulation.scenario_actors import read_actors, read_motion, read_schema
from recast.simulation.scenario_nodes import known_only, required, shown, word
from recast.simulation.scenario_parts import (
    Scenario,
    ScriptedMotion,
    further_actors,
    target_motion,
)
from recast.simulation.scenario_schema import VERSION, kind_of, motion_numbers
from recast.simulation.yaml_lines import Node, located, place, read_yaml

_MEMBERS = ("version", "name", "motion", "description", "settings", "actors")
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
    version = required(root, "version", where, f"write version: {VERSION}")
    if isinstance(version.value, bool) or version.value != VERSION:
        problem = f"is {shown(version)}, this recast reads {VERSION}"
        raise InputError(place(where, version.line), "version", problem, f"write {VERSION}")
    known_only(root, _MEMBERS, where)
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
