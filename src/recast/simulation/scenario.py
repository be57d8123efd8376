"""What a scenario is made of, and what its file may say: motions with quantities and ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from typing import Annotated, get_origin, get_type_hints

from recast.simulation.actor_motion import AnyMotion, BaseMotion, Quantity, Rows, whole_motion
from recast.simulation.motions import (
    Advancing,
    CutIn,
    Idm,
    LoggedMotion,
    Oncoming,
    Stationary,
    TimedPath,
)

BuiltInMotion = CutIn | Oncoming | Stationary | Advancing | LoggedMotion | Idm | TimedPath
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


def _schema(make: type[BuiltInMotion]) -> MotionSchema:
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
    "cut-in": _schema(CutIn),
    "oncoming": _schema(Oncoming),
    "stationary": _schema(Stationary),
    "advancing": _schema(Advancing),
    "log-replay": _schema(LoggedMotion),
    "idm": _schema(Idm),
    "timed-path": _schema(TimedPath),
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
