"""How a planner drives: its plans on the recorded images of drives against what was driven.

At the times and poses of the recorded images, with ego and traffic as they were, a planner gets
those images and plans. Its plans are compared with the recorded next 4 s, by speed and by what is
ahead, and with its own plans on images that are a little disturbed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.arrays import Array, Image
from recast.cameras import CameraMount
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json, write_text
from recast.core.foreign import whole
from recast.dynamics import PACIFICA, EgoState, VehicleParameters, initial_state
from recast.dynamics import state as ego
from recast.geometry import se2, se3
from recast.logs import DrivingLog, map_of
from recast.logs.types import CameraStream
from recast.metrics.table import rounded
from recast.planning import (
    WAYPOINTS,
    BasePlanner,
    Planner,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
    looked_at,
    planner_cameras,
    virtual_mounts,
)
from recast.reporting.page import PageAssets, render_template
from recast.simulation import camera_mounts
from recast.simulation.history import logged_past, logged_road_users
from recast.simulation.planner_calls import calling

Ahead = Literal["free", "leading", "standing", "oncoming", "crossing"]
METRICS_FILE = "metrics.json"
DISTURBANCES = ("one pixel", "one grey level", "JPEG 90")
"""How the recorded images are disturbed, besides as they are."""

_DT = 0.1
_STOPPED = 0.5  # m/s below which a path stops
_OFF_LANE = 1.5  # metres beside the recorded path at which a car of 2.3 m touches the next lane
_MOVED = 2.0  # metres at 4 s by which a plan counts as another one
_LATE = 0.06  # seconds that an image may be off the moment that it is shown at
_SPEEDS = (3.0, 8.0)  # m/s between slow, town and fast
_IN_LANE, _NEXT_LANE, _LOOK = 0.6, 5.0, 60.0  # metres across the path; ahead
_WORST = 10


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
            name: float(np.mean([one.moved[name] > _MOVED for one in moments]))
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
                    worst = worst[:_WORST]
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


class RecordedDrive:
    """What a planner would have seen at the moments of a recorded drive.

    Args:
        log: the drive.
        planner: who is asked; which cameras it looks at, virtual ones too, is its choice.

    Raises:
        InputError: the log has no route, or not the cameras that the planner needs.
    """

    def __init__(
        self, log: DrivingLog, planner: BasePlanner, vehicle: VehicleParameters, seed: int
    ) -> None:
        self.log, self.vehicle, self.foretold = log, vehicle, planner.foresees
        self.route = ReferenceRoute.from_trajectory(log.world_from_rig)
        mounts: dict[str, CameraMount] = {}
        if planner.needs_images:
            if not log.cameras:
                problem = "the log has none, but the planner uses images"
                raise InputError(log.name, "cameras", problem, "import a log with images")
            own = camera_mounts(log)
            mounts = {**own, **virtual_mounts(planner, own)}
        self.names = planner_cameras(planner, mounts)
        windows = looked_at(planner, mounts) if mounts else {}
        self.mounts = {name: windows[name] for name in self.names}
        self._sources = {
            name: list(_sources(log, mount, name)) for name, mount in self.mounts.items()
        }
        self.context = PlanningContext(
            route=self.route,
            log=log.world_from_rig,
            map=map_of(log),
            vehicle=vehicle,
            cameras=self.mounts,
            dt=_DT,
            seed=seed,
        )

    def times(self, every: float) -> list[int]:
        """Log times, `every` seconds apart, with 4 s ahead of them: of images, if any are seen.

        Raises:
            InputError: there is none.
        """
        first, last = (int(one) for one in self.log.world_from_rig.timestamps_us[[0, -1]])
        first, last = first + round(_DT * 1e6), last - round(WAYPOINTS * _DT * 1e6)
        there = np.arange(first, last + 1, round(every * 1e6))
        if self.names:
            there = self._sources[self.names[0]][0].stream.timestamps_us
        chosen: list[int] = []
        for time in there[(there >= first) & (there <= last)]:
            if not chosen or time - chosen[-1] >= every * 1e6 - 1e3:
                chosen.append(int(time))
        if not chosen:
            problem = f"no moment has {WAYPOINTS * _DT:g} s of the drive ahead of it"
            raise InputError(self.log.name, "world_from_rig", problem, "use a longer log")
        return chosen

    def observation(self, index: int, time_us: int) -> PlannerInput:
        """What the planner sees at a time."""
        log = self.log.world_from_rig
        now = initial_state(log.timestamps_us, log.poses, time_us, self.vehicle)
        past = logged_past(log, time_us, _DT, self.vehicle)
        at_time = self.route.at_time(time_us)
        near = None if at_time is None else float(at_time)
        return PlannerInput(
            step=index,
            timestamp_us=time_us,
            ego=EgoState(now),
            ego_history=np.stack([*past, now]),
            actors=logged_road_users(self.log.tracks.values(), time_us, _DT, self.foretold),
            command=self.route.command(now, near),
            images=self.images(time_us),
            route_s=float(self.route.project(now, near)[0]),
        )

    def driven(self, time_us: int) -> Array:
        """(40, 3) recorded poses 0.1 to 4 s later, in the ego frame of the time."""
        times = time_us + round(_DT * 1e6) * np.arange(WAYPOINTS + 1)
        poses = se2.from_se3(self.log.world_from_rig.at(times))
        return se2.relative(poses[0], poses[1:])

    def images(self, time_us: int) -> dict[str, Image]:
        """The recorded images as the planner's cameras show them; black where none looked."""
        return {
            name: self.mounts[name].masked(_warped(self.mounts[name], sources, time_us))
            for name, sources in self._sources.items()
        }


