"""Proposals of PDM-Closed: its settings, the driver model along each path, the emergency brake."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray, Int64Array
from recast.dynamics import IdmParameters, TrackerConfig, VehicleParameters, idm_step
from recast.dynamics import state as ego
from recast.dynamics.state import PDM_BATCH
from recast.dynamics.tracker import DEFAULT, PDM_REFERENCE
from recast.geometry import se2
from recast.planning.pdm.centreline import Centreline
from recast.planning.pdm.forecast import STRIDE, Forecast, box_corners

DT = 0.1
"""Seconds per step. Its windows and look-aheads are counted in steps of this length."""
_MAX_SPEED = 5.0
_MAX_TIME = 2.0
_MIN_ACCELERATION, _MAX_ACCELERATION = -4.05, 2.4
_CRAWL = 0.2


@dataclass(frozen=True)
class PdmConfig:
    """Settings of PDM-Closed; the defaults are the published planner's.

    `reference_quirks` reproduces tuplan_garage to the last digit, its slips included. Off:

    - Lead: known from the first step on. The reference takes a standing lead at its own bumper for
      one step, which brakes with 3 m/s^2 for 0.1 s in every plan.
    - Lead of one proposal: its own. The reference carries speed and length over from the proposal
      before where it does not set them.
    - End of the route: the front bumper stops there, not half the ego's length from the rear axle.
    - Speed of a proposal: never below zero.
    - Corridor: begins and ends where it should, not at the nearest vertices of the centreline.
    - Simulation: nuPlan's jerk matrix instead of the defective one.
    - Comfort: nuPlan's smoothing windows, not one over the whole proposal.
    - Map: all of it, not only what comes within 50 m of the ego.
    - Equal scores: the path nearest to the ego wins, then the slower proposal. The reference takes
      the first in its list, the right-hand one before the left-hand one.
    - Emergency brake: never backwards and, at a crawl, never forwards; see `brake_plan`.

    Attributes:
        lateral_offsets: metres to the left of the centreline, of the paths beside it.
        speed_fractions: target speeds as shares of the speed limit.
        default_speed_limit: m/s, where the lane has none.
        proposal_steps: steps of a proposal, which is simulated and scored.
        plan_steps: steps of the plan, to which the best proposal is extended.
        radius: metres around the ego in which road users (and, with the quirks, the map) count.
    """

    reference_quirks: bool = False
    lateral_offsets: tuple[float, ...] = (-1.0, 1.0)
    speed_fractions: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8, 1.0)
    default_speed_limit: float = 15.0
    idm: IdmParameters = PDM_BATCH
    proposal_steps: int = 40
    plan_steps: int = 80
    radius: float = 50.0

    @property
    def tracker(self) -> TrackerConfig:
        """The controller in the simulation of proposals."""
        return PDM_REFERENCE if self.reference_quirks else DEFAULT


class Unroll:
    """IDM states of all proposals; proposal = path index * number of speeds + speed index.

    Attributes:
        states: (P, plan_steps + 1, 2) progress in metres and speed in m/s.
        leads: (P, plan_steps + 1, 3) the lead's progress, speed, and the length to take off the
            gap, as used for the step to that index.

    Args:
        targets: (S,) target speeds in m/s, positive.
        state: (11,) state of the ego; starts each proposal at its projection, at its speed vx.
    """

    def __init__(
        self,
        paths: Sequence[Centreline],
        targets: ArrayLike,
        forecast: Forecast,
        state: ArrayLike,
        vehicle: VehicleParameters,
        config: PdmConfig,
    ) -> None:
        state = np.asarray(state, np.float64)
        self._paths, self._forecast = paths, forecast
        self._vehicle, self._config = vehicle, config
        speeds = np.asarray(targets, np.float64)
        self._per_path = len(speeds)
        self._targets = np.tile(speeds, len(paths))
        quirks = config.reference_quirks
        self._lengths = np.array([path.length for path in paths])
        self._reach = vehicle.length / 2 if quirks else vehicle.front_length
        shape = (len(self._targets), config.plan_steps + 1)
        self.states, self.leads = np.zeros((*shape, 2)), np.zeros((*shape, 3))
        start = np.array([float(path.project(state[ego.POSE])) for path in paths])
        self.states[:, 0, 0] = np.repeat(start, self._per_path)
        self.states[:, 0, 1] = state[ego.VX]
        reach = speeds.max() * config.plan_steps * DT
        stretches = [
            path.stretch(s, s + reach, vertices_only=quirks)
            for path, s in zip(paths, start, strict=True)
        ]
        self._corridors = shapely.buffer(stretches, vehicle.width / 2, cap_style="square")
        shapely.prepare(self._corridors)
        self._advance(np.arange(len(self._targets)), 1, config.proposal_steps)

    def extend(self, proposal: int) -> None:
        """Unroll one proposal to the length of a plan."""
        first = self._config.proposal_steps + 1
        self._advance(np.array([proposal]), first, self._config.plan_steps)

    def poses(self, proposals: Sequence[int], steps: int) -> Array:
        """World poses (len(proposals), steps + 1, 3) of the rear axle on the paths."""
        rows = np.asarray(proposals)
        return self._on_paths(rows, self.states[rows, : steps + 1, 0])

    def _on_paths(self, rows: Int64Array, progress: Array) -> Array:
        """Poses (R, ..., 3) at progress (R, ...) of some proposals (R,), each on its own path."""
        found = np.empty((*progress.shape, 3))
        which = rows // self._per_path
        for i in set(which.tolist()):
            found[which == i] = self._paths[i].at(progress[which == i])
        return found

    def _advance(self, rows: Int64Array, first: int, last: int) -> None:
        """Unroll some proposals (R,) side by side, from one step to another."""
        config, targets = self._config, self._targets[rows]
        offset = first // STRIDE
        places = self._places(np.unique(rows // self._per_path), offset, last // STRIDE)
        state, lead = self.states[rows, first - 1], self.leads[rows, first - 1]
        for step in range(first, last + 1):
            if step % STRIDE == 0 or (step == 1 and not config.reference_quirks):
                lead = self._lead(rows, state[:, 0], places[:, step // STRIDE - offset], step)
            state = idm_step(state, lead, targets, config.idm, DT)
            if not config.reference_quirks:
                np.maximum(state[:, 1], 0.0, out=state[:, 1])
            self.states[rows, step], self.leads[rows, step] = state, lead

    def _places(self, paths: Int64Array, first: int, last: int) -> Array:
        """Where obstacles are along the paths: progress (all paths, maps, n) of their centroids.

        Minus infinity for other paths, and outside of the corridor.

        Args:
            paths: (K,) indices.
            first, last: maps of the forecast, both included.
        """
        forecast, shapes = self._forecast, self._forecast.polygons[first : last + 1]
        places = np.full((len(self._paths), *shapes.shape), -np.inf)
        stands = forecast.speeds == 0.0
        # What stands is at one place in all maps: there it is looked for once.
        for columns, maps in ((stands, shapes[:1]), (~stands, shapes)):
            inside = shapely.intersects(self._corridors[paths, None, None], maps[:, columns])
            inside &= ~forecast.ignored[columns]
            for i, found in zip(paths.tolist(), inside, strict=True):
                centres = shapely.get_coordinates(shapely.centroid(maps[:, columns][found]))
                progress = np.full(found.shape, -np.inf)
                progress[found] = self._paths[i].project(centres)
                places[i][:, columns] = progress
        return places

    def _lead(self, rows: Int64Array, before: Array, places: Array, step: int) -> Array:
        """The leads (R, 3) of proposals at progress (R,), by `_places` (all paths, n) at a step."""
        path = rows // self._per_path
        lead = np.zeros((len(rows), 3))
        lead[:, 0] = self._lengths[path]
        lead[:, 2] = self._reach
        ahead = places[path] > before[:, None]
        follows = np.asarray(ahead.any(axis=1))
        if not follows.any():
            return lead
        forecast, shapes = self._forecast, self._forecast.at(step)
        followers = np.flatnonzero(follows)
        poses = self._on_paths(rows[followers], before[followers])
        outlines = shapely.polygons(box_corners(poses, self._vehicle))
        gaps = np.full((len(followers), len(shapes)), np.inf)
        i, k = np.nonzero(ahead[followers])
        gaps[i, k] = shapely.distance(outlines[i], shapes[k])
        nearest = gaps.argmin(axis=1)
        lead[followers, 0] = before[followers] + gaps.min(axis=1)
        lead[followers, 1] = forecast.speeds[nearest] * np.cos(
            poses[:, 2] - forecast.headings[nearest]
        )
        lead[followers, 2] = 0.0
        red = np.zeros(len(rows), np.bool_)
        red[followers] = forecast.red[nearest]
        lead[red, 1] = 0.0
        if self._config.reference_quirks:
            lead[:, 1] = _carried_over(lead[:, 1], ~red, path)
            lead[:, 2] = _carried_over(lead[:, 2], ~follows, path)
        return lead


def _carried_over(values: Array, given: BoolArray, path: Int64Array) -> Array:
    """Values (R,) where given, else the last given one before on the same path, else 0.

    Args:
        path: (R,) indices, not falling.
    """
    last = np.maximum.accumulate(np.where(given, np.arange(len(values)), -1))
    return np.where(last >= np.searchsorted(path, path), values[last], 0.0)


def brakes(speed: float, collision_time: float) -> bool:
    """Whether to brake: at 5 m/s or less, within 2 s of the best proposal's at-fault collision."""
    return speed <= _MAX_SPEED and collision_time <= _MAX_TIME


def brake_plan(state: Array, steps: int, dt: float, *, reference_quirks: bool) -> Array:
    """Poses (steps + 1, 3) straight ahead at a constant speed near zero.

    From the speed v, at more than 0.2 m/s: 1.1 (v + clip(-10 v, -4.05, 2.4)), else, with the
    acceleration a, clip(-4 v - a, -4.05, 2.4). Below 4.05 m/s the former is negative: the
    reference creeps backwards. With quirks off, speeds below zero are 0, and so is all of the
    latter, which would start a standing ego that has just braked.

    Args:
        state: (11,) state of the ego.
    """
    speed, acceleration = float(state[ego.VX]), float(state[ego.AX])
    if speed > _CRAWL:
        change = np.clip(-10.0 * speed, _MIN_ACCELERATION, _MAX_ACCELERATION)
        target = 1.1 * (speed + change)
    else:
        target = np.clip(-4.0 * speed - acceleration, _MIN_ACCELERATION, _MAX_ACCELERATION)
    if not reference_quirks:
        target = max(target, 0.0) if speed > _CRAWL else 0.0
    ahead = np.zeros((steps + 1, 3))
    ahead[:, 0] = target * dt * np.arange(steps + 1)
    return se2.compose(state[ego.POSE], ahead)
