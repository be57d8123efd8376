"""The simulator: a rollout step by step, whoever plans; it can be branched and replayed."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Self

import numpy as np

from recast.arrays import Array, Image
from recast.core.arguments import checked
from recast.core.errors import InputError
from recast.core.foreign import ForeignCode, read_only, whole
from recast.dynamics import EgoState
from recast.dynamics import state as ego
from recast.geometry import boxes, se2
from recast.geometry.boxes import TOUCHING
from recast.logs.checks import WORLD_REACH
from recast.logs.load import load_log
from recast.logs.types import DrivingLog
from recast.planning import Plan, PlannerInput, PlanningContext
from recast.planning.cameras import require_cameras
from recast.simulation.actor_motion import AnyMotion
from recast.simulation.history import History, ReactiveActors
from recast.simulation.planner_calls import checked_plan
from recast.simulation.recorded_road import Ending, RecordedRoad
from recast.simulation.renderer import SensorRenderer
from recast.simulation.rollout import Rollout, SimState, ego_centre
from recast.simulation.rollout_start import start_rollout
from recast.simulation.scenario import Scenario
from recast.simulation.setup import (
    BaseController,
    RolloutSettings,
    RolloutSetup,
    as_renderer,
    make_setup,
)

if TYPE_CHECKING:
    from recast.scene.street_scene import StreetScene


_HARDEST = 10.0
"""m/s^2: more than tyres hold on a dry road."""
_OFFSET = 1.0
"""Metres by which a plan may begin beside the ego: planners smooth, and correct their position;
PDM-Closed by 0.7 m."""
_SHARPEST = 0.5
"""Radians of heading in the first waypoint: a car turns by less in 0.2 s."""
Observation = PlannerInput
"""What `Simulator.reset` and `Simulator.step` return, and what `Planner.plan` takes."""
OnFrame = Callable[[SimState, Mapping[str, Image]], None]
"""Called with each state k = 0 .. S-1 in order and its images."""


@dataclass
class Timings:
    """Wall-clock seconds; kept apart from the rollout, which is deterministic."""

    render: float = 0.0
    plan: float = 0.0
    control: float = 0.0
    frames: int = 0


class Simulator:
    """Runs one rollout, one plan at a time; `reset` begins it anew, `copy` branches it.

    A collision never ends a rollout. Same inputs, same bytes.

    Args:
        log: the recorded drive; or a `RolloutSetup`, which has actors and settings.
        scene: what the cameras see: a street scene, any renderer, or None for no images.
        actors: controlled actors by track id: a motion, or its name such as "cut-in". The first
            one is the target.
        settings: how the rollout is run; None for the defaults.
        cameras: names of the cameras in the observations; None for those of the settings, or else
            all of the log or of the given renderer. Without a scene there are none.
        scale: size of a street scene's images, as a share of the log's.
        device: device that renders a street scene: "auto", "cpu", "cuda" or "cuda:1".
        planner: name of who plans, for the rollout.
        timings: timings that the simulator adds to; None for new ones.
        replays_log: put the ego onto the logged states, whatever the plans say.

    Raises:
        InputError: bad settings, no such track, motion or camera; see also
            `recast.simulation.rollout_start.start_rollout`.

    >>> from recast.simulation import RolloutSettings
    >>> sim = Simulator(log, actors={"0": "advancing"}, settings=RolloutSettings(steps=10))
    >>> planner.reset(sim.context)
    >>> observation = sim.reset()
    >>> while not sim.done:
    ...     observation = sim.step(planner.plan(observation))
    >>> sim.rollout.steps_run
    10
    """

    @checked({DrivingLog: load_log})
    def __init__(
        self,
        log: DrivingLog | RolloutSetup,
        scene: StreetScene | SensorRenderer | None = None,
        actors: Mapping[str, str | Path | AnyMotion | Scenario] | None = None,
        settings: RolloutSettings | None = None,
        *,
        cameras: Sequence[str] | None = None,
        scale: float = 1.0,
        device: str = "auto",
        planner: str = "external",
        timings: Timings | None = None,
        replays_log: bool = False,
    ) -> None:
        if isinstance(log, DrivingLog):
            settings = settings or RolloutSettings()
            if cameras is not None:
                settings = replace(settings, camera_names=tuple(cameras))
            setup = make_setup(log, settings, actors or {})
            cameras = setup.camera_names
        elif actors is None and settings is None:
            setup = log
        else:
            field = "actors" if settings is None else "settings"
            problem = "are given beside a RolloutSetup, which has its own"
            raise InputError("Simulator", field, problem, "leave them out")
        self._setup, self._replays_log, self.planner = setup, replays_log, planner
        self._renderer = as_renderer(setup.log, scene, cameras, scale, device)
        self.timings = timings or Timings()
        self._controller = whole(setup.controller, BaseController)
        mounts = {} if self._renderer is None else self._renderer.mounts
        self._cameras = tuple(mounts if cameras is None else cameras)
        require_cameras(self._cameras, mounts, "Simulator")
        self._begin(setup.seed)

    def _begin(self, seed: int) -> None:
        setup = self._setup
        self._start, self._seed = start_rollout(setup, seed), seed
        self._history = History(setup, self._start)
        self._actors = ReactiveActors(setup, self._start, self._history)
        who = f"controller {type(self._controller).__name__}"
        self._guard = ForeignCode(who, seed, self._controller)
        self._road = RecordedRoad(self._start.route, setup.road_margin)
        self._warned = False
        self._ending: Ending | None = None
        self._reason = self._start.cut_reason
        self._context = self._make_context()
        with self._guard.call("reset"):
            self._controller.reset(self._context)

    @property
    def setup(self) -> RolloutSetup:
        """What the rollout is asked to be."""
        return self._setup

    @property
    def step_number(self) -> int:
        """Steps executed up to now."""
        return self._history.step

    @property
    def route_s(self) -> Array:
        """Coordinates (step_number + 1,) of the ego on the route, each looked for near the last."""
        return np.array(self._history.route_s)

    @property
    def done(self) -> bool:
        """Whether the rollout is over."""
        return self._ending is not None

    @property
    def ending(self) -> Ending | None:
        """What ended the rollout; None while it runs."""
        return self._ending

    @property
    def cut_reason(self) -> str | None:
        """Why the rollout is, or will be, shorter than asked for; None if nothing is known yet."""
        return self._reason

    @property
    def state(self) -> SimState:
        """The world now, read-only; `state_at` has it at a step before."""
        return self._history.state(self.step_number)

    @property
    def context(self) -> PlanningContext:
        """What stays the same during the rollout, read-only: for `Planner.reset`."""
        return self._context

    def _make_context(self) -> PlanningContext:
        mounts = {} if self._renderer is None else self._renderer.mounts
        context = PlanningContext(
            route=self._start.route,
            log=self._setup.log.world_from_rig,
            map=self._setup.hdmap,
            vehicle=self._setup.vehicle,
            cameras={name: mounts[name] for name in self._cameras},
            dt=self._setup.dt,
            plan_every=self._setup.plan_every,
            seed=self._seed,
        )
        return read_only(context)

    @property
    def rollout(self) -> Rollout:
        """What was driven up to now.

        Raises:
            ValueError: no step was executed yet.
        """
        if self.step_number == 0:
            why = f" ({self._reason})" if self.done else "; call step"
            raise ValueError(f"Simulator.rollout: no step was executed{why}")
        reason = self._reason if self.done else "stopped before its end"
        return self._history.rollout(self.planner, reason, self._renderer)

    def copy(self) -> Self:
        """An independent simulator at the present step, for a branch of the rollout.

        Motions, the controller and a restorer are copied with what they remember
        (`copy.deepcopy`); log, map, road and renderer are shared. A planner that remembers
        something is copied beside it, by `copy.deepcopy`.
        """
        setup, start = self._setup, self._start
        situations = (actor.situation for actor in start.actors)
        shared = (setup.log, setup.hdmap, start.route, start.surface, self._context, *situations)
        return copy.deepcopy(self, {id(one): one for one in shared})

    def replay(self, plans: Rollout | Sequence[Plan], on_frame: OnFrame | None = None) -> Rollout:
        """Begin anew with the seed of now, and execute plans that were made before.

        The simulator stays where they end, and can go on from there.

        Args:
            plans: plans in order; or a rollout of the same setup, of which they are taken.
            on_frame: receives each state that is passed and the images of the cameras, for a film.

        Returns:
            What was driven: for a rollout the same bytes, with its planner and cut reason.

        Raises:
            InputError: the plans of a rollout lead elsewhere than it did.
            ValueError: there are no plans, or more than the rollout has steps for.
        """
        self._begin(self._seed)
        for plan in map(Plan, plans.predictions) if isinstance(plans, Rollout) else plans:
            first = self.step_number
            kept = self.advance(plan)
            if on_frame is not None:
                for step in range(first, first + kept):
                    on_frame(self.state_at(step), self.render(self._cameras, step))
        driven = self.rollout
        if not isinstance(plans, Rollout):
            return driven
        if not np.array_equal(driven.ego, plans.ego):
            problem = "does not come from these plans in this simulator"
            mend = "give the setup and the seed that it was run with"
            raise InputError("Simulator.replay", f"rollout {plans.name}", problem, mend)
        # Of a last plan of which no step was executed, a rollout has the reason alone.
        return replace(driven, planner=plans.planner, cut_reason=plans.cut_reason)

    def reset(self, seed: int | None = None) -> Observation:
        """Begin the rollout anew.

        Args:
            seed: seed of random numbers of motions (`StartSituation.seed`) and planners
                (`PlanningContext.seed`); None for that of the setup.

        Raises:
            InputError: see the class.
        """
        self._begin(self._setup.seed if seed is None else seed)
        return self.observe()

    def step(self, plan: Plan) -> Observation:
        """Execute the first `plan_every` steps of a plan, and look again.

        Args:
            plan: 40 waypoints in the present ego frame.

        Raises:
            ValueError: the rollout is over, or the plan is none; nothing has moved then.
            InputError: a motion returned no state.
        """
        self.warn_of_reach(plan)
        self.advance(plan)
        return self.observe()

    def observe(
        self, images: Mapping[str, Image] | None = None, *, foretold: bool = False
    ) -> Observation:
        """What a planner sees now, read-only.

        Args:
            images: images of the cameras; None to render them.
            foretold: tell where the others will be, see `ActorState.future`.
        """
        history, now = self._history, self._history.ego[-1]
        observation = PlannerInput(
            step=history.step,
            timestamp_us=history.timestamp_us(history.step),
            ego=EgoState(now),
            ego_history=history.ego_history(),
            actors=history.road_users(foretold),
            command=self._start.route.command(now, history.route_s[-1]),
            images=self.render(self._cameras) if images is None else images,
            route_s=history.route_s[-1],
        )
        return read_only(observation)

    def advance(self, plan: Plan) -> int:
        """As `step`, with its errors, but without looking; returns how many steps were executed."""
        if self.done:
            raise ValueError("Simulator.step: the rollout is over; call reset")
        plan = checked_plan(plan, "Simulator.step", "got")
        history, first = self._history, self.step_number
        steps = min(self._setup.plan_every, self._start.steps - first)
        executed = self._execute(plan, steps)
        along = self._start.route.follow(executed, history.route_s[-1])
        outside = self._road.outside(executed[:, :2], along)
        kept = int(np.argmax(outside)) if outside.any() else steps
        if kept < steps:
            self._ending = self._road.ending(along[kept])
            self._reason = self._road.reason("the ego", executed[kept, :2], along[kept])
        for k in range(kept):
            moved, reason = self._actors.step()
            if reason is not None:
                kept, self._ending, self._reason = k, Ending.ACTOR, reason
                break
            history.append(executed[k], float(along[k]), moved)
        if kept > 0:
            history.plans.append((first, plan.waypoints))
        if self._ending is None and self.step_number == self._start.steps:
            self._ending = self._start.ending
        elif self._ending is None and self._setup.end_on_contact:
            self._end_on_contact(first)
        return kept

    def _end_on_contact(self, first: int) -> None:
        """End the rollout if the ego touched a road user after step `first`."""
        setup, history = self._setup, self._history
        if self.step_number < 2 * setup.plan_every:
            return  # a rollout of fewer plans says nothing of a planner
        size = (setup.vehicle.length, setup.vehicle.width)
        for step in range(max(1, first - setup.plan_every), self.step_number + 1):
            own = ego_centre(history.ego[step][:3], setup.vehicle.centre_offset)
            for track_id, pose in history.state(step).poses.items():
                other = setup.track_of(track_id).size
                if boxes.bev_overlap_area(own, size, se2.from_se3(pose), other) > TOUCHING:
                    self._ending = Ending.CONTACT
                    self._reason = (
                        f"ended with the first contact, {step * setup.dt:.1f} s after the start"
                    )
                    return

    def render(self, cameras: Sequence[str], step: int | None = None) -> dict[str, Image]:
        """Images (H, W, 3) uint8 RGB by camera name at a step up to now; None for now.

        Raises:
            ValueError: there is no renderer.
        """
        if not cameras:
            return {}
        if self._renderer is None:
            raise ValueError("Simulator.render: give the simulator a scene")
        began = perf_counter()
        state = self._history.state(self.step_number if step is None else step)
        # Random numbers by step, so that films change none.
        with ForeignCode("renderer", self._seed + state.step).call("render"):
            rendered = self._renderer.render(state, tuple(cameras))
        images = {name: np.array(image) for name, image in rendered.items()}
        self.timings.render += perf_counter() - began
        self.timings.frames += len(images)
        return images

    def state_at(self, step: int) -> SimState:
        """The world at a step up to now, read-only.

        Raises:
            ValueError: the rollout has not come there.
        """
        return self._history.state(step)

    def warn_of_reach(self, plan: Plan) -> None:
        """Warn once a rollout of a plan whose first waypoint no vehicle can reach in a step.

        Raises:
            ValueError: the plan is none.
        """
        checked_plan(plan, "Simulator.step", "got")
        setup, state = self._setup, EgoState(self._history.ego[-1])
        x, y, heading = np.asarray(plan.waypoints, np.float64)[0]
        reach = (state.speed + _HARDEST * setup.dt) * setup.dt + _OFFSET
        turn = abs(float(se2.wrap_angle(heading)))
        if self._warned or (np.hypot(x, y) <= reach and turn <= _SHARPEST):
            return
        self._warned = True
        problem = (
            f"planner {self.planner}: the first waypoint at step {self.step_number} is "
            f"{np.hypot(x, y):.1f} m and {np.rad2deg(turn):.0f} degrees away; in {setup.dt:g} s at "
            f"{state.speed:.1f} m/s a car moves at most {reach:.1f} m and "
            f"{np.rad2deg(_SHARPEST):.0f} degrees; are waypoints in the ego frame and "
            f"{setup.dt:g} s apart?"
        )
        warnings.warn(problem, RuntimeWarning, stacklevel=2)

    def _execute(self, plan: Plan, steps: int) -> Array:
        """Ego states (steps, 11) by the controller."""
        setup, began = self._setup, perf_counter()
        if self._replays_log:
            logged = self._start.ego[self.step_number + 1 : self.step_number + 1 + steps]
            return ego.moved_left(logged, setup.start_left) if setup.start_left else logged
        with self._guard.call(f"execute at step {self.step_number}"):
            states = self._controller.execute(
                *read_only((self._history.ego[-1], plan.waypoints)), steps, setup.vehicle, setup.dt
            )
        executed = np.array(states, np.float64)[1:]
        self.timings.control += perf_counter() - began
        if not np.all(np.abs(executed) <= WORLD_REACH):  # also NaN
            problem = "leads to ego states that are not finite or too far away"
            mend = "plan waypoints that a vehicle can reach"
            where = f"planner {self.planner}"
            raise InputError(where, f"plan at step {self.step_number}", problem, mend)
        return executed
