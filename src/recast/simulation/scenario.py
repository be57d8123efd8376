"""Scenarios: motions with quantities and ranges, by name as on the command line, and by file.

Errors name file, line and key.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from difflib import get_close_matches
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

from recast.core.arguments import checked
from recast.core.errors import InputError
from recast.core.yaml_lines import YamlNode, nodes_of, read_yaml_file
from recast.logs.checks import check_name
from recast.simulation.actor_motion import AnyMotion, BaseMotion, Quantity, Rows, whole_motion
from recast.simulation.motions import (
    Advancing,
    Along,
    CutIn,
    Idm,
    LoggedMotion,
    Oncoming,
    RouteCrossing,
    Stationary,
    TimedPath,
)

BuiltInMotion = (
    CutIn
    | Oncoming
    | Stationary
    | Advancing
    | RouteCrossing
    | Along
    | LoggedMotion
    | Idm
    | TimedPath
)
"""A motion of this package, which a scenario file can describe."""
VERSION = 1


@dataclass(frozen=True)
class ScenarioActor:
    """A further controlled actor of a scenario.

    Attributes:
        track_id: its track in the log.
        motion: what it does.
        replaced: whether its vehicle shall be replaced as the target's is, by the generator.
    """

    track_id: str
    motion: AnyMotion
    replaced: bool = False

    def __post_init__(self) -> None:
        motion = whole_motion(self.motion, f"motion of track {self.track_id}")
        object.__setattr__(self, "motion", motion)


@dataclass(frozen=True)
class Scenario:
    """One setting of a scenario with several actors; give it to `RolloutSetup` as `motion`.

    Attributes:
        name: name of the scenario, such as "squeeze".
        setting: its setting, such as "a".
        motion: motion of the target, the track that `RolloutSetup.track_id` names.
        actors: the further controlled actors, in order.
        description: one sentence, for people.
    """

    name: str
    setting: str
    motion: AnyMotion
    actors: tuple[ScenarioActor, ...]
    description: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "motion", whole_motion(self.motion))


ScriptedMotion = BuiltInMotion | Scenario
"""What a scenario file can describe: a motion of the target alone, or with further actors."""


def target_motion(motion: AnyMotion | Scenario) -> BaseMotion:
    """What the target does, with all members of a motion.

    Raises:
        InputError: see `whole_motion`.
    """
    return whole_motion(motion.motion if isinstance(motion, Scenario) else motion)


def further_actors(motion: AnyMotion | Scenario) -> tuple[ScenarioActor, ...]:
    """Who is controlled beside the target; nobody if `motion` is not a `Scenario`."""
    return motion.actors if isinstance(motion, Scenario) else ()


def replaced_tracks(motion: AnyMotion | Scenario) -> tuple[str, ...]:
    """Tracks beside the target whose vehicles shall be replaced."""
    return tuple(actor.track_id for actor in further_actors(motion) if actor.replaced)


@dataclass(frozen=True)
class MotionSchema:
    """One motion that files can set: what makes it, from which quantities and rows of numbers."""

    make: type[BuiltInMotion]
    quantities: Mapping[str, Quantity]
    rows: Mapping[str, Rows]

    @property
    def needs_numbers(self) -> bool:
        """Whether some quantity has no default, or there are rows."""
        return bool(self.rows) or not all(one.optional for one in self.quantities.values())

    @property
    def members(self) -> tuple[str, ...]:
        """Names of quantities and rows."""
        return (*self.quantities, *self.rows)


def _schema_of(make: type[BuiltInMotion]) -> MotionSchema:
    """From the annotations of a motion's members; those with a default may be left out."""
    hints = get_type_hints(make, include_extras=True)
    members = {one.name: one.default is not MISSING for one in fields(make)}
    given = {
        name: hints[name].__metadata__[0]
        for name in members
        if get_origin(hints[name]) is Annotated
    }
    return MotionSchema(
        make,
        {
            name: replace(one, optional=members[name])
            for name, one in given.items()
            if isinstance(one, Quantity)
        },
        {name: one for name, one in given.items() if isinstance(one, Rows)},
    )


