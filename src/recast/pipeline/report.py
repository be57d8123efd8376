"""Gather what a run made into the inputs of its report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from recast.actors import Actor, load_actor
from recast.actors.icp import INLIER_DISTANCE
from recast.core import Artefact, Store
from recast.errors import InputError
from recast.evaluation import RolloutMetrics, rollout_metrics
from recast.logs import DrivingLog, HdMap, map_of, read_log
from recast.names import member
from recast.pipeline.arms import Arm, truth_of
from recast.pipeline.artefacts import rollout_name
from recast.pipeline.config import RunConfig
from recast.pipeline.layout import (
    ACTOR_FOLDER,
    OBSERVATION_FOLDER,
    REPORT_FOLDER,
    TURNTABLE_FILE,
    VIEWS_FOLDER,
    use_name,
)
from recast.pipeline.results_files import read_evaluation
from recast.pipeline.rollouts import draw_films, films, read_coverage, read_rollout
from recast.pipeline.run_folder import RUN_FILE, RunFolder
from recast.reporting import (
    NOT_MADE,
    ActorPart,
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
    write_report,
)
from recast.reporting.actor_sheet import draw_all_around
from recast.reporting.scene_scores import depth_facts, score_lines
from recast.scene import load_scene
from recast.simulation import Rollout, RolloutFailure

REGISTRATION_LIMIT = 0.15
"""Metres; a larger median LiDAR-to-actor distance is flagged on the page."""


def report_run(run: str | Path, out: str | Path | None = None) -> Path:
    """Write the report of a run, finished or not; return its `index.html`.

    Args:
        run: run folder.
        out: folder to write; RUN/report where none is named.

    Raises:
        InputError: `run` is no run folder, its log or an artefact is gone, or `out` holds something
            else.
    """
    folder = RunFolder.open(run)
    log_path = folder.log_path
    if not log_path.is_dir():
        raise InputError(
            folder.path / RUN_FILE, "log.path", f"names {log_path}, which is not there",
            "put the log back, or move the run to where it was",
        )  # fmt: skip
    log = read_log(log_path)
    _check_log(folder.config, log, folder.path / RUN_FILE)
    inputs = _Gathered(folder, folder.store(), log, folder.config).inputs()
    return write_report(inputs, folder.path / REPORT_FOLDER if out is None else Path(out))


def report_rollout(rollout: Rollout, metrics: RolloutMetrics, out: Path) -> Path:
    """Write the page of one rollout; return its `index.html`.

    Args:
        rollout: one that was run in this process has films, which are drawn now.
        metrics: its scores.

    Raises:
        InputError: `out` holds something else, or the disk refuses.
    """
    with TemporaryDirectory(prefix="recast-") as folder:
        found = NOT_MADE if rollout.origin is None else draw_films(rollout, Path(folder))
        part = RolloutPart(rollout.arm, rollout, metrics, found)
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
                    record, "log.path", f"names a log without {kind} {name}",
                    "put the log back that was run on",
                )  # fmt: skip


@dataclass(frozen=True)
class _Gathered:
    """A run with all that the page shows; what it did not make yet says so."""

    folder: RunFolder
    store: Store
    log: DrivingLog
    config: RunConfig

    @cached_property
    def map(self) -> HdMap:
        return map_of(self.log)

    def inputs(self) -> ReportInputs:
        config, record = self.config, self.folder.record
        arms = {arm.name: arm.label for arm in config.arms}
        truth = truth_of(config.arms)
        shown = next((arm for arm in config.arms if arm.generates), None)
        street = next((arm for arm in config.arms if not arm.is_truth), None)
        showcase, views = self._truth(shown, arms, truth)
        return ReportInputs(
            title=f"{self.log.tracks[config.track].category} {config.track} of {self.log.name}",
            log=self.log.name,
            arms=arms,
            truth_arm=truth,
            showcase=showcase,
            truth=views,
            facts=_facts(config, self.log),
            actor=NOT_MADE if shown is None else self._actor(shown),
            scenarios=tuple(
                self._scenario(motion, planner)
                for motion in config.motions
                for planner in config.planners
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
            warnings=_warnings(self.map),
        )

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
        return _actor_part(
            load_actor(final.path / ACTOR_FOLDER),
            registered.path / OBSERVATION_FOLDER / "frame.png",
            None if turntable is None else turntable.path / TURNTABLE_FILE,
            self.log,
        )

    def _scenario(self, name: str, planner: str) -> ScenarioPart:
        motion = self.config.motion(name)
        title = f"{motion.name}, setting {motion.setting}".capitalize()
        if len(self.config.planners) > 1:
            title += f", {planner}"
        return ScenarioPart(
            title=title,
            description=motion.description,
            rollouts=tuple(self._rollout(name, planner, arm) for arm in self.config.arms),
        )

    def _rollout(self, motion: str, planner: str, arm: Arm) -> RolloutPart:
        found = self._find(rollout_name(motion, planner, arm.name))
        if found is None:
            return RolloutPart(arm.name, NOT_MADE)
        rollout = read_rollout(found.path)
        if isinstance(rollout, RolloutFailure):
            return RolloutPart(arm.name, rollout, NotMade(rollout.reason), NotMade(rollout.reason))
        return RolloutPart(
            arm.name, rollout, rollout_metrics(rollout, self.map), films(found.path),
            read_coverage(found.path),
        )  # fmt: skip

    def _scene(self, arm: Arm) -> ScenePart | NotMade:
        scene, scores = (self._find(use_name(what, arm.street)) for what in ("scene", "evaluation"))
        if scores is None or scene is None:
            return NotMade("no image was held out") if scene is not None else NOT_MADE
        return _scene_part(scores.path / "eval.json", scene.path)


def _facts(config: RunConfig, log: DrivingLog) -> tuple[Fact, ...]:
    cameras = config.scene.cameras or tuple(log.cameras)
    sizes = {
        f"{round(camera.width * config.scene.scale)} x {round(camera.height * config.scene.scale)}"
        for camera in (log.cameras[name].camera for name in cameras)
    }
    return (
        Fact("Planner" if len(config.planners) == 1 else "Planners", ", ".join(config.planners)),
        Fact("Generator", ", ".join(_parts(config, "generator"))),
        Fact("Segmenter", ", ".join(_parts(config, "segmenter"))),
        Fact("Cameras", ", ".join(cameras)),
        Fact("Image size", ", ".join(sorted(sizes)), "pixels, as rendered"),
        Fact("Length asked for", f"{config.steps * 0.1:g} s", "cut where log or road end"),
    )


def _warnings(hd_map: HdMap) -> tuple[str, ...]:
    if not hd_map.derived:
        return ()
    return ("The log has no HD map: lanes and drivable area were derived from the drive itself.",)


def _parts(config: RunConfig, name: str) -> list[str]:
    """What the arms with generated vehicles name, each once."""
    arms = [config.arm(arm.name) for arm in config.arms if arm.generates]
    return list(dict.fromkeys(str(getattr(arm, name)) for arm in arms)) or ["none"]


def _actor_part(actor: Actor, frame: Path, film: Path | None, log: DrivingLog) -> ActorPart:
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
                Fact("Seen from", f"{np.degrees(provenance.azimuth):.0f} degrees",
                     "azimuth of the camera about the vehicle: 0 ahead of it, 90 to its left"),
                Fact("Sides seen", ", ".join(provenance.sides_seen)),
                *(Fact("Why this view", line) for line in provenance.observation.splitlines()[:1]),
                Fact("Mask", "; ".join(provenance.mask.explain().splitlines()),
                     "by the logged box and the LiDAR"),
                *(Fact("Look at the mask", text) for text in provenance.mask.warnings()),
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
                Fact("Front", ", ".join(f"{k} {v:+.1f}" for k, v in report.front.votes.items()),
                     "evidence for the way the vehicle faces; negative speaks against it"),
                Fact(f"Within {INLIER_DISTANCE:g} m", f"{report.after.inlier_share:.0%}",
                     "share of LiDAR points this near to the actor"),
            ),
        ),
        log_path=log.tracks[actor.track_id].trajectory.poses[:, :2, 3],
        source=_source(actor),
        all_around=draw_all_around(actor),
        candidates=provenance.candidates if len(provenance.candidates) > 1 else (),
        refinement=()
        if provenance.refinement is None
        else tuple(provenance.refinement.explain().splitlines()),
    )  # fmt: skip


def _source(actor: Actor) -> str:
    """What an actor was made from, in words."""
    views, refinement = 1 + len(actor.provenance.further), actor.provenance.refinement
    words = "from one view in the log" if views == 1 else f"from {views} views in the log"
    if refinement is not None and refinement.kept:
        words += f", then refined by {refinement.images} images of it"
    return words


def _shares(counts: dict[str, int]) -> dict[str, float]:
    total = sum(counts.values())
    return {side: count / total for side, count in counts.items()} if total else {}


def _scene_part(path: Path, folder: Path) -> ScenePart:
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
