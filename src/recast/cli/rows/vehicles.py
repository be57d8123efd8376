"""Rows of the commands that make or judge vehicles, planners and models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from recast.actors.actor import CandidateRecord
from recast.cli.shared import Rows, with_unit
from recast.core.errors import InputError
from recast.recar.statistics import SetStatistics
from recast.recar.target_cache import TargetCache
from recast.recar.targets import TargetStatistics
from recast.recar.turntable import TurntableFit
from recast.recar.vehicle_set import VehicleSet
from recast.studies.actors import ActorEvaluation, TrackResult
from recast.studies.generation.report import STUDY_COLUMNS, StudyBlock
from recast.trellis.checkpoints import ModelCheck


def camera_rows(
    vehicle_set: VehicleSet, fits: Mapping[str, TurntableFit | InputError]
) -> dict[str, list[dict[str, Any]]]:
    """Camera of each vehicle of a turntable; `centre` is the box centre's mean offset.

    The offset is from the middle of the image, x to the right, y down. `problem` says why a vehicle
    has no camera.
    """
    rows: list[dict[str, Any]] = []
    record = vehicle_set.record
    for name, fit in fits.items():
        if isinstance(fit, InputError):
            rows.append({"vehicle": name, "problem": fit.line(None)})
            continue
        size = vehicle_set.identities[name].record.size
        x, y = fit.centres.mean(axis=0) - [record.width / 2, record.height / 2]
        rows.append(
            {
                "vehicle": name,
                "problem": None,
                "views": fit.views,
                "elevation_deg": fit.elevation_deg,
                "fov_deg": fit.fov_deg,
                "distance_lengths": fit.distance,
                "distance_m": None if size is None else fit.distance * size[0],
                "centre_x_px": x,
                "centre_y_px": y,
                "residual_px": fit.residual_px,
            }
        )
    return {"cameras": rows}


def candidate_rows(candidates: Sequence[CandidateRecord]) -> Rows:
    """One row for each vehicle that an actor was chosen from; scores are null if it was not made.

    Shares are fractions (0 to 1).
    """
    of_score = {
        "fits": "fits",
        "outline_iou": "outline",
        "lidar_share": "lidar",
        "lidar_median_m": "lidar_median",
        "free_space_share": "free",
        "colour_difference": "colour",
        "score": "total",
    }
    return {
        "candidates": [
            {
                **{key: getattr(one, key) for key in ("generator", "seed", "label", "chosen")},
                **{
                    key: None if one.score is None else getattr(one.score, name)
                    for key, name in of_score.items()
                },
            }
            for one in candidates
        ]
    }


def actor_rows(evaluation: ActorEvaluation) -> Rows:
    """Mean scores of each vehicle and of all, and the vehicles that could not be made."""
    vehicles = [
        {"vehicle": one.id, "views": len(one.views), **_scores(one.mean)}
        for one in evaluation.vehicles
    ]
    views = sum(len(one.views) for one in evaluation.vehicles)
    failures = [{"vehicle": name, "reason": why} for name, why in evaluation.failures.items()]
    return {
        "vehicles": vehicles,
        "mean": [
            {
                "generator": evaluation.generator,
                "seed": evaluation.seed,
                "vehicles": len(vehicles),
                "views": views,
                **_scores(evaluation.mean),
            }
        ],
        "failures": failures,
    }


def track_rows(results: Sequence[TrackResult]) -> Rows:
    """One row for each track and model."""
    return {
        "tracks": [
            {
                "track_id": one.track_id,
                "model": model,
                "images": one.images,
                "psnr_db": one.psnr[model],
                "ssim": one.ssim[model],
            }
            for one in results
            for model in one.psnr
        ]
    }


def study_rows(blocks: Sequence[StudyBlock]) -> Rows:
    """Scores of each model by condition, paired differences, and vehicles that were not made."""
    models, differences, failures = [], [], []
    for block in blocks:
        models += [
            {
                "condition": block.condition,
                "model": row.model,
                "made": row.made,
                "vehicles": len(block.identities),
                "views": block.views,
                **_scores(row.scores),
            }
            for row in block.rows
        ]
        differences += [
            {
                "condition": block.condition,
                "candidate": one.candidate,
                "baseline": one.baseline,
                "score": one.score,
                "unit": STUDY_COLUMNS[one.score].unit,
                "mean": one.interval.point,
                "low": one.interval.low,
                "high": one.interval.high,
                "better": one.better,
            }
            for one in block.differences
        ]
        failures += [
            {"condition": block.condition, "model": model, "vehicle": vehicle, "reason": why}
            for model, failed in block.failures.items()
            for vehicle, why in failed.items()
        ]
    return {"models": models, "differences": differences, "failures": failures}


def _scores(scores: Mapping[str, float]) -> dict[str, float]:
    return {_key(name): value for name, value in scores.items()}


def _key(score: str) -> str:
    """The key of a score; CLIP scores are cosines times 100, which is no unit."""
    unit = STUDY_COLUMNS[score].unit
    return with_unit(score, "" if unit == "x100" else unit)


def check_rows(checks: Sequence[ModelCheck]) -> Rows:
    """One row for each model of a folder; `problem` is null if nothing is wrong."""
    rows = []
    for check in checks:
        fault = check.fault()
        rows.append(
            {
                "role": check.role,
                "class": check.class_name,
                "file": check.file,
                "tensors": None if check.found is None else len(check.found),
                "tensors_expected": None if check.expected is None else len(check.expected),
                "size_bytes": check.bytes_found,
                "parameters": check.parameters,
                "note": check.note or None,
                "problem": None if fault is None else str(fault),
            }
        )
    return {"models": rows}


def set_rows(statistics: SetStatistics) -> Rows:
    """Counts of a vehicle set, its kinds and colours, and the sizes of its vehicles."""
    total = {
        "identities": statistics.identities,
        "train": statistics.splits["train"],
        "held_out": statistics.splits["held-out"],
        "pictures": statistics.pictures,
        "size_bytes": statistics.bytes,
        "decided": statistics.decided,
        "left_out": statistics.left_out,
    }
    sizes = statistics.sizes or ()
    return {
        "set": [total],
        "kinds": _counts("kind", statistics.kinds),
        "colours": _counts("colour", statistics.colours),
        "sizes": [
            {"statistic": statistic, "length_m": size[0], "width_m": size[1], "height_m": size[2]}
            for statistic, size in zip(("minimum", "median", "maximum"), sizes, strict=False)
        ],
    }


def target_rows(cache: TargetCache, statistics: TargetStatistics) -> Rows:
    """Counts of a target cache, and the reasons for missing targets."""
    least, median, most = statistics.voxels
    total: dict[str, Any] = {
        "model": cache.record.model.name,
        "done": statistics.done,
        "failed": sum(statistics.failures.values()),
        "accepted_train": statistics.accepted["train"],
        "accepted_held_out": statistics.accepted["held-out"],
        "below_threshold": statistics.below,
        "rejected": statistics.rejected,
        "doubtful": statistics.doubtful,
        "voxels_minimum": least,
        "voxels_median": median,
        "voxels_maximum": most,
        "score": cache.record.filter.score or None,
        "threshold": cache.record.filter.threshold,
    }
    reasons = [
        {"reason": reason, "vehicles": count} for reason, count in statistics.failures.items()
    ]
    return {"targets": [total], "failures": reasons}


def _counts(name: str, counts: Mapping[str, int]) -> list[dict[str, Any]]:
    return [{name: one, "identities": count} for one, count in counts.items()]
