"""A planner on recorded drives: against what was driven, and against itself on rendered images.

At the times and poses of the recorded images, with ego and traffic as they were, a planner gets
those images and plans. Its plans are compared with the recorded next 4 s, by speed and by what is
ahead, and with its own plans on images that are a little disturbed. `evaluate_plans` compares them
with its plans on what a reconstruction shows in their place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.actors import Actor, insert
from recast.arrays import Array, Image
from recast.core.diagnostics import Progress
from recast.core.files import atomic_folder, write_json, write_text
from recast.core.foreign import whole
from recast.dynamics import PACIFICA, VehicleParameters
from recast.dynamics import state as ego
from recast.logs import DrivingLog
from recast.metrics.plan_agreement import (
    MOVED,
    WORST,
    Detector,
    PlanAgreement,
    mask_renderer,
    plan_agreement,
    renderer_of,
    write_agreement,
)
from recast.metrics.table import rounded
from recast.planning import BasePlanner, Planner
from recast.reconstruction import SceneConfig
from recast.reconstruction.views import is_held_out
from recast.reporting.page import PageAssets, render_template
from recast.reporting.report import agreement_view
from recast.reporting.tables import agreement_cells
from recast.scene import StreetScene
from recast.simulation.recorded_drive import (
    DISTURBANCES,
    Ahead,
    Images,
    RecordedDrive,
    disturbed,
    draw_paths,
    leaves_lane,
    stops,
    what_is_ahead,
)

METRICS_FILE = "metrics.json"
_SPEEDS = (3.0, 8.0)  # m/s between slow, town and fast


@dataclass(frozen=True)
class PlanMoment:
    """One moment of a drive: what the planner planned, and what was driven.

    Attributes:
        log: name of the log.
        timestamp_us: log time.
        speed: m/s that the ego drove.
        ahead: what is ahead within 60 m: nothing (free), or the nearest vehicle.
        ade, fde: metres between plan and recorded positions, mean over the 40 waypoints and at the
            last (4 s).
        stops, driver_stops: whether plan and driver come below 0.5 m/s within 4 s.
        leaves: whether the plan goes more than 1.5 m beside the recorded path.
        moved: metres at 4 s by which each disturbance of the images moves the plan.
    """

    log: str
    timestamp_us: int
    speed: float
    ahead: Ahead
    ade: float
    fde: float
    stops: bool
    driver_stops: bool
    leaves: bool
    moved: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class DrivingScores:
    """Means over the moments of one kind.

    Attributes:
        kind: "all", what is ahead, or a range of speeds.
        moments: how many.
        ade, fde: means, metres.
        stops_alone: share of the moments in which the driver goes on where the plan stops; None
            where no driver goes on.
        goes_alone: the reverse; None where no driver stops.
        leaves: share of plans that leave the recorded lane.
        moved: share of plans moved by more than 2 m, by disturbance.
    """

    kind: str
    moments: int
    ade: float
    fde: float
    stops_alone: float | None
    goes_alone: float | None
    leaves: float
    moved: Mapping[str, float]


@dataclass(frozen=True)
class PlannerDriving:
    """A planner on recorded drives: its moments, and their means."""

    planner: str
    moments: tuple[PlanMoment, ...]

    @property
    def scores(self) -> list[DrivingScores]:
        """Over all moments, by what is ahead, and by speed; without empty kinds."""
        slow, fast = _SPEEDS
        kinds: dict[str, Callable[[PlanMoment], bool]] = {"all": lambda one: True}
        for ahead in ("free", "leading", "standing", "oncoming", "crossing"):
            kinds[ahead] = lambda one, ahead=ahead: one.ahead == ahead  # type: ignore[misc]
        kinds[f"below {slow:g} m/s"] = lambda one: one.speed < slow
        kinds[f"{slow:g} to {fast:g} m/s"] = lambda one: slow <= one.speed < fast
        kinds[f"from {fast:g} m/s"] = lambda one: one.speed >= fast
        found = ((kind, [one for one in self.moments if of(one)]) for kind, of in kinds.items())
        return [_scores(kind, moments) for kind, moments in found if moments]

    @property
    def lead(self) -> str:
        """What was found, in a sentence."""
        one = self.scores[0]
        said = f"At {one.moments} moments its plans end {one.fde:.1f} m from what was driven"
        if one.stops_alone is None:
            return f"{said}; the driver never went on."
        return f"{said}; it stops in {one.stops_alone:.0%} of those in which the driver goes on."

    def to_json(self) -> dict[str, Any]:
        """Plain data, rounded to six decimals."""
        scores = [asdict(one) for one in self.scores]
        moments = [asdict(one) for one in self.moments]
        found = {"version": 1, "planner": self.planner, "scores": scores, "moments": moments}
        return dict(rounded(found))


def _scores(kind: str, moments: Sequence[PlanMoment]) -> DrivingScores:
    def share(flags: Sequence[bool]) -> float | None:
        return float(np.mean(flags)) if flags else None

    return DrivingScores(
        kind,
        len(moments),
        float(np.mean([one.ade for one in moments])),
        float(np.mean([one.fde for one in moments])),
        share([one.stops for one in moments if not one.driver_stops]),
        share([not one.stops for one in moments if one.driver_stops]),
        float(np.mean([one.leaves for one in moments])),
        {
            name: float(np.mean([one.moved[name] > MOVED for one in moments]))
            for name in moments[0].moved
        },
    )


def evaluate_planner(
    planner: Planner,
    logs: Sequence[DrivingLog],
    out: Path,
    *,
    every: float = 0.5,
    seed: int = 0,
    vehicle: VehicleParameters = PACIFICA,
    progress: Progress | None = None,
) -> PlannerDriving:
    """Let a planner plan at the moments of recorded drives.

    Writes `metrics.json` and a page, `index.html`, with the ten moments of the largest FDE, both
    paths drawn in, to `out`, whole or not at all. A planner that remembers gets the moments of a
    drive in their order, with a call of `reset` before the first.

    Args:
        every: seconds between moments.
        seed: seed of the planner's random numbers.

    Raises:
        InputError: a log without a route, without a moment with 4 s ahead of it, or without the
            cameras that the planner needs; or `out` exists.
        ValueError: the planner's answer is no plan.
    """
    planner = whole(planner, BasePlanner)
    moments: list[PlanMoment] = []
    worst: list[tuple[PlanMoment, Image]] = []
    with atomic_folder(out) as partial:
        for index, log in enumerate(logs):
            drive = RecordedDrive(log, planner, vehicle, seed)
            for moment, picture in _of_drive(drive, planner, every):
                moments.append(moment)
                if picture is not None:
                    worst = sorted([*worst, (moment, picture)], key=lambda one: -one[0].fde)
                    worst = worst[:WORST]
            if progress is not None:
                progress(index + 1, len(logs))
        found = PlannerDriving(planner.name, tuple(moments))
        write_json(partial / METRICS_FILE, found.to_json())
        write_text(partial / "index.html", _page(found, logs, worst, PageAssets(partial)))
    return found


def _page(
    found: PlannerDriving,
    logs: Sequence[DrivingLog],
    worst: Sequence[tuple[PlanMoment, Image]],
    assets: PageAssets,
) -> str:
    starts = {log.name: int(log.world_from_rig.timestamps_us[0]) for log in logs}
    pictures = [
        {
            "media": assets.photo(one.log, picture),
            "told": f"{one.log}, {(one.timestamp_us - starts[one.log]) * 1e-6:.1f} s, at "
            f"{one.speed:.1f} m/s, {one.ahead}: FDE {one.fde:.1f} m",
        }
        for one, picture in worst
    ]
    names, rows = driving_cells(found)
    return render_template(
        "driving.html",
        planner=found.planner,
        lead=found.lead,
        logs=list(starts),
        names=names,
        rows=rows,
        pictures=pictures,
    )


def _of_drive(
    drive: RecordedDrive, planner: BasePlanner, every: float
) -> Iterator[tuple[PlanMoment, Image | None]]:
    """The moments of one drive, each with a picture of it if the planner uses images."""
    times = drive.times(every)
    ends: dict[str, list[Array]] = {}
    # A drive for each: a planner that remembers has seen nothing else.
    for name in DISTURBANCES if drive.names else ():

        def changed(index: int, time_us: int, name: str = name) -> Images:
            return disturbed(name, drive.images(time_us), index)

        ends[name] = [plan[-1, :2] for _, plan in drive.plans(planner, times, changed)]
    for index, (seen, plan) in enumerate(drive.plans(planner, times)):
        recorded = drive.driven(times[index])
        apart = np.linalg.norm(plan[:, :2] - recorded[:, :2], axis=1)
        moment = PlanMoment(
            drive.log.name,
            times[index],
            float(seen.ego[ego.VX]),
            what_is_ahead(seen, drive.route),
            float(apart.mean()),
            float(apart[-1]),
            stops(plan),
            stops(recorded),
            leaves_lane(plan, recorded),
            {k: float(np.linalg.norm(plan[-1, :2] - end[index])) for k, end in ends.items()},
        )
        paths = {_DRIVEN: recorded, _PLAN: plan}
        yield moment, draw_paths(drive, seen.images, paths) if drive.names else None


_DRIVEN, _PLAN = (44, 160, 44), (214, 39, 40)  # green and red


def driving_table(found: PlannerDriving) -> Table:
    """For the terminal."""
    title = f"{found.planner} on recorded images"
    return _table(title, *driving_cells(found), ends=("all", "crossing"))


def driving_cells(found: PlannerDriving) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of the table."""
    moved = list(found.scores[0].moved)
    names = ["kind", "n", "ADE m", "FDE m", "stops alone %", "goes alone %", "off lane %"]
    names += [f"moved by {name} %" for name in moved]

    def share(value: float | None) -> str:
        return "-" if value is None else f"{100 * value:.0f}"

    rows = []
    for one in found.scores:
        shares = [one.stops_alone, one.goes_alone, one.leaves, *(one.moved[name] for name in moved)]
        told = [one.kind, str(one.moments), f"{one.ade:.1f}", f"{one.fde:.1f}"]
        rows.append([*told, *map(share, shares)])
    return names, rows


