"""A driver of AlpaSim, the program behind an EgodriverService, as a planner of recast's loop.

gRPC is imported and a channel opened when a session begins: a planner object may be made in one
process and used in another.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal
from uuid import uuid4

import numpy as np

from recast.core.errors import InputError
from recast.core.workers import Closing
from recast.planning import (
    ALPASIM_PREFIX,
    WAYPOINTS,
    CameraMount,
    LogReplay,
    Plan,
    PlannerInput,
    PlanningContext,
)
from recast.planning.cameras import require_cameras
from recast.protocols.alpasim.driven_plan import DrivenPlan
from recast.protocols.alpasim.messages import (
    DEADLINE,
    EGODRIVER_METHODS,
    EGODRIVER_SERVICE,
    PAUSES,
    message,
)
from recast.protocols.alpasim.observations import (
    egomotion,
    image_observation,
    route_request,
    session_request,
)
from recast.protocols.alpasim.requests import JPEG, PNG, RefusedError
from recast.simulation import RoadSurface

if TYPE_CHECKING:
    from recast.protocols.alpasim.calls import ServiceClient

_LOG = logging.getLogger(__name__)

WARM_UP = 4.0
"""Seconds from the start within which a driver must have given its first plan."""
_CLOSING = 5.0
"""Seconds that closing a session may take."""
_FORMATS = {"jpeg": JPEG, "png": PNG}
_SEE_LOG = "see the driver's log"
_MENDS = {
    "UNAVAILABLE": "start the driver, or name its host and port",
    "UNIMPLEMENTED": "name the port of a driver (EgodriverService)",
    "DEADLINE_EXCEEDED": "give the driver more time, or see its log",
    "UNKNOWN": "see the driver's log, and name the cameras that it wants",
}
_VERSIONS: dict[str, str] = {}
"""Full version of each driver that this process has met, by address."""


@dataclass
class _Session:
    """One rollout of a driver.

    Attributes:
        cameras: name in `PlannerInput.images` by the driver's name.
        told_us: time of the last pose that the driver was told; -1 before the first.
        plan: the last one that was not empty.
        log: drives until there is a plan.
        log_plans: how many plans were the log's.
        began_us: time of the first plan; None before it.
    """

    client: ServiceClient
    uuid: str
    context: PlanningContext
    surface: RoadSurface
    cameras: Mapping[str, str]
    log: LogReplay
    told_us: int = -1
    plan: DrivenPlan | None = None
    log_plans: int = 0
    began_us: int | None = None


class AlpaSimDriver(Closing):
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
        name: for tables; None for the word that names the planner.
        image_format: "jpeg" (quality 95, as in AlpaSim), or "png", which keeps every pixel.
        seed: sent with each session.
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
        seed: int = 0,
        warm_up: float = WARM_UP,
        deadline: float = DEADLINE,
        pauses: Sequence[float] = PAUSES,
    ) -> None:
        self.address, self.name = address, name or f"{ALPASIM_PREFIX}{address}"
        if cameras is not None and not isinstance(cameras, Mapping):
            cameras = {name: name for name in cameras}
        self._cameras = cameras
        self.needs_images = cameras is None or bool(cameras)
        self._format, self._seed, self._warm_up = _FORMATS[image_format], seed, warm_up
        self._deadline, self._pauses = deadline, tuple(pauses)
        self._session: _Session | None = None
        self._log_drove = 0.0

    @property
    def camera_names(self) -> tuple[str, ...] | None:
        """The log's names of the cameras, where they were given."""
        return None if self._cameras is None else tuple(self._cameras.values())

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
        the last rollout.

        Raises:
            InputError: the driver was never reached, and is not there.
        """
        return {"driver": self.version, "log_drove_s": self._log_drove}

    def reset(self, context: PlanningContext) -> None:
        """Begin a session.

        Raises:
            InputError: a camera is not there; no driver answers, it refuses the session, or it has
                another version than before in this process.
        """
        self.close()
        cameras = self._cameras or {}
        if self._cameras is None:
            cameras = {name: name for name in context.cameras}
        require_cameras(cameras.values(), context.cameras, f"planner {self.name}")
        log, ground = LogReplay(), None if context.map is None else context.map.ground
        log.reset(context)
        surface = RoadSurface.from_log(context.log, context.route, ground)
        client = _connected(self.address, self._deadline, self._pauses)
        self._session = _Session(client, str(uuid4()), context, surface, cameras, log)
        self._log_drove = 0.0
        mounts = {name: context.cameras[camera] for name, camera in cameras.items()}
        request = session_request(self._session.uuid, self._seed, mounts)
        try:
            client.call("start_session", request)
        except InputError:  # a driver that answered too late has begun it
            self.close()
            raise

    def plan(self, observation: PlannerInput) -> Plan:
        """The driver's plan, after it was told images, egomotion and route.

        Raises:
            RuntimeError: `reset` was not called.
            InputError: a call failed, the driver ended the session, or its answer is no plan.
        """
        session = self._session
        if session is None:
            raise RuntimeError("AlpaSimDriver.plan: call reset first")
        self._tell(session, observation)
        now, step = observation.timestamp_us, round(session.context.dt * 1e6)
        times = now + step * np.arange(1, WAYPOINTS + 1, dtype=np.int64)
        request = message(
            "DriveRequest", session_uuid=session.uuid, time_now_us=now, time_query_us=times[-1]
        )
        reply = session.client.call("drive", request)
        if reply.terminate_session:
            raise self._fault("ended the session (terminate_session)")
        if session.began_us is None:
            session.began_us = now
        if reply.trajectory.poses:
            try:
                session.plan = DrivenPlan.read(reply.trajectory, now, observation.ego.pose)
            except ValueError as error:
                mend = "answer with poses in the local frame, the first for now, then later ones"
                raise self._fault(str(error), mend) from None
        elif session.plan is None:
            return self._warming_up(session, observation)
        elif session.plan.ends_us <= now:
            raise self._fault("the trajectory is empty, and the plan before it has ended")
        return Plan(session.plan.waypoints(now, observation.ego.pose, times))

    def finish_rollout(self) -> None:
        """Close the session.

        Raises:
            InputError: the driver gave no plan in the whole rollout.
        """
        session, self._session = self._session, None
        if session is None:
            return
        request = message("DriveSessionCloseRequest", session_uuid=session.uuid)
        try:
            session.client.call("close_session", request, _CLOSING)
        except InputError as error:  # the rollout is driven, or has failed already
            _LOG.warning("%s", error)
        finally:
            session.client.close()
        if session.log_plans and session.plan is None:
            raise self._fault("gave no plan in the whole rollout")
        if session.log_plans:
            _LOG.warning("%s: the log drove the first %g s", self.name, self._log_drove)

    def close(self) -> None:
        """Close the session, whatever came of it."""
        try:
            self.finish_rollout()
        except InputError as error:
            _LOG.warning("%s", error)

    def _tell(self, session: _Session, observation: PlannerInput) -> None:
        client, uuid, now = session.client, session.uuid, observation.timestamp_us
        for name, camera in session.cameras.items():
            try:
                image = image_observation(uuid, name, observation.images[camera], now, self._format)
            except RefusedError as error:
                mend = "render smaller images"
                raise InputError(self.name, f"camera {name}", error.details, mend) from None
            client.call("submit_image_observation", image)
        step, past = round(session.context.dt * 1e6), observation.ego_history
        times = [now - step * back for back in range(len(past) - 1, -1, -1)]
        new = [index for index, time in enumerate(times) if time > session.told_us]
        poses = session.surface.ego_poses(past[new, :3])
        told = egomotion(uuid, [times[index] for index in new], poses, past[new])
        client.call("submit_egomotion_observation", told)
        session.told_us = now
        route = route_request(uuid, session.context.route, observation.ego.pose, now)
        client.call("submit_route", route)

    def _warming_up(self, session: _Session, observation: PlannerInput) -> Plan:
        assert session.began_us is not None
        if observation.timestamp_us - session.began_us >= self._warm_up * 1e6:
            raise self._fault(f"gave no plan within the first {self._warm_up:g} s")
        session.log_plans += 1
        self._log_drove = session.log_plans * session.context.plan_every * session.context.dt
        return Plan(session.log.plan(observation).waypoints, {"driver": "empty: the log drives"})

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
        raise InputError("planner", word, "names no host and port", mend)
    if not slash:
        return AlpaSimDriver(address, name=word)
    cameras: dict[str, str] = {}
    for part in listed.split(",") if listed else ():
        name, given, camera = part.partition("=")
        camera = camera if given else name
        if not name or not camera or name in cameras:
            mend = "give names with commas between, each NAME or NAME=CAMERA"
            raise InputError("planner", word, f"camera {part!r} is empty or there twice", mend)
        cameras[name] = camera
    return AlpaSimDriver(address, cameras, name=word)


def driver_version(address: str) -> str:
    """What the driver calls itself, with commit and version of the messages if it says them.

    It is asked once in each process.

    Raises:
        InputError: no driver answers.
    """
    if address not in _VERSIONS:
        _connected(address, DEADLINE, PAUSES).close()
    return _VERSIONS[address]


def _connected(address: str, deadline: float, pauses: Sequence[float]) -> ServiceClient:
    """A client of the driver; all results of one process are of one version."""
    try:
        from recast.protocols.alpasim.calls import ServiceClient
    except ModuleNotFoundError:
        mend = "pip install 'recast-sim[alpasim]'"
        raise InputError("grpcio", "module", "is not installed", mend) from None
    client = ServiceClient(
        address,
        EGODRIVER_METHODS,
        (EGODRIVER_SERVICE,),
        deadline=deadline,
        pauses=pauses,
        mends=_MENDS,
    )
    known = _VERSIONS.setdefault(address, client.full_version)
    if known != client.full_version:
        client.close()
        problem = f"the driver is now {client.full_version}, it was {known}"
        raise InputError(address, "get_version", problem, "begin again with one driver")
    return client
