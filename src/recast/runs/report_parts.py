"""Parts of a run's report, each from what one step of the run left behind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from recast.actors import Actor
from recast.actors.icp import INLIER_DISTANCE
from recast.core.names import member
from recast.logs import DrivingLog, HdMap
from recast.reporting import (
    NOT_MADE,
    ActorPart,
    Comparison,
    Fact,
    ObservationPart,
    RegistrationPart,
    ScenePart,
)
from recast.reporting.actor_sheet import draw_all_around
from recast.reporting.tables import depth_facts, score_lines
from recast.runs.config import RunConfig
from recast.runs.scores import read_evaluation
from recast.scene import load_scene

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
        Fact("Requested length", f"{config.steps * 0.1:g} s", "less if the log or the road ends"),
    )


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
                    "azimuth of the camera about the vehicle: 0 ahead of it, 90 to its left",
                ),
                Fact("Sides seen", ", ".join(provenance.sides_seen)),
                *(Fact("Why this view", line) for line in provenance.observation.splitlines()[:1]),
                Fact(
                    "Mask",
                    "; ".join(provenance.mask.explain().splitlines()),
                    "compared with the logged box and the LiDAR",
                ),
                *(Fact("Check the mask", text) for text in provenance.mask.warnings()),
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
                    "evidence for the heading of the vehicle; negative values: evidence against it",
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