MOTION_SCHEMAS: Mapping[str, MotionSchema] = {
    "cut-in": _schema_of(CutIn),
    "oncoming": _schema_of(Oncoming),
    "stationary": _schema_of(Stationary),
    "advancing": _schema_of(Advancing),
    "crossing": _schema_of(RouteCrossing),
    "along": _schema_of(Along),
    "log-replay": _schema_of(LoggedMotion),
    "idm": _schema_of(Idm),
    "timed-path": _schema_of(TimedPath),
}
"""By the word that a file's `motion` names."""


def kind_of(motion: object) -> str | None:
    """The word for a motion's type in a file; None for a motion of the user's own."""
    return next((k for k, schema in MOTION_SCHEMAS.items() if type(motion) is schema.make), None)


def motion_numbers(motion: object) -> dict[str, float]:
    """The quantities of a built-in motion by name, without those that are None."""
    kind = kind_of(motion)
    names = () if kind is None else tuple(MOTION_SCHEMAS[kind].quantities)
    values = {name: getattr(motion, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def motion_rows(motion: object) -> dict[str, list[list[float]]]:
    """The rows of numbers of a built-in motion by name; JSON-able."""
    kind = kind_of(motion)
    names = () if kind is None else tuple(MOTION_SCHEMAS[kind].rows)
    return {name: [list(row) for row in getattr(motion, name)] for name in names}


def start_after(motion: AnyMotion | Scenario) -> float | None:
    """Seconds after the log's first ego pose at which the target wants a rollout to start; None
    where it does not say."""
    target = target_motion(motion)
    return target.start_after if isinstance(target, TimedPath) else None


def scenario_numbers(motion: ScriptedMotion) -> list[str]:
    """Lines for people: the target's numbers with units, and one line a further actor."""
    lines = _lines(target_motion(motion))
    for actor in further_actors(motion):
        kind = kind_of(actor.motion) or actor.motion.name
        lines.append(", ".join([f"track {actor.track_id}: {kind}", *_lines(actor.motion)]))
    return lines


def _lines(motion: object) -> list[str]:
    kind = kind_of(motion)
    quantities = {} if kind is None else MOTION_SCHEMAS[kind].quantities
    numbers = motion_numbers(motion)
    lines = [f"{name} {value:g} {quantities[name].unit}" for name, value in numbers.items()]
    return [*lines, *(f"{name} {len(rows)} rows" for name, rows in motion_rows(motion).items())]


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
    return _motions(read_yaml_file(path, _LARGEST_FILE))


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
        "settings": {motion.setting: _numbers(target)},
    }
    actors = {
        actor.track_id: {
            "motion": _kind(actor.motion),
            **({"replaced": True} if actor.replaced else {}),
            "settings": {motion.setting: _numbers(actor.motion)},
        }
        for actor in further_actors(motion)
    }
    return {**record, "actors": actors} if actors else record


def motion_of_record(record: Mapping[str, Any], where: str = "scenario") -> ScriptedMotion:
    """The motion, or the `Scenario`, of a `scenario_record`.

    Raises:
        InputError: it says something wrong.
    """
    return _motions(nodes_of(record, where))[0]


def _numbers(motion: AnyMotion) -> dict[str, Any]:
    return {**motion_numbers(motion), **motion_rows(motion)}


def _kind(motion: AnyMotion) -> str:
    kind = kind_of(motion)
    if kind is None:
        problem = f"is a {type(motion).__name__}, which a scenario file cannot describe"
        raise InputError("scenario", f"motion {motion.name}", problem, "use a built-in motion")
    return kind


# Whatever is wrong is raised as the InputError of its node: file, line, key.


def _motions(root: YamlNode) -> tuple[ScriptedMotion, ...]:
    if not isinstance(root.value, dict):
        mend = f"begin with version: {VERSION}; see docs/scenarios.md#your-own-as-a-file"
        raise root.error("scenario", "is not a mapping of keys to values", mend)
    version = _required(root, "version", f"write version: {VERSION}")
    if isinstance(version.value, bool) or version.value != VERSION:
        problem = f"is {version.shown}, this recast reads {VERSION}"
        raise version.error("version", problem, f"write {VERSION}")
    _refuse_unknown(root, _FILE_KEYS)
    schema = _schema(root)
    name = _required(root, "name", "give a name, such as hard-cut-in")
    described = root.value.get("description", YamlNode("", root.place))
    if not isinstance(described.value, str):
        raise described.error("description", None, "give a text")
    settings = _required(root, "settings", "give at least one setting, such as a")
    if not isinstance(settings.value, dict) or not settings.value:
        mend = "give at least one setting, such as a, with its numbers below it"
        raise settings.error("settings", None, mend)
    names = {
        "name": _word(name.value, name, "name"),
        "description": " ".join(described.value.split()),
    }
    made: list[ScriptedMotion] = []
    for key, setting in settings.value.items():
        named = {**names, "setting": _word(key, setting, f"setting {key}")}
        target = _motion(schema, named, setting)
        actors = _actors(root, key, tuple(settings.value))
        made.append(Scenario(motion=target, actors=actors, **named) if actors else target)
    return tuple(made)


def _actors(root: YamlNode, setting: str, settings: tuple[str, ...]) -> tuple[ScenarioActor, ...]:
    """The further actors in one of the target's `settings`, which each of them has as well."""
    actors = root.value.get("actors")
    if actors is None:
        return ()
    if not isinstance(actors.value, dict) or not actors.value:
        mend = "give track ids with their motions below it, or leave actors out"
        raise actors.error("actors", None, mend)
    return tuple(_actor(key, node, setting, settings) for key, node in actors.value.items())


def _actor(track_id: str, node: YamlNode, setting: str, settings: tuple[str, ...]) -> ScenarioActor:
    field = f"actor {track_id}"
    try:
        check_name("track id", track_id)
    except ValueError as error:
        raise node.error(field, str(error), "give the id of a track") from None
    if not isinstance(node.value, dict):
        raise node.error(field, None, f"give the keys {', '.join(_ACTOR_KEYS)} below it")
    _refuse_unknown(node, _ACTOR_KEYS)
    schema = _schema(node)
    replaced = node.value.get("replaced", YamlNode(False, node.place))
    if not isinstance(replaced.value, bool):
        raise replaced.error("replaced", None, "write true or false")
    if "settings" not in node.value and not schema.needs_numbers:
        numbers = YamlNode(None, node.place)
    else:
        mend = f"give the settings {', '.join(settings)}, as for the target"
        given = _required(node, "settings", mend)
        if not isinstance(given.value, dict):
            raise given.error("settings", None, mend)
        _refuse_unknown(given, settings)
        numbers = _required(given, setting, mend)
    names = {"name": node.value["motion"].value, "setting": setting, "description": ""}
    return ScenarioActor(track_id, _motion(schema, names, numbers), replaced.value)


def _schema(node: YamlNode) -> MotionSchema:
    """What the member `motion` names."""
    mend = f"choose one of {', '.join(MOTION_SCHEMAS)}"
    kind = _required(node, "motion", mend)
    if not isinstance(kind.value, str) or kind.value not in MOTION_SCHEMAS:
        raise kind.error("motion", None, mend)
    return MOTION_SCHEMAS[kind.value]


def _motion(schema: MotionSchema, names: Mapping[str, str], setting: YamlNode) -> BuiltInMotion:
    """A motion with its name, setting and description, and the numbers of one setting."""
    given = {} if setting.value is None and not schema.needs_numbers else setting.value
    if not isinstance(given, dict):
        mend = f"give {', '.join(schema.members) or 'nothing'} below it"
        raise setting.error(f"setting {names['setting']}", None, mend)
    node = YamlNode(given, setting.place)
    _refuse_unknown(node, schema.members)
    values: dict[str, Any] = dict(names)
    for key, quantity in schema.quantities.items():
        if key not in given and quantity.optional:
            continue
        mend = f"give {quantity.range}"
        values[key] = _number(_required(node, key, mend), key, quantity)
    for key, rows in schema.rows.items():
        units = ", ".join(column.unit for column in rows.columns)
        mend = f"give {rows.least} rows or more, each a list of {units}"
        values[key] = _rows(_required(node, key, mend), key, rows, mend)
    try:
        return schema.make(**values)
    except ValueError as error:
        key, _, problem = str(error).partition(": ")
        problem, _, mend = problem.partition("; ")
        raise given.get(key, setting).error(key, problem, mend) from None


def _number(node: YamlNode, key: str, quantity: Quantity) -> float:
    mend = f"give {quantity.range}"
    if not isinstance(node.value, float):
        raise node.error(key, None, mend)
    if (fault := quantity.fault(node.value)) is not None:
        raise node.error(key, fault, mend)
    return node.value


def _rows(node: YamlNode, key: str, rows: Rows, mend: str) -> tuple[tuple[float, ...], ...]:
    if not isinstance(node.value, list) or len(node.value) < rows.least:
        problem = f"has {len(node.value)} rows" if isinstance(node.value, list) else None
        raise node.error(key, problem, mend)
    found = []
    for row in node.value:
        if not isinstance(row.value, list) or len(row.value) != len(rows.columns):
            numbers = (
                f"a list of length {len(row.value)}" if isinstance(row.value, list) else row.shown
            )
            raise row.error(key, f"has a row that is {numbers}", mend)
        pairs = zip(row.value, rows.columns, strict=True)
        found.append(tuple(_number(one, key, column) for one, column in pairs))
    return tuple(found)


def _required(node: YamlNode, key: str, mend: str) -> YamlNode:
    """The member `key` of a mapping; `mend` says what to write if it is missing."""
    if key not in node.value:
        raise node.error(key, "is missing", mend)
    return node.value[key]


def _refuse_unknown(node: YamlNode, known: tuple[str, ...]) -> None:
    for key, member in node.value.items():
        if key not in known:
            near = get_close_matches(key, known, 1)
            mend = f"did you mean {near[0]}?" if near else f"choose one of {', '.join(known)}"
            raise member.error(key, "is not known", mend)


def _word(text: Any, node: YamlNode, field: str) -> str:
    """A name of small letters, digits and hyphens; `node` is where it stands."""
    if not isinstance(text, str) or len(text) > _LONGEST_WORD or not _WORD.fullmatch(text):
        mend = (
            "use lower-case letters, digits and single hyphens, at most 40; quote it if all digits"
        )
        raise YamlNode(text, node.place).error(field, None, mend)
    return text


_BUILT_IN = (
    "cut-in",
    "cut-in-stop",
    "oncoming",
    "oncoming-through",
    "stationary",
    "advancing",
    "crossing",
    "along",
    "log-replay",
    "idm",
)
_SUFFIXES = (".yaml", ".yml")


def scenario_name(motion: AnyMotion | Scenario) -> str:
    """Name such as "cut-in-a"; `parse_motions` reads it back where the motion is built in."""
    return f"{motion.name}-{motion.setting}"


def _built_in() -> dict[str, ScriptedMotion]:
    with as_file(files("recast.simulation") / "scenarios") as folder:
        motions = [m for name in _BUILT_IN for m in read_scenario(folder / f"{name}.yaml")]
    return {scenario_name(motion): motion for motion in motions}


MOTIONS: dict[str, ScriptedMotion] = _built_in()
"""The motions with their settings, by scenario name."""


def parse_motions(name: str) -> tuple[ScriptedMotion, ...]:
    """The motions that a word on the command line stands for.

    Args:
        name: a scenario such as "cut-in-b"; a motion, which stands for all its settings; or the
            path of a scenario file (with a slash, or ending in .yaml or .yml), likewise.

    Raises:
        InputError: no such motion (lists those there are), or a faulty file.
    """
    lowered = name.strip().lower()
    found = tuple(m for key, m in MOTIONS.items() if lowered in (key, m.name))
    if found:
        return found
    path = Path(name.strip())
    if "/" not in name and path.suffix.lower() not in _SUFFIXES:
        raise InputError(
            "motion",
            name,
            "is not known",
            f"choose one of {', '.join(_BUILT_IN)}, with a setting such as cut-in-a or without; or "
            "a scenario file (.yaml)",
        )
    own = read_scenario(path)
    for motion in own:
        if scenario_name(motion) in MOTIONS:
            raise InputError(
                path,
                "name",
                f"{motion.name} with setting {motion.setting} is a built-in scenario",
                "choose another name or setting, so that results differ in name",
            )
    return own


@checked()
def motion(name: str | Path | AnyMotion | Scenario) -> BaseMotion | Scenario:
    """What an actor shall do, by name.

    Args:
        name: a scenario such as "cut-in-b"; a motion such as "cut-in", which stands for its first
            setting; the path of a scenario file, likewise; or a motion, which is returned
            with all members that it lacks.

    Raises:
        InputError: no such motion, a faulty file, or an object that is no motion.

    >>> motion("cut-in").setting
    'a'
    """
    if isinstance(name, str | Path):
        return parse_motions(str(name))[0]
    return name if isinstance(name, Scenario) else whole_motion(name)
