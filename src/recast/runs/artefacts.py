"""The artefacts of one log under one configuration, each made when it is first asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from rich.console import Console

from recast.actors import Actor, insert, load_actor
from recast.cameras import CameraMount
from recast.core import Artefact, Store
from recast.core.artefact import value_hash
from recast.core.diagnostics import ProgressBar
from recast.core.errors import InputError
from recast.core.foreign import whole
from recast.metrics.plan_agreement import plan_agreement, write_agreement
from recast.planning import BasePlanner, Planner, looked_at, make_planner
from recast.reconstruction import SceneConfig
from recast.reconstruction.views import is_held_out, modelled_tracks
from recast.runs.actor import ActorMakers
from recast.runs.arms import OWN_STREET, PRESETS, Arm, truth_of
from recast.runs.completion import (
    ALL,
    NEAR,
    CompletedVehicles,
    choose_completed,
    require_made,
)
from recast.runs.config import RunConfig
from recast.runs.making import (
    Maker,
    VehicleParts,
    compare_vehicle,
    film_vehicle,
    refine_vehicle,
    register_vehicle,
    score_street,
    take_street,
    train_street,
)
from recast.runs.rollouts import Renderers, make_rollout, rollout_setup, run_mounts
from recast.runs.run_folder import ACTOR_FOLDER, rollout_name, use_name
from recast.runs.sources import RECIPES, SourceLog, Sources
from recast.scene import StreetScene, load_scene
from recast.simulation import (
    PlannerProcess,
    RolloutSetup,
    Timings,
    further_actors,
    replaced_tracks,
    scenario_record,
)
from recast.simulation.recorded_drive import RecordedDrive


class Artefacts:
    """What a run needs, found in its store or made; close it.

    Args:
        sources: see `Sources.of`; taken before any planner or generator was loaded.
        scene: name of the scene, for generators that have a file for each.
        oracle_workers: processes of an oracle, see `OracleRenderer`.

    Attributes:
        used: artefacts by use, such as "scene/recast" or "rollout/cut-in-a/idm-follower/native".
        on_use: function that is called after each artefact that joins them.
    """

    def __init__(
        self,
        store: Store,
        source: SourceLog,
        config: RunConfig,
        sources: Sources,
        console: Console,
        scene: str,
        oracle_workers: int = 0,
    ) -> None:
        self.store, self.source, self.config = store, source, config
        self.sources, self.console = sources, console
        self.maker = Maker(store, console)
        self.arms = {arm.name: config.arm(arm.name).of_scene(scene) for arm in config.arms}
        self.used: dict[str, Artefact] = {}
        self.on_use: Callable[[], None] = lambda: None
        self.possible_steps: dict[str, int] = {}
        self._makers: dict[tuple[str, str, str], ActorMakers] = {}
        self._planners: dict[str, Planner] = {}
        self._configs: dict[str, SceneConfig] = {}
        self.renderers = Renderers(
            self._street, self._actor, lambda: source.world, oracle_workers, config.restorer
        )

    def planner(self, name: str) -> Planner:
        """A planner, loaded once."""
        if name not in self._planners:
            made = partial(make_planner, name, self.config.planner_device)
            planner = made()
            if self.config.plan_limit_s is not None:
                planner = PlannerProcess(planner, made)
            self._planners[name] = planner
        return self._planners[name]

    def mounts(self, planner: str) -> dict[str, CameraMount]:
        """The cameras that are rendered for a planner and for films; without films, of each only
        what the planner looks at."""
        looking = self.planner(planner)
        mounts = run_mounts(self.source.log, looking, self.config)
        return mounts if self.config.films else looked_at(looking, mounts)

    def makers(self, arm: Arm) -> ActorMakers:
        """What makes an arm's vehicles, its networks in memory from now on.

        Raises:
            InputError: generator or segmenter is unknown, or cannot be loaded.
        """
        key = (str(arm.generator), str(arm.segmenter), str(arm.axes))
        if key not in self._makers:
            self._makers[key] = ActorMakers.named(*key)
        return self._makers[key]

    def require_makeable(self) -> None:
        """Refuse tracks that an arm's generator cannot make. Raises InputError: `require_made`."""
        for arm in self.arms.values():
            for track in self.tracks() if arm.generates else ():
                require_made(str(arm.generator), self.source.log.tracks[track], f"arm {arm.name}")

    def forget_makers(self) -> None:
        """Let go of the networks of generators and segmenters."""
        self._makers.clear()

    def looks(self, planner: str) -> bool:
        """Whether anything is rendered for the rollouts of a planner."""
        return self.config.films or self.planner(planner).needs_images

    def prepare(self, arm: Arm, further: bool = True) -> None:
        """Make the street and the vehicles of an arm, as far as anything is rendered.

        Args:
            further: also what only a report shows: turntable, and comparison with the truth.
        """
        if not self.shows(arm):
            return
        self.prepare_street(arm)
        if not arm.generates:
            return
        for track in self.tracks():
            self.actor(arm, track)
        if further:
            self.turntable(arm, self.config.track)
            if truth_of(self.config.arms) is not None:
                self.truth(arm)

    def shows(self, arm: Arm) -> bool:
        """Whether anything of an arm that was made is rendered."""
        made = arm.reconstructs or arm.generates
        return made and any(self.looks(planner) for planner in self.config.planners)

    def prepare_street(self, arm: Arm) -> None:
        """Make the street of an arm, and score it."""
        self.scene(arm)
        self.evaluation(arm)

    def scene(self, arm: Arm) -> Artefact:
        """The reconstruction of an arm's street, or the one that its vehicle is made in."""
        folder = self._folder_of(arm)
        if folder is not None:
            return self._used(
                use_name("scene", arm.made_in), lambda: take_street(self.maker, folder)
            )
        config = self.street_config(arm)
        return self._used(
            use_name("scene", arm.made_in),
            lambda: train_street(self.maker, self.source, config, arm.made_in),
        )

    def street_config(self, arm: Arm) -> SceneConfig:
        """The scene settings of an arm's reconstruction; they force controlled tracks that would be
        background."""
        if arm.made_in not in self._configs:
            config = self.config.street(arm.made_in)
            if self._folder_of(arm) is None:
                modelled = modelled_tracks(self.source.log, config)
                missing = (track for track in self._controlled() if track not in modelled)
                forced = (*config.force_dynamic, *missing)
                config = config.model_copy(update={"force_dynamic": forced})
            self._configs[arm.made_in] = config
        return self._configs[arm.made_in]

    def evaluation(self, arm: Arm) -> Artefact | None:
        """Held-out scores of an arm's reconstruction; None where no image was held out."""
        config = self.street_config(arm)
        if config.holdout_every == 0:
            return None
        return self._used(
            use_name("evaluation", arm.made_in),
            lambda: score_street(self.maker, self.source, self.scene(arm), config),
        )

    def registered(self, arm: Arm, track: str) -> Artefact:
        """A generated vehicle, registered to the log's boxes and LiDAR, with its evidence."""
        parts = VehicleParts(
            name=str(arm.generator),
            generator=self.sources.generators[str(arm.generator)],
            segmenter=self.sources.segmenters[str(arm.segmenter)],
            axes=str(arm.axes),
            views=arm.views or 1,
            makers=lambda: self.makers(arm),
        )
        return self._used(
            self._of_track("registered", arm, track),
            lambda: register_vehicle(
                self.maker, self.source, track, parts, self.config.seed, self.street_config(arm)
            ),
        )

    def actor(self, arm: Arm, track: str) -> Artefact:
        """The vehicle that an arm inserts: refined against its street, unless that is off."""
        use, registered = self._of_track("actor", arm, track), self.registered(arm, track)
        if not arm.refine:
            return self._used(use, lambda: registered)
        scene = self.scene(arm)
        return self._used(
            use, lambda: refine_vehicle(self.maker, registered, scene, self.config.seed)
        )

    def turntable(self, arm: Arm, track: str) -> Artefact:
        """A film of an arm's vehicle turning once."""
        return self._used(
            self._of_track("turntable", arm, track),
            lambda: film_vehicle(self.maker, self.actor(arm, track)),
        )

    def truth(self, arm: Arm) -> Artefact:
        """An arm's vehicle, and its street's own, against the truth in views beyond the log."""
        actor, scene = self.actor(arm, self.config.track), self.scene(arm)
        return self._used(
            use_name("truth", arm.name),
            lambda: compare_vehicle(
                self.maker, self.source, actor, scene, self.street_config(arm), self.config.seed
            ),
        )

    def images_of(self, arm: Arm) -> dict[str, Any]:
        """What keys of an arm's images need beside its vehicles."""
        given = arm.inputs()
        if self.config.restorer is not None and arm.restorable:
            given["restorer"] = self.sources.restorers[self.config.restorer]
        if arm.reconstructs:
            return {"street": self.scene(arm).reference, **given}
        light = {"lit_by": self.scene(arm).reference} if arm.generates else {}
        return {"street": "truth", **light, **given}

    def tracks(self) -> tuple[str, ...]:
        """All tracks whose vehicles some scenario wants replaced."""
        motions = self.config.motions
        return tuple(dict.fromkeys(t for name in motions for t in self.replaced_tracks(name)))

    def replaced_tracks(self, motion: str) -> tuple[str, ...]:
        """The target, further actors of a scenario whose vehicles are to be replaced too, and the
        vehicles that the configuration wants complete."""
        further = replaced_tracks(self.config.motion(motion))
        return tuple(dict.fromkeys((self.config.track, *further, *self.completion.tracks)))

    @cached_property
    def completion(self) -> CompletedVehicles:
        """Who beside the target is made complete; InputError: `choose_completed`."""
        config, words = self.config, self.config.complete
        if not words:
            return CompletedVehicles()
        generators = [str(arm.generator) for arm in self.arms.values() if arm.generates]
        if not generators:
            problem, mend = "is given, but no arm makes vehicles", "give an `arm` such as replaced"
            raise InputError("`complete`", ", ".join(words), problem, mend)
        return choose_completed(self.source.log, config.track, words, config.scene, generators)

    def rollout(
        self, motion: str, planner: str, arm: Arm, timings: Timings | None = None
    ) -> Artefact:
        """One rollout.

        Args:
            timings: timings that those of the rollout are added to, if it is made now.
        """
        config, looks = self.config, self.looks(planner)
        tracks, bare = self.replaced_tracks(motion), config.traffic == "none"
        inputs: dict[str, Any] = {
            "log": self.source.hash,
            "track": config.track,
            "scenario": scenario_record(config.motion(motion)),
            "arm": arm.name,
            "planner": self.sources.planners[planner],
            "planner_device": config.planner_device,
            "steps": config.steps,
            "plan_every": config.plan_every,
            # Without traffic, keys are those of earlier releases.
            **({"keep_other_actors": False} if bare else {"traffic": config.traffic}),
            "plan_limit_s": config.plan_limit_s,
            "films": config.films,
            "cameras": list(config.scene.cameras),
            "scale": config.scene.scale,
            "street": None,
            "actors": {},
            "recipe": RECIPES["rollout"],
        }
        if arm.start_left:
            inputs["start_left"] = arm.start_left
        if config.end_on_contact:
            inputs["end_on_contact"] = True
        if looks:
            inputs |= self.images_of(arm)
            if arm.generates:
                inputs["actors"] = {track: self.actor(arm, track).reference for track in tracks}
        setup = self.setup(motion, arm)

        def make(out: Path) -> None:
            renderer = meter = gap_meter = None
            if looks:
                mounts = self.mounts(planner)
                renderer = self.renderers.of(arm, tracks, planner, mounts)
                meter = self.renderers.meter(arm, tracks)
                gap_meter = self.renderers.gap_meter(arm, tracks)
            steps = self.possible_steps.get(motion, config.steps)
            with ProgressBar("steps", self.console, steps) as progress:
                make_rollout(
                    setup,
                    self.planner(planner),
                    renderer,
                    out,
                    progress.advance,
                    config.films,
                    timings,
                    meter,
                    gap_meter,
                )

        title = f"rollout {motion}, {planner}, {arm.name}"
        return self._used(
            rollout_name(motion, planner, arm.name),
            lambda: self.maker.make(
                title, "rollouts", inputs, make, f"{title}, {self.source.log.name}"
            ),
        )

    def agreement(self, planner: str) -> Artefact | None:
        """How a planner's plans on rendered images of the log's own moments agree with those on the
        recorded ones; None where it looks at no images or no arm shows a reconstruction."""
        looking, config = whole(self.planner(planner), BasePlanner), self.config
        arms = [arm for arm in self.arms.values() if arm.of_the_log]
        if not looking.needs_images or not arms:
            return None
        tracks, street = (config.track,), self.street_config(arms[0])
        inputs = {
            "log": self.source.hash,
            "track": config.track,
            "planner": self.sources.planners[planner],
            "planner_device": config.planner_device,
            "cameras": list(config.scene.cameras),
            "scale": config.scene.scale,
            "arms": {arm.name: self.images_of(arm) for arm in arms},
            "held_out": [street.holdout_every, street.holdout_offset],
            "actors": {a.name: self.actor(a, config.track).reference for a in arms if a.generates},
            "recipe": RECIPES["plans"],
        }
        title = f"plans of {planner} against the recording"

        def make(out: Path) -> None:
            cameras, scale = config.scene.cameras, config.scene.scale
            drive = RecordedDrive(self.source.log, looking, cameras=cameras, scale=scale)
            renderers = {
                arm.name: self.renderers.of(arm, tracks, f"{planner}, recording", drive.mounts)
                for arm in arms
            }
            with ProgressBar("moments", self.console) as progress:
                found, pictures = plan_agreement(
                    looking,
                    drive,
                    renderers,
                    held_out=lambda _, frame: is_held_out(frame, street),
                    progress=progress,
                )
            write_agreement(found, pictures, out)

        return self._used(
            use_name("plans", planner),
            lambda: self.maker.make(
                title, "evaluations", inputs, make, f"{title}, {self.source.log.name}"
            ),
        )

    def setup(self, motion: str, arm: Arm) -> RolloutSetup:
        """What a rollout of an arm is run with."""
        config, scripted = self.config, self.config.motion(motion)
        # The same for all arms and planners, and with films: they differ by nothing else.
        drive = (self.source.hash, config.track, scenario_record(scripted))
        return rollout_setup(
            self.source.log,
            self.source.map,
            config,
            scripted,
            arm.name,
            start_left=arm.start_left,
            seed=int(value_hash(drive)[:8], 16),
            plan_limit_s=config.plan_limit_s,
        )

    def close(self) -> None:
        """Let go of the renderers, and end the planners' processes."""
        self.renderers.close()
        for planner in self._planners.values():
            if isinstance(planner, PlannerProcess):
                planner.close()

    def _folder_of(self, arm: Arm) -> Path | None:
        """The folder of an arm's reconstruction, where that is not trained by this run."""
        if arm.made_in == OWN_STREET:
            return None if self.config.scene_folder is None else Path(self.config.scene_folder)
        return None if arm.made_in in PRESETS else Path(arm.made_in)

    def _controlled(self) -> tuple[str, ...]:
        """All tracks that a street must model: those that some scenario controls, the target
        first, and those that are named to be complete."""
        motions = [self.config.motion(name) for name in self.config.motions]
        further = [actor.track_id for motion in motions for actor in further_actors(motion)]
        named = (key for key in self.config.complete if key not in (ALL, NEAR))
        return tuple(dict.fromkeys((self.config.track, *further, *named)))

    def _of_track(self, what: str, arm: Arm, track: str) -> str:
        further = () if track == self.config.track else (track,)
        return use_name(what, arm.name, *further)

    def _used(self, use: str, make: Callable[[], Artefact]) -> Artefact:
        if use not in self.used:
            self.used[use] = make()
            self.on_use()
        return self.used[use]

    def _street(self, arm: Arm, tracks: tuple[str, ...]) -> StreetScene:
        street = load_scene(self.scene(arm).path)
        for track in tracks if arm.generates else ():
            street = insert(street, self._actor(arm, track), relit=arm.relit is not False)
        return street

    def _actor(self, arm: Arm, track: str) -> Actor:
        return load_actor(self.actor(arm, track).path / ACTOR_FOLDER)
