"""What a scenario is made of: the target's motion, and further actors with theirs."""

from __future__ import annotations

from dataclasses import dataclass

from recast.simulation.actor_motion import AnyMotion
from recast.simulation.idm_motion import Idm
from recast.simulation.log_replay import LogReplay
from recast.simulation.motions import Advancing, CutIn, Oncoming, Stationary

BuiltInMotion = CutIn | Oncoming | Stationary | Advancing | LogReplay | Idm
"""A motion of this package, which a scenario file can describe."""


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
