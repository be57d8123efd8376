"""All metrics of one closed-loop rollout."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from recast.core.brief import Brief
from recast.core.errors import InputError, printable
from recast.core.foreign import BasePart, foreign_call, read_only, whole
from recast.core.plugins import METRICS
from recast.dynamics import state as ego
from recast.geometry.boxes import TOUCHING, bev_overlap_area
from recast.logs.hdmap import HdMap, drivable_region
from recast.metrics.driving import (
    TOLERANCE,
    Collision,
    Comfort,
    DrivableArea,
    RouteCompletion,
    TimeToCollision,
    any_collision,
    box_gaps,
    com_4_13,
    com_driven,
    com_hugsim,
    com_nuplan_savgol,
    constant_velocity_future,
    drivable_area_compliance,
    least_time,
    no_collision,
    no_collision_at_fault,
    no_phantom_braking,
    realised_future,
    route_completion,
    time_to_collision,
)
from recast.metrics.table import COLUMNS, Metric, column_of, over_common_steps
from recast.simulation.rollout import Rollout

Array = NDArray[Any]

_OF_ROLLOUT = (
    *("name", "arm", "track_id", "motion", "setting", "planner", "start_timestamp_us"),
    *("steps_requested", "steps_run", "cut_reason"),
)


class RolloutMetric(Protocol):
    """A metric of your own. These members are enough.

    Attributes:
        name: key in files, heading in tables, and measure of a search's objective: lower-case
            letters, digits and underscores. It best ends in the unit: "gap_m".
    """

    name: str

    def score(self, rollout: Rollout, hd_map: HdMap | None) -> Metric | float | None:
        """The metric of one rollout; None if it has no value.

        Args:
            rollout: read-only, without `origin`; of any length from one step.
            hd_map: read-only; None if the log has no map.
        """


class BaseMetric(BasePart):
    """A `RolloutMetric` with all members that are asked for: derive yours from it."""

    name: str

    @abstractmethod
    def score(self, rollout: Rollout, hd_map: HdMap | None) -> Metric | float | None:
        """The metric of one rollout, see `RolloutMetric`."""


def own_metrics(metrics: Iterable[str | RolloutMetric]) -> tuple[BaseMetric, ...]:
    """Own metrics from names of installed ones, "package.module:attribute", or objects.

    Raises:
        InputError: there is no such metric, or its name is not a word or is taken.
    """
    found: dict[str, BaseMetric] = {}
    for one in metrics:
        metric = whole(METRICS.resolve(one), BaseMetric)
        name = metric.name
        if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]{0,39}", name):
            mend = "use lower-case letters, digits and underscores, at most 40, such as gap_m"
            raise InputError("metric", "name", f"is {name!r}", mend)
        if name in COLUMNS or name in found:
            raise InputError("metric", name, "is the name of another metric", "choose another")
        found[name] = metric
    return tuple(found.values())


def _own_scores(
    rollout: Rollout, hd_map: HdMap | None, metrics: Sequence[BaseMetric]
) -> dict[str, Metric]:
    shown = read_only((replace(rollout, origin=None), hd_map)) if metrics else ()
    found = {}
    for metric in metrics:
        who, what = f"metric {metric.name}", f"rollout {rollout.name}"
        with foreign_call(who, what, getattr(metric, "part", metric)):
            given = metric.score(*shown)
        scored = given if isinstance(given, Metric) else Metric(given)
        value, reason = scored.value, scored.reason
        is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (value is None or (is_number and np.isfinite(value))):
            mend = "return a finite number, None, or Metric(value, reason)"
            raise InputError(who, what, f"returns {str(value)[:80]}", mend)
        text = None if reason is None else printable(str(reason))
        found[metric.name] = Metric(None if value is None else float(value), text)
    return found


@dataclass(frozen=True, repr=False)
class RolloutMetrics(Brief):
    """What one rollout scored, and why.

    Attributes:
        name, arm, track_id, motion, setting, planner, start_timestamp_us, steps_requested,
            cut_reason: the rollout's fields of the same names, see `Rollout`.
        steps_run: executed steps S; C plans were made.
        plan_steps: (C,) steps at which they were made.
        map_derived: whether the map was made from the drive itself; None without a map.
        collision, drivable, ttc, ttc_constant_velocity, progress: values with their arrays; over
            all controlled actors.
        collisions: NC with each controlled actor, by track id, the target first.
        nc_at_fault: NC over the contacts that the ego is to blame for.
        braking: whether hard braking has a cause.
        comfort, comfort_4_13, comfort_nuplan_savgol: three readings of COM; the first is the
            headline.
        driven: nuPlan's comfort of what was driven.
        rollout, hd_map: what was scored.
        own: values of own metrics by name; `own_from` are the metrics.
    """

    name: str
    arm: str
    track_id: str
    motion: str
    setting: str
    planner: str
    start_timestamp_us: int
    steps_requested: int
    steps_run: int
    cut_reason: str | None
    plan_steps: tuple[int, ...]
    map_derived: bool | None
    collision: Collision
    collisions: Mapping[str, Collision]
    nc_at_fault: Metric
    braking: Metric
    drivable: DrivableArea
    ttc: TimeToCollision
    ttc_constant_velocity: TimeToCollision
    progress: RouteCompletion
    comfort: Comfort
    comfort_4_13: Comfort
    comfort_nuplan_savgol: Comfort
    driven: Comfort
    rollout: Rollout
    hd_map: HdMap | None
    own: Mapping[str, Metric] = field(default_factory=dict)
    own_from: tuple[BaseMetric, ...] = ()

    def __str__(self) -> str:
        """The headline metrics, a line each, with their reasons."""
        lines = [f"{self.name} by {self.planner}: {self.steps_run} of {self.steps_requested} steps"]
        if self.cut_reason is not None:
            lines[0] += f" ({self.cut_reason})"
        for name, metric in self._headline():
            column = column_of(name)
            line = f"  {column.label:<11}{column.shown(metric):>7} {column.unit:<2}"
            lines.append(line if metric.reason is None else f"{line} {metric.reason}")
        return "\n".join(lines)

    def _headline(self) -> list[tuple[str, Metric]]:
        return [(name, one) for name, one in self.values.items() if column_of(name).headline]

    def _facts(self) -> Mapping[str, object]:
        return {
            "name": self.name,
            "planner": self.planner,
            "steps": f"{self.steps_run} of {self.steps_requested}",
            **{
                column.label: f"{column.shown(metric)} {column.unit}".rstrip()
                for name, metric in self._headline()
                for column in (column_of(name),)
            },
        }

    @property
    def plans(self) -> int:
        """How many plans C were made."""
        return len(self.plan_steps)

    @property
    def contact_speed(self) -> float | None:
        """Relative speed in m/s at the first contact; None without one."""
        step = self.collision.first_step
        if step is None:
            return None
        of = {actor.track_id: actor.states for actor in rollout_actors(self.rollout)}
        hit = next(k for k, one in self.collisions.items() if one.first_step == step)
        own, other = self.rollout.ego[step], of[hit][step]
        along = own[ego.VX] * np.array([np.cos(own[ego.HEADING]), np.sin(own[ego.HEADING])])
        towards = other[3] * np.array([np.cos(other[2]), np.sin(other[2])])
        return float(np.linalg.norm(along - towards))

    def over(self, steps: int) -> RolloutMetrics:
        """The metrics that the rollout would have, had it ended after `steps` of its steps."""
        if steps == self.steps_run:
            return self
        return rollout_metrics(self.rollout.first(steps), self.hd_map, self.own_from)

    def same_verdict(self, other: RolloutMetrics) -> bool:
        """Whether both have the same verdict, collision or not, over the steps that both have."""
        one, two = over_common_steps(self, other)
        return one.collision.nc.value == two.collision.nc.value

    @property
    def values(self) -> dict[str, Metric]:
        """Every metric by name: the keys of `recast.metrics.table.COLUMNS`, then own ones."""
        return {
            "nc": self.collision.nc,
            "nc_at_fault": self.nc_at_fault,
            "dac": self.drivable.dac,
            "ttc": self.ttc.ttc,
            "r_c": self.progress.r_c,
            "com": self.comfort.com,
            "com_driven": self.driven.com,
            "no_phantom_braking": self.braking,
            "ttc_constant_velocity": self.ttc_constant_velocity.ttc,
            "r_c_projection": self.progress.r_c_projection,
            "com_4_13": self.comfort_4_13.com,
            "com_nuplan_savgol": self.comfort_nuplan_savgol.com,
            **self.own,
        }

    def to_json(self) -> dict[str, Any]:
        """Plain data: the same rollout gives the same bytes (no times, no addresses)."""
        distance = self.drivable.distance
        outside: list[int] = []
        if distance is not None:
            outside = np.flatnonzero((distance > TOLERANCE).any(axis=1)).tolist()
        several: dict[str, Any] = {}
        if len(self.collisions) > 1:
            steps = {track_id: one.first_step for track_id, one in self.collisions.items()}
            several["first_collision_step_of"] = steps
        return {
            **{name: getattr(self, name) for name in _OF_ROLLOUT},
            "metrics": {name: metric.to_json() for name, metric in self.values.items()},
            "per_step": {
                "overlap_steps": np.flatnonzero(self.collision.overlap > TOUCHING).tolist(),
                "first_collision_step": self.collision.first_step,
                "largest_overlap_m2": float(self.collision.overlap.max()),
                "off_road_steps": outside,
                "largest_off_road_m": None if distance is None else float(distance.max()),
                "map_derived": self.map_derived,
                "route_length_m": self.progress.route_length,
                "com_driven_failed": [name for one in self.driven.failed_checks() for name in one],
                **several,
            },
            "per_cycle": {
                "plan_steps": list(self.plan_steps),
                "ttc": self.ttc.per_cycle.tolist(),
                "ttc_constant_velocity": self.ttc_constant_velocity.per_cycle.tolist(),
                "com_failed": self.comfort.failed_checks(),
                "com_4_13_failed": self.comfort_4_13.failed_checks(),
                "com_nuplan_savgol_failed": self.comfort_nuplan_savgol.failed_checks(),
            },
        }


def rollout_metrics(
    rollout: Rollout, hd_map: HdMap | None, own: Sequence[BaseMetric] = ()
) -> RolloutMetrics:
    """Compute NC, DAC, TTC, R_c and COM of a rollout of any length.

    The definitions are those of the paper as this project reads them: see `docs/metrics.md`.

    Args:
        rollout: validated rollout.
        hd_map: map of the rollout's log; without one DAC has no value.
        own: own metrics, see `own_metrics`.

    Raises:
        InputError: an own metric fails, or returns something else than a finite number.
    """
    ego_boxes, dt = rollout.ego_boxes, rollout.dt
    steps = np.asarray(rollout.plan_steps, np.int64)
    actors = rollout_actors(rollout)
    shapes = [(actor.states, actor.size) for actor in actors]
    collisions = rollout_collisions(rollout)
    collision = any_collision(list(collisions.values()))

    def ttc(future: Callable[[Array, Array, float], Array]) -> TimeToCollision:
        return least_time(
            [
                time_to_collision(
                    rollout.ego[steps, :3],
                    rollout.predictions,
                    rollout.ego_size,
                    rollout.ego_centre_offset,
                    future(actor.states, steps, dt),
                    actor.size,
                    steps,
                    dt,
                    actor.name,
                )
                for actor in actors
            ]
        )

    return RolloutMetrics(
        **{name: getattr(rollout, name) for name in _OF_ROLLOUT},
        plan_steps=tuple(int(step) for step in steps),
        map_derived=None if hd_map is None else hd_map.derived,
        collision=collision,
        collisions=collisions,
        nc_at_fault=no_collision_at_fault(
            list(collisions.values()), rollout.ego, [actor.states for actor in actors]
        ),
        braking=no_phantom_braking(
            rollout.ego, rollout.ego_size, rollout.ego_centre_offset, shapes, rollout.route, dt
        ),
        drivable=drivable_area_compliance(ego_boxes, rollout.ego_size, drivable_region(hd_map), dt),
        ttc=ttc(realised_future),
        ttc_constant_velocity=ttc(constant_velocity_future),
        progress=route_completion(rollout.ego, rollout.route, collision.first_step),
        comfort=com_hugsim(rollout.predictions, dt),
        comfort_4_13=com_4_13(rollout.predictions, dt),
        comfort_nuplan_savgol=com_nuplan_savgol(rollout.predictions, dt),
        driven=com_driven(rollout.ego, dt),
        rollout=rollout,
        hd_map=hd_map,
        own=_own_scores(rollout, hd_map, own),
        own_from=tuple(own),
    )


def rollout_collisions(rollout: Rollout) -> dict[str, Collision]:
    """NC with each controlled actor, by track id, the target first."""
    return {
        actor.track_id: no_collision(
            rollout.ego_boxes, rollout.ego_size, actor.states, actor.size, rollout.dt, actor.name
        )
        for actor in rollout_actors(rollout)
    }


def contacts_of_others(rollout: Rollout) -> list[tuple[str, str, int]]:
    """Track ids of two road users that touch, and the first step: neither of them is the ego.

    Replayed traffic does not give way to the target; that which gives way may be unable to.
    """
    found = []
    for one, other in combinations(rollout_actors(rollout), 2):
        away = np.linalg.norm(one.states[:, :2] - other.states[:, :2], axis=1)
        near = away <= (np.hypot(*one.size[:2]) + np.hypot(*other.size[:2])) / 2
        if not near.any():
            continue
        common = bev_overlap_area(one.states[:, :3], one.size, other.states[:, :3], other.size)
        if common.max() > TOUCHING:
            found.append((one.track_id, other.track_id, int(np.argmax(common > TOUCHING))))
    return found


def least_gaps(rollout: Rollout) -> Array:
    """Metres (S+1,) between the outlines of the ego and the nearest controlled actor; 0 where they
    overlap."""
    gaps = [
        box_gaps(rollout.ego_boxes, rollout.ego_size, actor.states, actor.size)
        for actor in rollout_actors(rollout)
    ]
    return np.min(gaps, axis=0)


class RolloutActor(NamedTuple):
    """A controlled actor as the metrics see it.

    Attributes:
        category: category, see `Track.category` and `Rollout.category`.
        states: (S+1, 4) x, y, heading of the box centre, speed.
        size: (3,) length, width, height, metres.
    """

    track_id: str
    name: str
    category: str
    states: Array
    size: Array


def rollout_actors(rollout: Rollout) -> list[RolloutActor]:
    """All controlled ones, the target first."""
    target = RolloutActor(
        rollout.track_id, "the actor", rollout.category, rollout.actor, rollout.actor_size
    )
    further = (
        RolloutActor(one.track_id, f"actor {one.track_id}", one.category, one.states, one.size)
        for one in rollout.controlled
    )
    return [target, *further]
