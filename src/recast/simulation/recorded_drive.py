"""What a planner would have seen of a recorded drive, at the times and poses of its images."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np

from recast.arrays import Array, BoolArray, Image
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.dynamics import PACIFICA, EgoState, VehicleParameters, initial_state
from recast.geometry import se2, se3
from recast.logs import DrivingLog, map_of
from recast.logs.types import CameraStream
from recast.planning import (
    WAYPOINTS,
    BasePlanner,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
    looked_at,
    planner_cameras,
    virtual_mounts,
)
from recast.simulation.history import logged_past, logged_road_users
from recast.simulation.planner_calls import calling
from recast.simulation.renderer import SensorRenderer, camera_mounts, jittered
from recast.simulation.rollout import SimActor, SimState

Ahead = Literal["free", "leading", "standing", "oncoming", "crossing"]
Images = Mapping[str, Image]
"""Images (H, W, 3) of one moment by the names of a planner's cameras."""
DISTURBANCES: tuple[str, ...] = ("one pixel", "one grey level", "JPEG 90")
"""How recorded images are disturbed, see `disturbed`."""

_DT = 0.1
_STOPPED = 0.5  # m/s below which a path stops
_OFF_LANE = 1.5  # metres beside the recorded path at which a car of 2.3 m touches the next lane
_LATE = 0.06  # seconds that an image may be off the moment that it is shown at
_IN_LANE, _NEXT_LANE, _LOOK = 0.6, 5.0, 60.0  # metres across the path; ahead
_COARSER = 1.2  # pixels of a recorded image to one that is shown from which they are averaged


