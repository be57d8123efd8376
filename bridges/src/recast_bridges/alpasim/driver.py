"""Drivers of AlpaSim as planners: what they are sent, and their answers, checked, as plans."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Int64Array
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.core.workers import Closing
from recast.geometry import se2
from recast.logs.checks import LATEST_US
from recast.planning import WAYPOINTS, BasePlanner, LogReplay, Plan, PlannerInput, PlanningContext
from recast.planning.cameras import require_cameras
from recast_bridges.alpasim.driver_session import DriverSession, driver_version
from recast_bridges.alpasim.messages import DEADLINE, JPEG, PAUSES, PNG, read_pose
from recast_bridges.splines import spline_through

_NEAR = 5.0
"""Metres from the ego at which a plan may begin: more is another frame."""
_FASTEST = 100.0
"""Metres per second that a plan without a pose for now may have driven until its first one."""


@dataclass(frozen=True)
class DrivenPlan:
    """A driver's trajectory."""

    timestamps_us: Int64Array  # (N,) rising; N is at least 2
    poses: Array  # (N, 3) x, y, heading of the rear axle, world

    @classmethod
    def read(cls, trajectory: Any, now_us: int, ego_pose: ArrayLike) -> Self:
        """The plan of a message Trajectory that has poses.

        Args:
            ego_pose: (3,) pose of the ego now, world.

        Raises:
            ValueError: a pose is none, there is only one, times do not rise, or the plan lies in
                the past or far from the ego.
        """
        count = len(trajectory.poses)
        if count < 2:
            raise ValueError("the trajectory has one pose, at least two are needed")
        times = [pose.timestamp_us for pose in trajectory.poses]
        for index, time in enumerate(times):
            if not (times[index - 1] if index else -1) < time < LATEST_US:
                raise ValueError(f"poses[{index}].timestamp_us: is {time}, not a valid later time")
        if times[-1] <= now_us:
            raise ValueError(f"the trajectory ends {(now_us - times[-1]) * 1e-6:g} s before now")
        matrices = [
            read_pose(pose.pose, f"poses[{index}].pose")
            for index, pose in enumerate(trajectory.poses)
        ]
        plan = cls(np.array(times, np.int64), se2.from_se3(np.stack(matrices)))
        plan._require_near(now_us, np.asarray(ego_pose, np.float64))
        return plan

    def _require_near(self, now_us: int, ego_pose: Array) -> None:
        here = [np.interp(now_us, self.timestamps_us, self.poses[:, axis]) for axis in (0, 1)]
        apart = float(np.hypot(*(np.array(here) - ego_pose[:2])))
        late = max(int(self.timestamps_us[0]) - now_us, 0) * 1e-6
        if apart > _NEAR + _FASTEST * late:
            raise ValueError(f"the trajectory begins {apart:.1f} m from the ego")

    @property
    def ends_us(self) -> int:
        """Time of the last pose."""
        return int(self.timestamps_us[-1])

    def waypoints(self, now_us: int, ego_pose: ArrayLike, times_us: Int64Array) -> Array:
        """Waypoints (M, 3) in the ego frame.

        Poses at the asked times are taken as they are; else they are interpolated, see
        `spline_through`, from the ego's present pose on if the driver gave none for now. Beyond the
        last pose the ego goes on straight, at the velocity between the last two.

        Args:
            now_us: present time, earlier than `ends_us`.
            ego_pose: (3,) pose of the ego now, world.
            times_us: (M,) times of the waypoints, rising, later than now.
        """
        knots, poses = self.timestamps_us, se2.relative(ego_pose, self.poses)
        if knots[0] > now_us:
            knots = np.concatenate([[now_us], knots])
            poses = np.concatenate([np.zeros((1, 3)), poses])
        within = times_us <= knots[-1]
        inside, found = times_us[within], np.empty((len(times_us), 3))
        if np.isin(inside, knots).all():
            found[within] = poses[np.searchsorted(knots, inside)]
        else:
            found[within] = spline_through((knots - now_us) * 1e-6, poses, (inside - now_us) * 1e-6)
        velocity = (poses[-1, :2] - poses[-2, :2]) / (knots[-1] - knots[-2])
        beyond = (times_us[~within] - knots[-1])[:, None]
        found[~within, :2] = poses[-1, :2] + velocity * beyond
        found[~within, 2] = poses[-1, 2]
        return found


