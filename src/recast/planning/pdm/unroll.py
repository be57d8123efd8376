"""Proposals: the driver model along each path at each target speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import VehicleParameters, idm_step
from recast.dynamics import state as ego
from recast.planning.pdm.footprint import box_corners
from recast.planning.pdm.forecast import STRIDE, Forecast, Kind
from recast.planning.pdm.lane_path import LanePath
from recast.planning.pdm.settings import DT, PdmConfig

Array = NDArray[np.float64]


class Unroll:
    """IDM states of all proposals; proposal = path index * number of speeds + speed index.

    Attributes:
        states: (P, plan_steps + 1, 2) progress in metres and speed in m/s.
        leads: (P, plan_steps + 1, 3) the lead's progress, speed, and the length to take off the
            gap, as used for the step to that index.

    Args:
        paths: the centreline and its parallels.
        targets: (S,) target speeds in m/s, positive.
        forecast: of the other road users.
        state: (11,) of the ego; starts each proposal at its projection, at its speed vx.
    """

    def __init__(
        self,
        paths: Sequence[LanePath],
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
        self._reach = vehicle.length / 2 if quirks else vehicle.front_length
        shape = (len(self._targets), config.plan_steps + 1)
        self.states, self.leads = np.zeros((*shape, 2)), np.zeros((*shape, 3))
        start = np.array([float(path.project(state[ego.POSE])) for path in paths])
        self.states[:, 0, 0] = np.repeat(start, self._per_path)
        self.states[:, 0, 1] = state[ego.VX]
        reach = speeds.max() * config.plan_steps * DT
        self._corridors = [
            shapely.buffer(
                path.stretch(s, s + reach, vertices_only=quirks),
                vehicle.width / 2,
                cap_style="square",
            )
            for path, s in zip(paths, start, strict=True)
        ]
        shapely.prepare(self._corridors)
        for first in range(0, len(self._targets), self._per_path):
            rows = list(range(first, first + self._per_path))
            for step in range(1, config.proposal_steps + 1):
                self._advance(rows, step)

    def extend(self, proposal: int) -> None:
        """Unroll one proposal to the length of a plan."""
        for step in range(self._config.proposal_steps + 1, self._config.plan_steps + 1):
            self._advance([proposal], step)

    def poses(self, proposals: Sequence[int], steps: int) -> Array:
        """World poses (len(proposals), steps + 1, 3) of the rear axle on the paths."""
        return np.stack(
            [self._paths[p // self._per_path].at(self.states[p, : steps + 1, 0]) for p in proposals]
        )

    def _advance(self, rows: list[int], step: int) -> None:
        config = self._config
        if step % STRIDE == 0 or (step == 1 and not config.reference_quirks):
            self._refresh(rows, step)
        else:
            self.leads[rows, step] = self.leads[rows, step - 1]
        moved = idm_step(
            self.states[rows, step - 1],
            self.leads[rows, step],
            self._targets[rows],
            config.idm,
            DT,
        )
        if not config.reference_quirks:
            moved[:, 1] = np.maximum(moved[:, 1], 0.0)
        self.states[rows, step] = moved

    def _refresh(self, rows: list[int], step: int) -> None:
        """Find the leads (rows of one path) among what is in the corridor at a step."""
        path, forecast = self._paths[rows[0] // self._per_path], self._forecast
        shapes = forecast.at(step)
        corridor = self._corridors[rows[0] // self._per_path]
        inside = np.flatnonzero(shapely.intersects(corridor, shapes) & ~forecast.ignored)
        centres = shapely.get_coordinates(shapely.centroid(shapes[inside]))
        progress = path.project(centres)
        before = self.states[rows, step - 1, 0]
        poses = path.at(before)
        outlines = shapely.polygons(box_corners(poses, self._vehicle))
        lead = np.zeros(3)
        for i, row in enumerate(rows):
            if not self._config.reference_quirks:
                lead = np.zeros(3)
            ahead = inside[progress > before[i]]
            if len(ahead) == 0:
                lead[:] = path.length, 0.0, self._reach
            else:
                gaps = shapely.distance(outlines[i], shapes[ahead])
                nearest = ahead[np.argmin(gaps)]
                lead[0] = before[i] + gaps.min()
                if forecast.kinds[nearest] is not Kind.RED_LIGHT:
                    turn = poses[i, 2] - forecast.headings[nearest]
                    lead[1] = forecast.speeds[nearest] * np.cos(turn)
            self.leads[row, step] = lead
