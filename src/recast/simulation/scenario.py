"""What a scenario is made of, and what its file may say: motions with quantities and ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from recast.simulation.actor_motion import AnyMotion
from recast.simulation.idm_motion import Idm
from recast.simulation.motions import Advancing, CutIn, LogReplay, Oncoming, Stationary

BuiltInMotion = CutIn | Oncoming | Stationary | Advancing | LogReplay | Idm
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


@dataclass(frozen=True)
class Scenario:
    """One setting of a scenario with several actors; give it to `RolloutSetup` as `motion`.

    Attributes:
        name, setting: of the scenario, such as "squeeze" and "a".
        motion: of the target, the track that `RolloutSetup.track_id` names.
        actors: the further controlled actors, in order.
        description: one sentence, for people.
    """

    name: str
    setting: str
    motion: AnyMotion
    actors: tuple[ScenarioActor, ...]
    description: str = ""


ScriptedMotion = BuiltInMotion | Scenario
"""What a scenario file can describe: a motion of the target alone, or with further actors."""


def target_motion(motion: AnyMotion | Scenario) -> AnyMotion:
    """What the target does."""
    return motion.motion if isinstance(motion, Scenario) else motion


def further_actors(motion: AnyMotion | Scenario) -> tuple[ScenarioActor, ...]:
    """Who is controlled beside the target; nobody if `motion` is not a `Scenario`."""
    return motion.actors if isinstance(motion, Scenario) else ()


def replaced_tracks(motion: AnyMotion | Scenario) -> tuple[str, ...]:
    """Tracks beside the target whose vehicles shall be replaced."""
    return tuple(actor.track_id for actor in further_actors(motion) if actor.replaced)


@dataclass(frozen=True)
class Quantity:
    """A number in a scenario file.

    Attributes:
        unit: as people read it.
        low, high: the range, both included.
        positive: `low` is 0 and itself not allowed.
        optional: may be left out; the motion has a default.
    """

    unit: str
    low: float
    high: float
    positive: bool = False
    optional: bool = False

    def fault(self, value: float) -> str | None:
        """What is wrong with a number, or None."""
        if not math.isfinite(value):
            return f"is {value}"
        if value < 0.0 <= self.low:
            return "is negative"
        if not self.low <= value <= self.high or (self.positive and value == 0.0):
            return f"is {value:g}"
        return None

    @property
    def range(self) -> str:
        """The range and the unit, such as "-50 to 500 m"."""
        low = "more than 0, at most" if self.positive else f"{self.low:.5g} to"
        return f"{low} {self.high:.5g} {self.unit}"


@dataclass(frozen=True)
class MotionSchema:
    """One motion that files can set: what makes it, from which quantities."""

    make: type[BuiltInMotion]
    quantities: Mapping[str, Quantity]

    @property
    def needs_numbers(self) -> bool:
        """Whether some quantity has no default."""
        return not all(quantity.optional for quantity in self.quantities.values())


_GAP = Quantity("m", -50.0, 500.0)  # less than 0: beside or behind the ego
_SHARE = Quantity("of v_r", 0.0, 5.0)
_LATERAL = Quantity("m", -20.0, 20.0, optional=True)

MOTION_SCHEMAS: Mapping[str, MotionSchema] = {
    "cut-in": MotionSchema(
        CutIn,
        {
            "gap": _GAP,
            "initial_speed": _SHARE,
            "target_speed": _SHARE,
            "delay": Quantity("s", 0.0, 60.0),
            "duration": Quantity("s", 0.0, 60.0, positive=True),
            "stop_after": Quantity("s", 0.0, 60.0, optional=True),
        },
    ),
    "oncoming": MotionSchema(
        Oncoming,
        {
            "gap": _GAP,
            "speed": Quantity("m/s", 0.0, 100.0),
            "stop_distance": Quantity("m", 0.0, 1000.0, positive=True, optional=True),
            "lateral": _LATERAL,
        },
    ),
    "stationary": MotionSchema(
        Stationary,
        {
            "min_gap": _GAP,
            "braking": Quantity("m/s^2", 0.0, 20.0, positive=True),
            "reserve": Quantity("m", 0.0, 500.0),
            "yaw": Quantity("rad", -math.pi, math.pi, optional=True),
            "lateral": _LATERAL,
        },
    ),
    "advancing": MotionSchema(Advancing, {"gap": _GAP, "speed": _SHARE}),
    "log-replay": MotionSchema(LogReplay, {}),
    "idm": MotionSchema(
        Idm,
        {
            "speed": Quantity("of v_r", 0.0, 5.0, positive=True, optional=True),
            "headway": Quantity("s", 0.0, 60.0, optional=True),
            "min_gap": Quantity("m", 0.0, 100.0, positive=True, optional=True),
            "gap": Quantity("m", -50.0, 500.0, optional=True),
            "lateral": _LATERAL,
        },
    ),
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
    return [f"{name} {value:g} {quantities[name].unit}" for name, value in numbers.items()]