@dataclass(frozen=True)
class _Source:
    """Where the pixels of a camera lie in the images of one of the log's."""

    stream: CameraStream
    across: Array  # (H, W) float32, as OpenCV counts
    down: Array
    inside: Array  # (H, W) bool


def _sources(log: DrivingLog, mount: CameraMount, name: str) -> Iterator[_Source]:
    """The log's cameras that see something of a camera, best first.

    Directions only: places are taken to be the same.
    """
    rays = mount.camera.rays(mount.camera.pixel_grid()) @ mount.rig_from_camera[:3, :3].T
    found = []
    for key, stream in log.cameras.items():
        pixels, depth = stream.camera.project(rays @ stream.rig_from_camera[:3, :3])
        size = np.array([stream.camera.width, stream.camera.height])
        inside = (depth > 0) & np.all((pixels >= 0) & (pixels <= size), axis=-1)
        if inside.any():
            u, v = np.moveaxis(pixels.astype(np.float32) - np.float32(0.5), -1, 0)
            own = key in (name, mount.source)
            found.append((not own, -inside.mean(), key, _Source(stream, u, v, inside)))
    yield from (one for *_, one in sorted(found, key=lambda one: one[:3]))


def _warped(mount: CameraMount, sources: Sequence[_Source], time_us: int) -> Image:
    """The image (H, W, 3) of a camera from the recorded images nearest to a time."""
    image = np.zeros((mount.camera.height, mount.camera.width, 3), np.uint8)
    filled = np.zeros(image.shape[:2], np.bool_)
    for source in sources:
        if filled.all():
            break
        times = source.stream.timestamps_us
        frame = int(np.abs(times - time_us).argmin())
        if abs(int(times[frame]) - time_us) > _LATE * 1e6:
            continue
        recorded = np.ascontiguousarray(source.stream.images[frame])
        edge = cv2.BORDER_REPLICATE
        shown = cv2.remap(recorded, source.across, source.down, cv2.INTER_LINEAR, borderMode=edge)
        new = source.inside & ~filled
        image[new], filled = shown[new], filled | new
    return image


def _of_drive(
    drive: RecordedDrive, planner: BasePlanner, every: float
) -> Iterator[tuple[PlanMoment, Image | None]]:
    """The moments of one drive, each with a picture of it if the planner uses images."""
    with calling(planner, None) as calls:
        calls.reset(drive.context)
        for index, time_us in enumerate(drive.times(every)):
            seen = drive.observation(index, time_us)
            plan = calls.timed_plan(seen, None)[0].waypoints
            moved = {
                name: _end_apart(plan, calls.timed_plan(other, None)[0].waypoints)
                for name, other in _disturbed(seen)
            }
            recorded = drive.driven(time_us)
            apart = np.linalg.norm(plan[:, :2] - recorded[:, :2], axis=1)
            moment = PlanMoment(
                drive.log.name,
                time_us,
                float(seen.ego[ego.VX]),
                what_is_ahead(seen, drive.route),
                float(apart.mean()),
                float(apart[-1]),
                _stops(plan),
                _stops(recorded),
                _beside(plan, recorded) > _OFF_LANE,
                moved,
            )
            yield moment, _picture(drive, seen, plan, recorded) if drive.names else None
        calls.finish()


