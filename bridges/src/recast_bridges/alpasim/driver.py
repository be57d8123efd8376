"""A driver of AlpaSim, the program behind an EgodriverService, as a planner of recast's loop."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.core.workers import Closing
from recast.planning import (
    WAYPOINTS,
    BasePlanner,
    LogReplay,
    Plan,
    PlannerInput,
    PlanningContext,
)
from recast.planning.cameras import require_cameras
from recast_bridges.alpasim.driven_plan import DrivenPlan
from recast_bridges.alpasim.driver_session import DriverSession, driver_version
from recast_bridges.alpasim.messages import DEADLINE, PAUSES
from recast_bridges.alpasim.requests import JPEG, PNG

_LOG = logging.getLogger(__name__)

ALPASIM_PREFIX = "alpasim:"
"""Start of the name of a planner that is a driver of AlpaSim."""
WARM_UP = 4.0
"""Seconds from the start within which a driver must have given its first plan."""
_FORMATS = {"jpeg": JPEG, "png": PNG}
_SEE_LOG = "see the driver's log"


@dataclass
class _Drive:
    """One rollout; a late answer of the one before it cannot come into it.

    Attributes:
        plan: the last one that was not empty.
        began_us: time of the first plan.
        log_drove: seconds for which the log drove in place of the driver.
    """

    session: DriverSession
    plan: DrivenPlan | None = None
    began_us: int | None = None
    log_drove: float = 0.0


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
        the last rollout.

        Raises:
            InputError: the driver was never reached, and is not there.
        """
        return {"driver": self.version, "log_drove_s": self._log_drove}

    def reset(self, context: PlanningContext) -> None:
        """Begin a session.

        Raises:
            InputError: a camera is not there; see also `DriverSession`.
        """
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
        """Close the session.

        Raises:
            InputError: the driver gave no plan in the whole rollout.
        """
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

    Raises:
        InputError: see `driver_planner`; or no driver answers.
    """
    return f"{ALPASIM_PREFIX}{words} {driver_planner(words).version}"
