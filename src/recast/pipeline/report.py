"""Gather what a run made into the inputs of its report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from recast.actors import Actor, load_actor
from recast.actors.icp import INLIER_DISTANCE
from recast.errors import InputError
from recast.evaluation import rollout_metrics
from recast.logs import DrivingLog, HdMap, map_of, read_log
from recast.names import member
from recast.pipeline.config import RunConfig, config_of
from recast.pipeline.layout import (
    ACTOR_FOLDER,
    EVALUATION_FOLDER,
    METHODS,
    OBSERVATION_FOLDER,
    REPORT_FOLDER,
    SCENE_FOLDER,
    TRUTH_FOLDER,
    TURNTABLE_FILE,
    Method,
    final_actor,
    rollout_folder,
)
from recast.pipeline.results_files import read_evaluation
from recast.pipeline.rollouts import films, read_coverage, read_rollout
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
from recast.simulation import RolloutFailure

REGISTRATION_LIMIT = 0.15
"""Metres; a larger median LiDAR-to-actor distance is flagged on the page."""


def report_run(run: str | Path, out: str | Path | None = None) -> Path:
    """Write the report of a run, finished or not; return its `index.html`.

    Args:
        run: run folder.
        out: folder to write; RUN/report where none is named.

    Raises:
        InputError: `run` is no run folder, its log is gone, or `out` holds something else.
    """
    folder = RunFolder.open(run)
    log_path = Path(folder.record.log.path)
    if not log_path.is_dir():
        raise InputError(
            folder.path / RUN_FILE, "log.path", f"names {log_path}, which is not there",
            "put the log back, or run from the folder that `recast run` was called in",
        )  # fmt: skip
    log = read_log(log_path)
    _check_log(config_of(folder), log, folder.path / RUN_FILE)
    inputs = gather(folder, log)
    return write_report(inputs, folder.path / REPORT_FOLDER if out is None else Path(out))


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


def gather(folder: RunFolder, log: DrivingLog) -> ReportInputs:
    """Everything the page shows; what the run did not make yet says so."""
    config = config_of(folder)
    hd_map = map_of(log)
    methods: dict[str, str] = {method: METHODS[method] for method in config.methods}
    showcase, truth = _truth(folder.path, methods)
    category = log.tracks[config.track].category
    return ReportInputs(
        title=f"{category} {config.track} of {log.name}",
        log=log.name,
        methods=methods,
        truth_method="oracle" if "oracle" in methods else None,
        showcase=showcase,
        truth=truth,
        facts=_facts(config, log),
        actor=_actor(folder.path, config, log),
        scenarios=tuple(
            _scenario(folder.path, motion, config, hd_map) for motion in config.motions
        ),
        scene=_scene(folder.path),
        hd_map=hd_map,
        config=folder.record.config,
        provenance=ProvenancePart(
            versions=folder.record.versions,
            seeds={"run": config.seed, "scene": config.scene.seed},
            hashes={"log": folder.record.log.hash},
        ),
        timings=folder.timings() or NOT_MADE,
        warnings=_warnings(hd_map),
    )


def _facts(config: RunConfig, log: DrivingLog) -> tuple[Fact, ...]:
    cameras = config.scene.cameras or tuple(log.cameras)
    sizes = {
        f"{round(camera.width * config.scene.scale)} x {round(camera.height * config.scene.scale)}"
        for camera in (log.cameras[name].camera for name in cameras)
    }
    return (
        Fact("Planner", config.planner),
        Fact("Generator", config.generator),
        Fact("Segmenter", config.segmenter),
        Fact("Cameras", ", ".join(cameras)),
        Fact("Image size", ", ".join(sorted(sizes)), "pixels, as rendered"),
        Fact("Length asked for", f"{config.steps * 0.1:g} s", "cut where log or road end"),
    )


def _warnings(hd_map: HdMap) -> tuple[str, ...]:
    if not hd_map.derived:
        return ()
    return ("The log has no HD map: lanes and drivable area were derived from the drive itself.",)


def _truth(
    run: Path, methods: Mapping[str, str]
) -> tuple[ShowcasePart | NotMade, TruthPart | NotMade]:
    if not (run / TRUTH_FOLDER).is_dir():
        return NOT_MADE, NOT_MADE
    return truth_parts(run / TRUTH_FOLDER, methods, truth="oracle")


def _actor(run: Path, config: RunConfig, log: DrivingLog) -> ActorPart | NotMade:
    if not (run / ACTOR_FOLDER).is_dir():
        return NOT_MADE
    actor = load_actor(final_actor(run))
    provenance = actor.provenance
    report = provenance.registration
    frame = run / OBSERVATION_FOLDER / "frame.png"
    film = run / TURNTABLE_FILE
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
        turntable=film if film.exists() else NOT_MADE,
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
        log_path=log.tracks[config.track].trajectory.poses[:, :2, 3],
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


def _scenario(run: Path, name: str, config: RunConfig, hd_map: HdMap) -> ScenarioPart:
    motion = config.motion(name)
    return ScenarioPart(
        title=f"{motion.name}, setting {motion.setting}".capitalize(),
        description=motion.description,
        rollouts=tuple(
            _rollout(rollout_folder(run, name, method), method, hd_map) for method in config.methods
        ),
    )


def _rollout(folder: Path, method: Method, hd_map: HdMap) -> RolloutPart:
    if not folder.is_dir():
        return RolloutPart(method, NOT_MADE)
    rollout = read_rollout(folder)
    if isinstance(rollout, RolloutFailure):
        return RolloutPart(method, rollout, NotMade(rollout.reason), NotMade(rollout.reason))
    return RolloutPart(
        method, rollout, rollout_metrics(rollout, hd_map), films(folder), read_coverage(folder)
    )


def _scene(run: Path) -> ScenePart | NotMade:
    path = run / EVALUATION_FOLDER / "eval.json"
    if not path.exists():
        return NotMade("no image was held out" if path.parent.exists() else NOT_MADE.reason)
    evaluation = read_evaluation(path)
    scene = load_scene(run / SCENE_FOLDER)
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
