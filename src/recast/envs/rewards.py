"""What happened in a step of the environment, and what it is worth."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.core.foreign import BasePart
from recast.metrics.driving import TOUCHING, any_collision, drivable_area_compliance, no_collision
from recast.planning import ReferenceRoute
from recast.simulation import Rollout


@dataclass(frozen=True)
class StepFacts:
    """What happened between two observations.

    Attributes:
        steps: simulation steps that were executed.
        seconds: duration of these steps.
        progress: metres that the ego advanced along the route.
        lateral: metres from the route to the ego's rear axle now, left positive.
        speed: speed of the ego now, m/s.
        collision: whether the ego overlapped a controlled actor.
        overlap: largest overlap, square metres.
        off_road: whether a corner of the ego left the drivable area by more than 0.3 m; False
            without a map.
        off_road_distance: how far the ego left the drivable area, metres; 0 without a map.
        route_end: whether the ego came to the end of the route.
    """

    steps: int
    seconds: float
    progress: float
    lateral: float
    speed: float
    collision: bool
    overlap: float
    off_road: bool
    off_road_distance: float
    route_end: bool

    def to_info(self) -> dict[str, Any]:
        """Plain values by name."""
        return asdict(self)


class Reward(Protocol):
    """A number for what happened: a function, or an object that is called.

    That is enough; `BaseReward` has all members, with their defaults.
    """

    def __call__(self, facts: StepFacts) -> float:
        """The reward of one step."""


class BaseReward(BasePart):
    """A `Reward` with all members that are asked for: derive yours from it."""

    @abstractmethod
    def __call__(self, facts: StepFacts) -> float:
        """The reward of one step."""

    def parts(self, facts: StepFacts) -> Mapping[str, float]:
        """The terms of the reward by name, for `info`."""
        return {}


@dataclass(frozen=True)
class ProgressReward(BaseReward):
    """Progress along the route, less a penalty in each step with a collision or off the road.

    Attributes:
        progress: reward for each metre along the route.
        collision, off_road: penalty for a step with a collision, and for one off the road.
    """

    progress: float = 1.0
    collision: float = 10.0
    off_road: float = 10.0

    def __call__(self, facts: StepFacts) -> float:
        """The weighted sum."""
        return float(sum(self.parts(facts).values()))

    def parts(self, facts: StepFacts) -> Mapping[str, float]:
        """The terms of the sum by name."""
        return {
            "progress": self.progress * facts.progress,
            "collision": -self.collision * facts.collision,
            "off_road": -self.off_road * facts.off_road,
        }


def step_facts(
    rollout: Rollout,
    first: int,
    route: ReferenceRoute,
    route_s: ArrayLike,
    region: shapely.Geometry | None,
    route_end: bool,
) -> StepFacts:
    """The facts of the states after `first`, by the metrics' own functions.

    Args:
        rollout: rollout up to now.
        first: step at the last observation.
        route_s: coordinates (S+1,) of the ego on the route.
        region: drivable area, see `recast.logs.hdmap`; None without a map.
        route_end: whether the ego came to the end of the route.
    """
    new, dt = slice(first + 1, None), rollout.dt
    boxes, size = rollout.ego_boxes[new], rollout.ego_size
    actors = [(rollout.actor, rollout.actor_size)]
    actors += [(actor.states, actor.size) for actor in rollout.controlled]
    hit = any_collision([no_collision(boxes, size, states[new], box, dt) for states, box in actors])
    distance = drivable_area_compliance(boxes, size, region, dt)
    s = np.asarray(route_s, np.float64)[[first, -1]]
    lateral = float(route.project(rollout.ego[-1], s[1])[1])
    return StepFacts(
        steps=len(boxes),
        seconds=len(boxes) * dt,
        progress=float(s[1] - s[0]),
        lateral=lateral,
        speed=float(rollout.ego[-1, 3]),
        collision=bool(np.any(hit.overlap > TOUCHING)),
        overlap=float(hit.overlap.max()),
        off_road=distance.dac.value == 0.0,
        off_road_distance=0.0 if distance.distance is None else float(distance.distance.max()),
        route_end=route_end,
    )


NOTHING = StepFacts(0, 0.0, 0.0, 0.0, 0.0, False, 0.0, False, 0.0, False)
"""The facts of a step in which nothing could be executed."""