_LOG = logging.getLogger(__name__)

ALPASIM_PREFIX = "alpasim:"
"""Start of the name of a planner that is a driver of AlpaSim."""
WARM_UP = 4.0
"""Seconds from the start within which a driver must have given its first plan."""
_FORMATS = {"jpeg": JPEG, "png": PNG}
_SEE_LOG = "see the driver's log"


@dataclass
class _Drive:
    """One rollout; a late answer of the one before it cannot come into it."""

    session: DriverSession
    plan: DrivenPlan | None = None  # the last one that was not empty
    began_us: int | None = None  # time of the first plan
    log_drove: float = 0.0  # seconds for which the log drove in place of the driver


class AlpaSimDriver(Closing, BasePlanner):
    """Drives what a driver of AlpaSim answers; a `Planner` and a context manager.

    Each rollout is a session of its own, on a connection of its own. `run_rollout` has it closed
    by `finish_rollout`, also after a fault; `close` and the next `reset` close it, too.

    A driver may answer with an empty trajectory while it collects images. Until its first plan the
    log drives, as in AlpaSim, and later its last plan goes on until that ends.

    Args:
        address: host:port. The channel is not secured.
        cameras: driver's name to the log's, of the cameras to send; names alone where both are the
            same; () for none. None for all that are rendered. A driver refuses a camera that it
            does not use.
        name: name for tables; None for the word that names the planner.
        image_format: "jpeg" (quality 95, as in AlpaSim), or "png", which keeps every pixel.
        seed: sent with each session; None for that of the rollout.
        warm_up: seconds from the start within which there must be a plan.
        deadline: seconds that a call may take.
        pauses: seconds before each further try of a call while the driver is not there.
    """

    def __init__(
        self,
        address: str,
        cameras: Mapping[str, str] | Sequence[str] | None = None,
        *,
        name: str | None = None,
        image_format: Literal["jpeg", "png"] = "jpeg",
        seed: int | None = None,
        warm_up: float = WARM_UP,
        deadline: float = DEADLINE,
        pauses: Sequence[float] = PAUSES,
    ) -> None:
        self.address, self.name = address, name or f"{ALPASIM_PREFIX}{address}"
        if cameras is not None and not isinstance(cameras, Mapping):
            cameras = {name: name for name in cameras}
        self._cameras = cameras
        self.camera_names = None if cameras is None else tuple(cameras.values())
        self.needs_images = cameras is None or bool(cameras)
        self._format, self._seed, self._warm_up = _FORMATS[image_format], seed, warm_up
        self._patience = deadline, tuple(pauses)
        self._log = LogReplay()  # drives until there is a plan
        self._drive: _Drive | None = None
        self._log_drove = 0.0  # in the last rollout

    def choose_cameras(self, mounts: Mapping[str, CameraMount]) -> Mapping[str, str] | None:
        """Driver's name to the log's; None if no cameras were given."""
        return self._cameras

    @property
    def version(self) -> str:
        """What the driver calls itself; see `driver_version`."""
        return driver_version(self.address)

    @property
    def record_fields(self) -> dict[str, str | float]:
        """What records say of the driver: its version, and how long the log drove in its place in
        the last rollout. Raises InputError: the driver was never reached, and is not there."""
        return {"driver": self.version, "log_drove_s": self._log_drove}

    def reset(self, context: PlanningContext) -> None:
        """Begin a session. Raises InputError: a camera is not there; see also `DriverSession`."""
        self.close()
        cameras = self._cameras or {}
        if self._cameras is None:
            cameras = {name: name for name in context.cameras}
        require_cameras(cameras.values(), context.cameras, f"planner {self.name}")
        self._log.reset(context)
        seed = context.seed if self._seed is None else self._seed
        session = DriverSession(self.address, context, cameras, seed, self._format, *self._patience)
        self._drive = _Drive(session)

    def plan(self, observation: PlannerInput) -> Plan:
        """The driver's plan, after it was told images, egomotion and route.

        Raises:
            RuntimeError: `reset` was not called.
            InputError: a call failed, the driver ended the session, or its answer is no plan.
        """
        drive = self._drive
        if drive is None:
            raise RuntimeError("AlpaSimDriver.plan: call reset first")
        session, now, pose = drive.session, observation.timestamp_us, observation.ego.pose
        session.tell(observation)
        times = now + session.step_us * np.arange(1, WAYPOINTS + 1, dtype=np.int64)
        reply = session.drive(now, int(times[-1]))
        if reply.terminate_session:
            raise self._fault("ended the session (terminate_session)")
        if drive.began_us is None:
            drive.began_us = now
        if reply.trajectory.poses:
            try:
                drive.plan = DrivenPlan.read(reply.trajectory, now, pose)
            except ValueError as error:
                mend = (
                    "answer with poses in the local frame: the first for now, then for later times"
                )
                raise self._fault(str(error), mend) from None
        elif drive.plan is None:
            if now - drive.began_us >= self._warm_up * 1e6:
                raise self._fault(f"gave no plan within the first {self._warm_up:g} s")
            cycle_us = session.step_us * session.context.plan_every
            drive.log_drove = (now - drive.began_us + cycle_us) * 1e-6
            return Plan(self._log.plan(observation).waypoints, {"driver": "empty: the log drives"})
        elif drive.plan.ends_us <= now:
            raise self._fault("the trajectory is empty, and the previous plan has ended")
        return Plan(drive.plan.waypoints(now, pose, times))

    def finish_rollout(self) -> None:
        """Close the session. Raises InputError: the driver gave no plan in the whole rollout."""
        drive, self._drive = self._drive, None
        if drive is None:
            return
        drive.session.close()
        self._log_drove = drive.log_drove
        if drive.log_drove and drive.plan is None:
            raise self._fault("gave no plan in the whole rollout")
        if drive.log_drove:
            _LOG.warning(
                "%s: gave no plan in the first %g s, so the ego followed the log",
                self.name,
                drive.log_drove,
            )

    def close(self) -> None:
        """Close the session, whatever came of it."""
        try:
            self.finish_rollout()
        except InputError as error:
            _LOG.warning("%s", error)

    def _fault(self, problem: str, mend: str = _SEE_LOG) -> InputError:
        return InputError(self.address, "drive", problem, mend)