class RecordedDrive:
    """What a planner would have seen at the moments of a recorded drive.

    Args:
        log: the drive.
        planner: who is asked; which cameras it looks at, virtual ones too, is its choice.
        cameras: names of the log's cameras that there are; none named: all.
        scale: factor on the size of the images.

    Raises:
        InputError: the log has no route, or not the cameras that the planner needs.
    """

    def __init__(
        self,
        log: DrivingLog,
        planner: BasePlanner,
        vehicle: VehicleParameters = PACIFICA,
        seed: int = 0,
        cameras: Sequence[str] = (),
        scale: float = 1.0,
    ) -> None:
        self.log, self.vehicle, self.foretold = log, vehicle, planner.foresees
        self.route = ReferenceRoute.from_trajectory(log.world_from_rig)
        mounts: dict[str, CameraMount] = {}
        if planner.needs_images:
            if not any(len(stream.timestamps_us) for stream in log.cameras.values()):
                problem = "the log has none, but the planner uses images"
                raise InputError(log.name, "cameras", problem, "import a log with images")
            own = camera_mounts(log, cameras or None, scale)
            mounts = {**own, **virtual_mounts(planner, own, scale)}
        self.names = planner_cameras(planner, mounts)
        windows = looked_at(planner, mounts) if mounts else {}
        self.mounts = {name: windows[name] for name in self.names}
        streams = {
            key: log.cameras[key]
            for key in cameras or log.cameras
            if len(log.cameras[key].timestamps_us)
        }
        self._sources = {
            name: list(_sources(streams, mount, name)) for name, mount in self.mounts.items()
        }
        self._latest: tuple[int, dict[str, Image], dict[str, BoolArray]] | None = None
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
            sources = self._sources[self.names[0]]
            there = sources[0].stream.timestamps_us if sources else there[:0]
        chosen: list[int] = []
        for time in there[(there >= first) & (there <= last)]:
            if not chosen or time - chosen[-1] >= every * 1e6 - 1e3:
                chosen.append(int(time))
        if not chosen:
            problem = f"no moment has {WAYPOINTS * _DT:g} s of the drive ahead of it"
            raise InputError(self.log.name, "world_from_rig", problem, "use a longer log")
        return chosen

    def observation(self, index: int, time_us: int, images: Images | None = None) -> PlannerInput:
        """What the planner sees at a time; `images` in place of the recorded ones."""
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
            images=self.images(time_us) if images is None else dict(images),
            route_s=float(self.route.project(now, near)[0]),
        )

    def driven(self, time_us: int) -> Array:
        """(40, 3) recorded poses 0.1 to 4 s later, in the ego frame of the time."""
        times = time_us + round(_DT * 1e6) * np.arange(WAYPOINTS + 1)
        poses = se2.from_se3(self.log.world_from_rig.at(times))
        return se2.relative(poses[0], poses[1:])

    def images(self, time_us: int) -> dict[str, Image]:
        """The recorded images as the planner's cameras show them; black where none looked."""
        return dict(self._recorded(time_us)[0])

    def shown(self, time_us: int) -> dict[str, BoolArray]:
        """The pixels (H, W) of `images` that a recorded image shows."""
        return dict(self._recorded(time_us)[1])

    def _recorded(self, time_us: int) -> tuple[dict[str, Image], dict[str, BoolArray]]:
        if self._latest is None or self._latest[0] != time_us:
            images, shown = {}, {}
            for name, sources in self._sources.items():
                image, filled = _warped(self.mounts[name], sources, time_us)
                levels = np.repeat(filled[..., None].astype(np.uint8), 3, axis=-1)
                images[name] = self.mounts[name].masked(image)
                shown[name] = self.mounts[name].masked(levels)[..., 0] > 0
            self._latest = time_us, images, shown  # several renderers ask for one moment
        return self._latest[1], self._latest[2]

    def frame(self, name: str, time_us: int) -> tuple[str, int] | None:
        """The log's camera, and its frame, that shows most of a camera's image at a time; None
        where it has no image within 0.06 s."""
        for source in self._sources[name][:1]:
            nearest = _nearest(source.stream, time_us)
            return None if nearest is None else (source.stream.name, nearest)
        return None

    def rendered(self, renderer: SensorRenderer, time_us: int) -> dict[str, Image]:
        """What a renderer of `mounts` shows in place of `images`.

        Each camera at the very time of the recorded image that shows most of it, with ego and
        traffic where the log has them then; black where no recorded image shows anything.

        Raises:
            InputError: a camera has no image near the time; see `frame`.
        """
        shown, found = self.shown(time_us), {}
        for name in self.names:
            frame = self.frame(name, time_us)
            if frame is None:
                problem = f"has no image within {_LATE:g} s of log time {time_us}"
                raise InputError(self.log.name, f"camera {name}", problem, "leave this moment out")
            at = int(self.log.cameras[frame[0]].timestamps_us[frame[1]])
            image = renderer.render(self.state(at), [name])[name]
            found[name] = self.mounts[name].masked(image) * shown[name][..., None]
        return found

    def state(self, time_us: int) -> SimState:
        """The world as the log has it at a time, no actor controlled."""
        trajectory = self.log.world_from_rig
        now = initial_state(trajectory.timestamps_us, trajectory.poses, time_us, self.vehicle)
        there = {key: track.trajectory for key, track in self.log.tracks.items()}
        return LoggedState(
            step=0,
            timestamp_us=time_us,
            ego=EgoState(now),
            log_ego=now[:4],
            world_from_rig=trajectory.at(time_us),
            track_id="",
            actor=np.zeros(4),
            world_from_actor=np.eye(4),
            others={key: one.at(time_us) for key, one in there.items() if one.covers(time_us)},
            calibrated={key: one.rig_from_camera for key, one in self.log.cameras.items()},
        )

    def plans(
        self,
        planner: BasePlanner,
        times: Sequence[int],
        images: Callable[[int, int], Images] | None = None,
    ) -> Iterator[tuple[PlannerInput, Array]]:
        """What the planner sees and plans (40, 3), moment by moment, after one call of `reset`.

        Args:
            images: function of index and time that gives the images; None for the recorded ones.

        Raises:
            ValueError: the planner's answer is no plan.
        """
        with calling(planner, None) as calls:
            calls.reset(self.context)
            for index, time_us in enumerate(times):
                given = None if images is None else images(index, time_us)
                seen = self.observation(index, time_us, given)
                yield seen, calls.timed_plan(seen, None)[0].waypoints
            calls.finish()


@dataclass(frozen=True)
class LoggedState(SimState):
    """A moment of the log: no actor is controlled."""

    calibrated: Mapping[str, Array] = field(default_factory=dict)

    @property
    def actors(self) -> dict[str, SimActor]:
        """None."""
        return {}

    @property
    def log_mounts(self) -> Mapping[str, Array]:
        """Those of the calibration."""
        return self.calibrated


@dataclass(frozen=True)
class _Source:
    """Where the pixels of a camera lie in the images of one of the log's.

    The image is brought to `size` first, each pixel the mean of those that it covers: a camera that
    shows fewer pixels than were recorded would otherwise skip some, and no renderer draws so.
    """

    stream: CameraStream
    size: tuple[int, int]  # width, height
    across: Array  # (H, W) float32, as OpenCV counts
    down: Array
    inside: BoolArray  # (H, W)


