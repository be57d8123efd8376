"""Gather what runs made into the inputs of a report, or of the page that compares them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from recast.actors import Actor, load_actor
from recast.actors.icp import INLIER_DISTANCE
from recast.core import Artefact, Store
from recast.core.errors import InputError
from recast.core.files import member
from recast.logs import DrivingLog, HdMap, map_of, read_log
from recast.logs.types import PEOPLE
from recast.metrics import RolloutMetrics, own_metrics
from recast.reporting import (
    NOT_MADE,
    ActorPart,
    ComparedRun,
    Comparison,
    Fact,
    NotMade,
    ObservationPart,
    ProvenancePart,
    RegistrationPart,
    ReportInputs,
    RolloutPart,
    ScenarioPart,
    ScenePart,
    ShowcasePart,
    TruthPart,
    truth_parts,
    write_comparison,
    write_report,
)
from recast.reporting.page import check_out
from recast.reporting.previews import draw_all_around
from recast.reporting.tables import depth_facts, score_lines
from recast.runs.arms import Arm, truth_of
from recast.runs.completion import choose_completed
from recast.runs.config import RunConfig
from recast.runs.rollouts import draw_films, films
from recast.runs.run_folder import (
    ACTOR_FOLDER,
    OBSERVATION_FOLDER,
    REPLAY_FILE,
    REPORT_FOLDER,
    RUN_FILE,
    TURNTABLE_FILE,
    VIEWS_FOLDER,
    RunFolder,
    use_name,
)
from recast.runs.scores import (
    RunTrust,
    ScoredRollout,
    read_evaluation,
    scored_rollouts,
    trust_of_process,
)
from recast.scene import load_scene
from recast.simulation import Rollout, RolloutFailure
from recast.simulation.rollout import ANY_VEHICLE


def report_run(run: str | Path, out: str | Path | None = None) -> Path:
    """Write the report of a run, finished or not; return its `index.html`.

    Args:
        out: folder to write; RUN/report where none is named.

    Raises:
        InputError: `run` is no run folder, its log or an artefact is gone, or `out` holds something
            else.
    """
    gathered = open_run(run)
    folder = gathered.folder.path
    return write_report(gathered.inputs(), folder / REPORT_FOLDER if out is None else Path(out))


def open_run(run: str | Path) -> GatheredRun:
    """A run folder with its log and its store.

    Raises:
        InputError: `run` is no run folder, or its log is gone.
    """
    folder = RunFolder.open(run)
    log_path = folder.log_path
    if not log_path.is_dir():
        raise InputError(
            folder.path / RUN_FILE,
            "log.path",
            f"names {log_path}, which does not exist",
            "put the log back, or move the run folder back",
        )
    log = read_log(log_path)
    _check_log(folder.config, log, folder.path / RUN_FILE)
    return GatheredRun(folder, folder.store(), log, folder.config)


def report_rollout(rollout: Rollout, metrics: RolloutMetrics, out: Path) -> Path:
    """Write the page of one rollout; return its `index.html`.

    Args:
        rollout: one that was run in this process has films, which are drawn now.

    Raises:
        InputError: `out` holds something else, or the disk refuses.
    """
    with TemporaryDirectory(prefix="recast-") as folder:
        found = NOT_MADE if rollout.origin is None else draw_films(rollout, Path(folder))
        trust = trust_of_process(rollout, metrics)
        part = RolloutPart(rollout.arm, rollout, metrics, found, trust=trust)
        title = f"{rollout.motion}, setting {rollout.setting}".capitalize()
        facts = (
            Fact("Planner", rollout.planner),
            Fact("Length", f"{rollout.steps_run * rollout.dt:g} s", rollout.cut_reason or ""),
        )
        inputs = ReportInputs(
            title=f"{rollout.name} by {rollout.planner}",
            log="a log" if rollout.origin is None else rollout.origin.setup.log.name,
            arms={rollout.arm: rollout.arm},
            facts=facts,
            scenarios=(ScenarioPart(title, "", (part,)),),
            hd_map=NOT_MADE if rollout.origin is None else rollout.origin.setup.hdmap or NOT_MADE,
        )
        return write_report(inputs, out)


def _check_log(config: RunConfig, log: DrivingLog, record: Path) -> None:
    """Refuse a log that took the place of the one that was run on."""
    wanted = {"track": ((config.track,), log.tracks), "camera": (config.scene.cameras, log.cameras)}
    for kind, (names, there) in wanted.items():
        for name in names:
            if name not in there:
                raise InputError(
                    record,
                    "log.path",
                    f"names a log without {kind} {name}",
                    "put back the log that the run used",
                )


@dataclass(frozen=True)
class GatheredRun:
    """A run with all that a page shows; what it did not make yet says so."""

    folder: RunFolder
    store: Store
    log: DrivingLog
    config: RunConfig

    @cached_property
    def map(self) -> HdMap:
        """Lanes and drivable area that the rollouts are judged by."""
        return map_of(self.log)

    @cached_property
    def trust(self) -> RunTrust:
        """Judges its rollouts."""
        return RunTrust(self.log, self.config.track)

    @property
    def arms(self) -> dict[str, str]:
        """Arm to its name for people."""
        category = self.log.tracks[self.config.track].category
        noun = category if category in PEOPLE else ANY_VEHICLE
        return {arm.name: arm.label(noun) for arm in self.config.arms}

    def inputs(self) -> ReportInputs:
        """Everything that the report shows."""
        config, record = self.config, self.folder.record
        arms, truth = self.arms, truth_of(config.arms)
        shown = next((arm for arm in config.arms if arm.generates), None)
        street = next((arm for arm in config.arms if not arm.is_truth), None)
        showcase, views = self._truth(shown, arms, truth)
        return ReportInputs(
            title=f"What if {self.log.tracks[config.track].category} {config.track} of "
            f"{self.log.name} had moved otherwise?",
            log=self.log.name,
            arms=arms,
            truth_arm=truth,
            showcase=showcase,
            truth=views,
            facts=facts(config, self.log),
            actor=NOT_MADE if shown is None else self._actor(shown),
            scenarios=tuple(
                self.scenario(*names) for names in product(config.motions, config.planners)
            ),
            scene=NOT_MADE if street is None else self._scene(street),
            hd_map=self.map,
            config=record.config,
            provenance=ProvenancePart(
                versions=record.versions,
                seeds={"run": config.seed, "scene": config.scene.seed},
                hashes={"log": record.log.hash, **record.artefacts},
            ),
            timings=self._timings() or NOT_MADE,
            warnings=warnings(self.map),
            recording=tuple(
                found.path
                for planner in config.planners
                if (found := self._find(use_name("plans", planner))) is not None
            ),
            replay=self._replay(),
            camera_headings=headings(self.log),
        )

    def _replay(self) -> Path | NotMade:
        path = self.folder.path / REPLAY_FILE
        return path if path.is_file() else NotMade("recast run writes it if viser is installed")

    def _find(self, use: str) -> Artefact | None:
        return self.folder.artefact(self.store, use)

    def _timings(self) -> dict[str, float]:
        """Seconds that each artefact of the run took, whichever run made it."""
        found = {use: self._find(use) for use in self.folder.record.artefacts}
        return {use: one.record.seconds for use, one in found.items() if one is not None}

    def _truth(
        self, arm: Arm | None, arms: Mapping[str, str], truth: str | None
    ) -> tuple[ShowcasePart | NotMade, TruthPart | NotMade]:
        found = None if arm is None else self._find(use_name("truth", arm.name))
        if found is None or truth is None or arm is None:
            return NOT_MADE, NOT_MADE
        own = next((a.name for a in self.config.arms if a.street == arm.street and a != arm), None)
        return truth_parts(
            found.path / VIEWS_FOLDER, arms, baseline=own, candidate=arm.name, truth=truth
        )

    def _actor(self, arm: Arm) -> ActorPart | NotMade:
        final, registered, turntable = (
            self._find(use_name(what, arm.name)) for what in ("actor", "registered", "turntable")
        )
        if final is None or registered is None:
            return NOT_MADE
        return actor_part(
            load_actor(final.path / ACTOR_FOLDER),
            registered.path / OBSERVATION_FOLDER / "frame.png",
            None if turntable is None else turntable.path / TURNTABLE_FILE,
            self.log,
        )

    def rollouts(self) -> Iterator[ScoredRollout]:
        """Those that were made and did not fail."""
        for motion, planner in product(self.config.motions, self.config.planners):
            for one in self._scored(motion, planner).values():
                if isinstance(one, ScoredRollout):
                    yield one

    def _scored(self, motion: str, planner: str) -> dict[str, ScoredRollout | RolloutFailure]:
        own = own_metrics(self.config.metrics)
        return scored_rollouts(motion, planner, self.config.arms, self._find, self.map, own)

    def scenario(self, name: str, planner: str) -> ScenarioPart:
        """The rollouts of a motion under each arm."""
        motion = self.config.motion(name)
        title = motion.name.capitalize()
        if [self.config.motion(one).name for one in self.config.motions].count(motion.name) > 1:
            title += f", setting {motion.setting}"
        if len(self.config.planners) > 1:
            title += f", {planner}"
        arms, scored = self.config.arms, self._scored(name, planner)
        return ScenarioPart(
            title=title,
            description=motion.description,
            rollouts=tuple(self._rollout(arm, scored.get(arm.name)) for arm in arms),
        )

    def _rollout(self, arm: Arm, found: ScoredRollout | RolloutFailure | None) -> RolloutPart:
        if found is None:
            return RolloutPart(arm.name, NOT_MADE)
        if isinstance(found, RolloutFailure):
            return RolloutPart(arm.name, found, NotMade(found.reason), NotMade(found.reason))
        metrics, shown = found.metrics, films(found.folder)
        trust = self.trust.of(found)
        measured = found.coverage, trust, found.gaps
        return RolloutPart(arm.name, metrics.rollout, metrics, shown, *measured)

    def _scene(self, arm: Arm) -> ScenePart | NotMade:
        scene, scores = (self._find(use_name(what, arm.street)) for what in ("scene", "evaluation"))
        if scores is None or scene is None:
            return NotMade("no image was held out") if scene is not None else NOT_MADE
        return scene_part(scores.path / "eval.json", scene.path)


def compare_runs(runs: Sequence[str | Path], out: str | Path) -> Path:
    """Write a page that compares runs, the others with the first; return its `index.html`.

    The runs may be of different logs, and unfinished.

    Raises:
        InputError: fewer than two runs, a folder that is no run or is named twice, a log or an
            artefact that is gone, or `out` holds something else.
    """
    folders = [Path(run) for run in runs]
    if len(folders) < 2:
        raise InputError(
            "`compare`", "runs", f"only {len(folders)} given", "name two or more run folders"
        )
    places = [folder.resolve() for folder in folders]
    for folder, place in zip(folders, places, strict=True):
        if places.count(place) > 1:
            raise InputError(folder, "run", "is named twice", "name each run once")
    check_out(Path(out))
    opened = [open_run(folder) for folder in folders]
    names = _names(places)
    return write_comparison([_compared(*one) for one in zip(names, opened, strict=True)], out)


def _names(places: Sequence[Path]) -> list[str]:
    """Names of the folders, with as many of their parents as it takes to tell them apart."""
    for parts in range(1, max(len(place.parts) for place in places)):
        names = ["/".join(place.parts[-parts:]) for place in places]
        if len(set(names)) == len(names):
            return names
    return [str(place) for place in places]


def _compared(name: str, run: GatheredRun) -> ComparedRun:
    record, config = run.folder.record, run.config
    return ComparedRun(
        name=name,
        log=run.log.name,
        log_hash=record.log.hash,
        target=config.track,
        arms=run.arms,
        scenarios={
            (config.motion(motion).name, config.motion(motion).setting, planner): run.scenario(
                motion, planner
            )
            for motion, planner in product(config.motions, config.planners)
        },
        settings={
            **config.resolved(),
            "log": {"name": run.log.name, "hash": record.log.hash},
            "versions": record.versions,
        },
        hd_map=run.map,
        camera_headings=headings(run.log),
    )


REGISTRATION_LIMIT = 0.15
"""Metres; a larger median LiDAR-to-actor distance is flagged on the page."""


def facts(config: RunConfig, log: DrivingLog) -> tuple[Fact, ...]:
    """Planner, generator, cameras and the like."""
    cameras = config.scene.cameras or tuple(log.cameras)
    sizes = {
        f"{round(camera.width * config.scene.scale)} x {round(camera.height * config.scene.scale)}"
        for camera in (log.cameras[name].camera for name in cameras)
    }
    restored: tuple[Fact, ...] = ()
    if config.restorer is not None:
        restored = (
            Fact("Restorer", config.restorer, "used on all images except images of the truth"),
        )
    return (
        Fact("Planner" if len(config.planners) == 1 else "Planners", ", ".join(config.planners)),
        Fact("Generator", ", ".join(_parts(config, "generator"))),
        Fact("Segmenter", ", ".join(_parts(config, "segmenter"))),
        Fact("Cameras", ", ".join(cameras)),
        Fact("Image size", ", ".join(sorted(sizes)), "pixels, as rendered"),
        *restored,
        *_others(config, log),
        Fact("Requested length", f"{config.steps * 0.1:g} s", "less if the log or the road ends"),
    )


def _others(config: RunConfig, log: DrivingLog) -> list[Fact]:
    """Road users beside the target, and traffic; nothing where the run asks for neither."""
    found = []
    generators = [str(arm.generator) for arm in config.arms if arm.generates]
    if config.complete and generators:
        chosen = choose_completed(log, config.track, config.complete, config.scene, generators)
        left = "; ".join(f"track {key} as reconstructed: {why}" for key, why in chosen.left)
        found.append(Fact("Complete, too", ", ".join(chosen.tracks) or "none", left))
    if config.traffic != "none":
        found.append(Fact("Traffic", config.traffic, "other recorded road users"))
    return found


def headings(log: DrivingLog) -> dict[str, float]:
    """Heading of each camera, radians about the vertical, 0 ahead, positive to the left."""
    axes = {name: camera.rig_from_camera[:3, 2] for name, camera in log.cameras.items()}
    return {name: float(np.arctan2(axis[1], axis[0])) for name, axis in axes.items()}


def warnings(hd_map: HdMap) -> tuple[str, ...]:
    """What the reader has to know before trusting the page."""
    if not hd_map.derived:
        return ()
    return ("The log has no HD map: lanes and drivable area were derived from the drive itself.",)


def _parts(config: RunConfig, name: str) -> list[str]:
    """What the arms with generated vehicles name, each once."""
    arms = [config.arm(arm.name) for arm in config.arms if arm.generates]
    return list(dict.fromkeys(str(getattr(arm, name)) for arm in arms)) or ["none"]


def actor_part(actor: Actor, frame: Path, film: Path | None, log: DrivingLog) -> ActorPart:
    """The vehicle that was made.

    Args:
        frame: camera frame that it was seen in.
    """
    provenance = actor.provenance
    report = provenance.registration
    return ActorPart(
        name=f"track {actor.track_id} ({actor.category})",
        generator=provenance.generator,
        observation=ObservationPart(
            crop=actor.source,
            frame=frame if frame.exists() else NOT_MADE,
            facts=(
                Fact("View", f"{provenance.camera}, frame {provenance.frame}"),
                Fact(
                    "Seen from",
                    f"{np.degrees(provenance.azimuth):.0f} degrees",
                    "azimuth of the camera about the target: 0 ahead of it, 90 to its left",
                ),
                Fact("Sides seen", ", ".join(provenance.sides_seen)),
                *(Fact("Why this view", line) for line in provenance.observation.splitlines()[:1]),
                Fact(
                    "Mask",
                    "; ".join(provenance.mask.explain().splitlines()),
                    "compared with the logged box and the LiDAR",
                ),
                *(Fact("Check the image", text) for text in provenance.warnings()),
            ),
        ),
        turntable=NOT_MADE if film is None else film,
        registration=RegistrationPart(
            median_before=report.before.median,
            median_after=report.after.median,
            limit=REGISTRATION_LIMIT,
            points=report.lidar_points,
            scale=report.icp_scale,
            yaw=report.icp_yaw,
            translation=np.array(report.icp_translation),
            size_misfit=np.array([report.width_over_box, report.height_over_box]),
            sides=_shares(report.lidar_by_side),
            facts=(
                Fact(
                    "Front",
                    ", ".join(f"{k} {v:+.1f}" for k, v in report.front.votes.items()),
                    "evidence for the heading of the target; negative values: evidence against it",
                ),
                Fact(
                    f"Within {INLIER_DISTANCE:g} m",
                    f"{report.after.inlier_share:.0%}",
                    "share of LiDAR points within this distance of the actor",
                ),
            ),
        ),
        log_path=log.tracks[actor.track_id].trajectory.poses[:, :2, 3],
        source=_source(actor),
        all_around=draw_all_around(actor),
        candidates=provenance.candidates if len(provenance.candidates) > 1 else (),
        refinement=()
        if provenance.refinement is None
        else tuple(provenance.refinement.explain().splitlines()),
    )


def _source(actor: Actor) -> str:
    """What an actor was made from, in words."""
    views, refinement = 1 + len(actor.provenance.further), actor.provenance.refinement
    words = "from one view in the log" if views == 1 else f"from {views} views in the log"
    if refinement is not None and refinement.kept:
        words += f", then refined with {refinement.images} images of it"
    return words


def _shares(counts: dict[str, int]) -> dict[str, float]:
    total = sum(counts.values())
    return {side: count / total for side, count in counts.items()} if total else {}


def scene_part(path: Path, folder: Path) -> ScenePart:
    """The street on images that were held out.

    Args:
        path: eval.json of the evaluation.
    """
    evaluation = read_evaluation(path)
    scene = load_scene(folder)
    frames: list[dict[str, Any]] = evaluation["frames"]
    actors = sum(len(actor.gaussians) for actor in scene.actors.values())
    return ScenePart(
        scores=score_lines(evaluation),
        comparisons=tuple(
            Comparison(
                f"{frame['camera']}, frame {frame['frame']}: {frame['psnr']:.1f} dB",
                {"recorded, rendered, difference x 3": _picture(path, frame)},
            )
            for frame in frames
        ),
        facts=(
            Fact("Gaussians of the background", f"{len(scene.background):,}"),
            Fact("Gaussians of the actors", f"{actors:,}"),
            Fact("Actors", ", ".join(scene.actors)),
        ),
        depth=depth_facts(evaluation),
    )


def _picture(evaluation: Path, frame: dict[str, Any]) -> Path:
    return member(evaluation.parent, frame["picture"], evaluation, "picture")