def driver_planner(words: str) -> AlpaSimDriver:
    """The planner of a text HOST:PORT or HOST:PORT/CAMERAS.

    CAMERAS are separated by commas, each NAME, or NAME=CAMERA if the log calls it otherwise;
    nothing after the slash for none.

    Raises:
        InputError: it is no such text.
    """
    address, slash, listed = words.partition("/")
    word = f"{ALPASIM_PREFIX}{words}"
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        mend = f"give {ALPASIM_PREFIX}HOST:PORT, such as {ALPASIM_PREFIX}localhost:6789"
        raise InputError("planner", word, "does not name a host and a port", mend)
    if not slash:
        return AlpaSimDriver(address, name=word)
    cameras: dict[str, str] = {}
    for part in listed.split(",") if listed else ():
        name, given, camera = part.partition("=")
        camera = camera if given else name
        if not name or not camera or name in cameras:
            mend = "give names separated by commas, each NAME or NAME=CAMERA"
            raise InputError("planner", word, f"camera {part!r} is empty or appears twice", mend)
        cameras[name] = camera
    return AlpaSimDriver(address, cameras, name=word)


def driver_source(words: str) -> str:
    """What stands for a driver in keys of artefacts: its address and the version it answers with.
    Raises InputError: see `driver_planner`; or no driver answers."""
    return f"{ALPASIM_PREFIX}{words} {driver_planner(words).version}"