def _sources(
    streams: Mapping[str, CameraStream], mount: CameraMount, name: str
) -> Iterator[_Source]:
    """The log's cameras that see something of a camera, best first.

    Directions only: places are taken to be the same.
    """
    rays = mount.camera.rays(mount.camera.pixel_grid()) @ mount.rig_from_camera[:3, :3].T
    found = []
    for key, stream in streams.items():
        pixels, depth = stream.camera.project(rays @ stream.rig_from_camera[:3, :3])
        size = np.array([stream.camera.width, stream.camera.height])
        inside = (depth > 0) & np.all((pixels >= 0) & (pixels <= size), axis=-1)
        if not inside.any():
            continue
        steps = np.linalg.norm(np.diff(pixels, axis=1), axis=-1)[inside[:, 1:] & inside[:, :-1]]
        finer = float(np.median(steps)) if len(steps) else 1.0
        target = np.maximum(1, np.round(size / finer)) if finer > _COARSER else size
        u, v = np.moveaxis((pixels * (target / size) - 0.5).astype(np.float32), -1, 0)
        own = key in (name, mount.source)
        source = _Source(stream, (int(target[0]), int(target[1])), u, v, inside)
        found.append((not own, -inside.mean(), key, source))
    yield from (one for *_, one in sorted(found, key=lambda one: one[:3]))


def _nearest(stream: CameraStream, time_us: int) -> int | None:
    frame = int(np.abs(stream.timestamps_us - time_us).argmin())
    return frame if abs(int(stream.timestamps_us[frame]) - time_us) <= _LATE * 1e6 else None


def _warped(
    mount: CameraMount, sources: Sequence[_Source], time_us: int
) -> tuple[Image, BoolArray]:
    """The image (H, W, 3) of a camera from the recorded images nearest to a time, and the pixels
    (H, W) that they show."""
    image = np.zeros((mount.camera.height, mount.camera.width, 3), np.uint8)
    filled = np.zeros(image.shape[:2], np.bool_)
    for source in sources:
        if filled.all():
            break
        frame = _nearest(source.stream, time_us)
        if frame is None:
            continue
        recorded = np.ascontiguousarray(source.stream.images[frame])
        if source.size != recorded.shape[1::-1]:
            recorded = np.asarray(cv2.resize(recorded, source.size, interpolation=cv2.INTER_AREA))
        edge = cv2.BORDER_REPLICATE
        shown = cv2.remap(recorded, source.across, source.down, cv2.INTER_LINEAR, borderMode=edge)
        new = source.inside & ~filled
        image[new], filled = shown[new], filled | new
    return image, filled


def disturbed(name: str, images: Images, index: int) -> dict[str, Image]:
    """Images that a camera might as well have taken.

    Args:
        name: one of `DISTURBANCES`: a pixel to the right, its left edge repeated; each value a grey
            level up, down or as it is; or as JPEG of quality 90.
        index: number of the moment, the seed of what is random.
    """
    random = np.random.default_rng(index)

    def grey(image: Image) -> Image:
        noise = random.integers(-1, 2, image.shape)
        return np.clip(image.astype(np.int64) + noise, 0, 255).astype(np.uint8)

    def compressed(image: Image) -> Image:
        done, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
        assert done
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)[..., ::-1]

    changes = dict(zip(DISTURBANCES, (jittered, grey, compressed), strict=True))
    return {key: np.ascontiguousarray(changes[name](one)) for key, one in images.items()}


def stops(path: Array) -> bool:
    """Whether a path (40, 3) from the origin comes below 0.5 m/s."""
    steps = np.diff(np.concatenate([np.zeros((1, 2)), path[:, :2]]), axis=0)
    return bool(np.linalg.norm(steps, axis=1).min() < _STOPPED * _DT)


def leaves_lane(plan: Array, recorded: Array) -> bool:
    """Whether a plan (40, 3) goes more than 1.5 m beside a recorded path (40, 3), which goes on
    straight."""
    line = np.concatenate([np.zeros((1, 3)), recorded])
    ahead = np.array([np.cos(line[-1, 2]), np.sin(line[-1, 2])])
    ends = line[-1, :2] + np.outer(np.linspace(1.0, 60.0, 60), ahead)
    dense = np.concatenate([line[:, :2], ends])
    pieces = np.linspace(dense[:-1], dense[1:], 6).reshape(-1, 2)
    apart = np.linalg.norm(plan[:, None, :2] - pieces[None], axis=-1).min(axis=1)
    return bool(apart.max() > _OFF_LANE)


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


def draw_paths(
    drive: RecordedDrive, images: Images, paths: Mapping[tuple[int, int, int], Array]
) -> Image:
    """(H, W, 3): the image that looks ahead most, with paths (N, 3) in the ego frame by colour."""
    name = max(drive.mounts, key=lambda one: drive.mounts[one].rig_from_camera[0, 2])
    mount, page = drive.mounts[name], np.array(images[name])
    camera_from_rig = se3.inverse(mount.rig_from_camera)
    for ink, path in paths.items():
        ground = np.column_stack([path[:, :2], np.zeros(len(path)), np.ones(len(path))])
        pixels, depth = mount.camera.project((ground @ camera_from_rig.T)[:, :3])
        for (u, v), far in zip(pixels, depth, strict=True):
            if far > 0.5 and np.abs([u, v]).max() < 1e5:
                cv2.circle(page, (round(float(u)), round(float(v))), 2, ink, -1)
    return page