def _disturbed(seen: PlannerInput) -> Iterator[tuple[str, PlannerInput]]:
    """The same moment with images that a camera might as well have taken."""
    if not seen.images:
        return
    random = np.random.default_rng(seen.step)

    def grey(image: Image) -> Image:
        noise = random.integers(-1, 2, image.shape)
        return np.clip(image.astype(np.int64) + noise, 0, 255).astype(np.uint8)

    def compressed(image: Image) -> Image:
        done, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
        assert done
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)[..., ::-1]

    def shifted(image: Image) -> Image:
        return np.concatenate([image[:, :1], image[:, :-1]], axis=1)

    for name, change in zip(DISTURBANCES, (shifted, grey, compressed), strict=True):
        images = {key: np.ascontiguousarray(change(one)) for key, one in seen.images.items()}
        yield name, replace(seen, images=images)


def _end_apart(plan: Array, other: Array) -> float:
    return float(np.linalg.norm(plan[-1, :2] - other[-1, :2]))


def _stops(path: Array) -> bool:
    """Whether a path (40, 3) from the origin comes below 0.5 m/s."""
    steps = np.diff(np.concatenate([np.zeros((1, 2)), path[:, :2]]), axis=0)
    return bool(np.linalg.norm(steps, axis=1).min() < _STOPPED * _DT)


def _beside(plan: Array, recorded: Array) -> float:
    """Largest metres of a plan (40, 3) beside a recorded path (40, 3), which goes on straight."""
    line = np.concatenate([np.zeros((1, 3)), recorded])
    ahead = np.array([np.cos(line[-1, 2]), np.sin(line[-1, 2])])
    ends = line[-1, :2] + np.outer(np.linspace(1.0, 60.0, 60), ahead)
    dense = np.concatenate([line[:, :2], ends])
    pieces = np.linspace(dense[:-1], dense[1:], 6).reshape(-1, 2)
    apart = np.linalg.norm(plan[:, None, :2] - pieces[None], axis=-1).min(axis=1)
    return float(apart.max())


def what_is_ahead(seen: PlannerInput, route: ReferenceRoute) -> Ahead:
    """What the nearest vehicle ahead does, within 60 m along the recorded path.

    On the path, if its box comes within 0.6 m of the middle: leading, standing (below 0.5 m/s),
    crossing, or oncoming. In the next lane, within 5 m: oncoming alone.
    """
    if seen.route_s is None or not seen.actors:
        return "free"
    poses = np.array([one.pose for one in seen.actors])
    s, lateral = route.project(poses, np.full(len(poses), seen.route_s), _LOOK)
    best: tuple[float, Ahead] = (_LOOK, "free")
    for one, along, beside in zip(seen.actors, s - seen.route_s, lateral, strict=True):
        if not 0.0 < along < best[0]:
            continue
        turned = abs(float(se2.wrap_angle(one.pose[2] - route.heading(along + seen.route_s))))
        speed = float(np.hypot(*one.velocity))
        towards = turned > np.radians(135.0) and speed > _STOPPED
        half = abs(np.sin(turned)) * one.size[0] / 2 + abs(np.cos(turned)) * one.size[1] / 2
        if abs(beside) - half < _IN_LANE:
            kind: Ahead = "leading"
            if speed <= _STOPPED:
                kind = "standing"
            elif towards:
                kind = "oncoming"
            elif turned > np.radians(45.0):
                kind = "crossing"
            best = (float(along), kind)
        elif towards and abs(beside) < _NEXT_LANE:
            best = (float(along), "oncoming")
    return best[1]


_INK = {"plan": (214, 39, 40), "driven": (44, 160, 44)}


def _picture(drive: RecordedDrive, seen: PlannerInput, plan: Array, recorded: Array) -> Image:
    """(H, W, 3): the image that looks ahead most, with the driven path green and the plan red."""
    name = max(drive.mounts, key=lambda one: drive.mounts[one].rig_from_camera[0, 2])
    mount, page = drive.mounts[name], np.ascontiguousarray(seen.images[name])
    camera_from_rig = se3.inverse(mount.rig_from_camera)
    for path, ink in ((recorded, _INK["driven"]), (plan, _INK["plan"])):
        ground = np.column_stack([path[:, :2], np.zeros(len(path)), np.ones(len(path))])
        pixels, depth = mount.camera.project((ground @ camera_from_rig.T)[:, :3])
        for (u, v), far in zip(pixels, depth, strict=True):
            if far > 0.5 and np.abs([u, v]).max() < 1e5:
                cv2.circle(page, (round(float(u)), round(float(v))), 2, ink, -1)
    return page


def driving_table(found: PlannerDriving) -> Table:
    """For the terminal."""
    table = Table(
        title=f"{found.planner} on recorded images", title_justify="left", box=SIMPLE_HEAD
    )
    names, rows = driving_cells(found)
    for index, name in enumerate(names):
        table.add_column(name, justify="right" if index else "left")
    for row in rows:
        table.add_row(*row, end_section=row[0] in ("all", "crossing"))
    return table


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
