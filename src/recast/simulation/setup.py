"""What a rollout is asked to be."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from recast.dynamics import PACIFICA, VehicleParameters
from recast.errors import InputError
from recast.logs.hdmap import HdMap
from recast.logs.types import DrivingLog, Track
from recast.planning import WAYPOINTS
from recast.simulation.ego_controller import EgoController, LqrController
from recast.simulation.motions import ActorMotion
from recast.simulation.scenario import scenario_name

_DT = (0.05, 0.2)
"""Seconds per step, within which 40 waypoints reach 2 to 8 s: the tracker looks 1 s ahead, and no
planner plans further than 8 s."""
_MOST_STEPS = 1_000_000


@dataclass(frozen=True)
class RolloutSetup:
    """A rollout to be run.

    Attributes:
        log: the recorded drive; its map is used unless `map` is given.
        track_id: the actor to control.
        motion: what it does.
        method: what renders it, for tables; has no influence on the motion.
        map: lanes, drivable area and ground, or None for the log's.
        start_timestamp_us: log time of state 0; None for the first ego pose with 3 m/s or more that
            leaves enough log for all steps, or else the first pose.
        steps: number of steps of `dt` seconds; 160 in the paper.
        plan_every: steps between plans, K; 40 at most, since a plan has 40 waypoints.
        dt: seconds per step and between waypoints, for controller, planner, actor and metrics.
        vehicle: outline and wheelbase of the ego, for controller, planner and metrics.
        controller: executes the plans; it is told `dt` and `vehicle`.
        keep_other_actors: leave the other logged actors in, on their logged motion.
        road_margin: metres before the end of the logged road at which a rollout is cut.
        camera_names: cameras for `on_frame`, and for planners that do not say which they look at
            (see `planner_cameras`); None for all of the log.
        plan_limit_s: seconds of wall-clock time that one plan may take; a planner that takes longer
            fails the rollout. None for no limit, on which no result may depend.
    """

    log: DrivingLog
    track_id: str
    motion: ActorMotion
    method: str = "native"
    map: HdMap | None = None
    start_timestamp_us: int | None = None
    steps: int = 160
    plan_every: int = 5
    dt: float = 0.1
    vehicle: VehicleParameters = PACIFICA
    controller: EgoController = field(default_factory=LqrController)
    keep_other_actors: bool = False
    road_margin: float = 2.0
    camera_names: tuple[str, ...] | None = None
    plan_limit_s: float | None = None

    def __post_init__(self) -> None:
        for field_name, low, high in (("steps", 1, _MOST_STEPS), ("plan_every", 1, WAYPOINTS)):
            value = getattr(self, field_name)
            if not low <= value <= high:
                raise _refused(field_name, f"is {value}", f"give {low} to {high}")
        microseconds = self.dt * 1e6
        whole = math.isfinite(microseconds) and abs(microseconds - round(microseconds)) < 1e-3
        if not (whole and _DT[0] <= self.dt <= _DT[1]):
            mend = f"give whole microseconds, {_DT[0]:g} to {_DT[1]:g} s"
            raise _refused("dt", f"is {self.dt} s", mend)
        if not 0.0 <= self.road_margin < math.inf:
            raise _refused("road_margin", f"is {self.road_margin} m", "give 0 or more")

    @property
    def name(self) -> str:
        """Unique among the methods and scenarios of one track."""
        return f"{scenario_name(self.motion)}-{self.method}"

    @property
    def hdmap(self) -> HdMap | None:
        """The map in use."""
        return self.log.map if self.map is None else self.map

    @property
    def track(self) -> Track:
        """The controlled track.

        Raises:
            InputError: the log has no such track.
        """
        if self.track_id not in self.log.tracks:
            raise InputError(
                self.log.name,
                f"track {self.track_id}",
                "is not in the log",
                f"choose one of {', '.join(self.log.tracks)}",
            )
        return self.log.tracks[self.track_id]


def _refused(field_name: str, problem: str, mend: str) -> InputError:
    return InputError("RolloutSetup", field_name, problem, mend)