def evaluate_plans(
    planner: Planner,
    log: DrivingLog,
    scene: StreetScene,
    actors: Sequence[Actor],
    out: Path,
    *,
    training: SceneConfig | None = None,
    every: float = 0.5,
    seed: int = 0,
    detector: Detector | None = None,
    vehicle: VehicleParameters = PACIFICA,
    progress: Progress | None = None,
) -> PlanAgreement:
    """Compare a planner's plans on rendered images with those on the recorded ones.

    Writes `metrics.json` and a page, `index.html`, with a table, a plot and the ten moments of the
    largest difference to `out`, whole or not at all.

    Args:
        scene: street of the log; its arm is "reconstructed".
        actors: vehicles that take the place of tracks in the arm "replaced"; none: no such arm. The
            parts of an arm are measured with the first.
        training: settings that the street was trained with, which say what was held out and how
            large the images are; None: whole images, and nobody knows.
        every: seconds between moments.
        seed: seed of the planner's random numbers.

    Raises:
        InputError: see `plan_agreement`; or `out` exists.
    """
    planner = whole(planner, BasePlanner)
    scale, cameras = (1.0, ()) if training is None else (training.scale, training.cameras)
    drive = RecordedDrive(log, planner, vehicle, seed, cameras, scale)
    streets = {"reconstructed": scene}
    if actors:
        streets["replaced"] = reduce(insert, actors, scene)
    target = actors[0].track_id if actors else None
    with atomic_folder(out) as partial:
        found, pictures = plan_agreement(
            planner,
            drive,
            {arm: renderer_of(street, drive.mounts) for arm, street in streets.items()},
            every=every,
            masks={arm: mask_renderer(one, target, drive.mounts) for arm, one in streets.items()},
            held_out=lambda _, frame: None if training is None else is_held_out(frame, training),
            detector=detector,
            progress=progress,
        )
        write_agreement(found, pictures, partial)
        assets = PageAssets(partial)
        page = render_template("plans.html", agreement=agreement_view(found, partial, assets))
        write_text(partial / "index.html", page)
    return found


def agreement_table(found: PlanAgreement) -> Table:
    """For the terminal."""
    title = f"{found.planner} on rendered images of {found.log}, against the recorded ones"
    return _table(title, *agreement_cells(found), unbroken=True)


def _table(
    title: str,
    names: Sequence[str],
    rows: Sequence[Sequence[str]],
    ends: Sequence[str] = (),
    unbroken: bool = False,
) -> Table:
    """Rows of figures behind a name, unbroken or not; a line below those called as in `ends`."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    for index, name in enumerate(names):
        table.add_column(name, justify="right" if index else "left", no_wrap=unbroken and not index)
    for row in rows:
        table.add_row(*row, end_section=row[0] in ends)
    return table
