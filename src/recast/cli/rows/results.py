"""Rows of the commands that drive, and of those that make or judge vehicles and models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from recast.actors.actor import CandidateRecord
from recast.cli.shared import Rows, with_unit
from recast.core.errors import InputError
from recast.metrics import column_of
from recast.metrics.plan_agreement import PlanAgreement
from recast.metrics.scene_level_table import LevelRow
from recast.metrics.table import Bootstrap
from recast.metrics.trust import Reliability
from recast.recar.screening import SetStatistics
from recast.recar.target_cache import TargetCache
from recast.recar.targets import TargetStatistics
from recast.recar.turntable import TurntableFit
from recast.recar.vehicle_set import VehicleSet
from recast.runs.run_folder import METRICS_FILE
from recast.runs.scores import read_metrics
from recast.studies.closed_loop import GridResults
from recast.studies.generation.report import STUDY_COLUMNS, StudyBlock
from recast.studies.logged_vehicles import HiddenResult, TrackResult
from recast.studies.photographs import PHOTOGRAPH_COLUMNS, PhotographEvaluation
from recast.studies.planner_driving import PlannerDriving
from recast.studies.verdicts import PartLoss, VerdictCounts
from recast.trellis.checkpoints import ModelCheck


def run_rows(folder: Path) -> Rows:
    """The arms of a finished run, the trust in its verdicts, and its failed rollouts.

    Raises:
        InputError: the folder holds no metrics that this version reads.
    """
    metrics = read_metrics(folder / METRICS_FILE)
    failures = [{"rollout": one["name"], "reason": one["reason"]} for one in metrics["failures"]]
    trust = [
        {
            "rollout": one["name"],
            "planner": one["planner"],
            "trust": one["trust"]["value"],
            "reason": one["trust"]["words"],
        }
        for one in metrics["rollouts"]
        if one["trust"] is not None
    ]
    arms = [_arm(row) for row in metrics["table"]]
    return {"arms": arms, "trust": trust, "failures": failures}


def grid_rows(results: GridResults) -> Rows:
    """Arms with intervals over scenes, paired differences, verdicts, and failed rollouts."""
    arms = [
        {
            **_arm(line.row.to_json()),
            **{
                with_unit(f"{name}_{end}", column_of(name).unit): getattr(interval, end)
                for name, interval in line.intervals.items()
                for end in ("low", "high")
            },
        }
        for line in results.table
    ]
    differences = [
        {
            **{key: value for key, value in vars(one).items() if key not in ("sampled", "exact")},
            "unit": column_of(one.metric).unit,
            "mean": one.sampled.point,
            **_interval("sampled", one.sampled),
            **_interval("exact", one.exact),
        }
        for one in results.differences
    ]
    failures = [
        {
            "scene": row.scene,
            "motion": f"{row.motion}-{row.setting}",
            "planner": row.planner,
            "arm": row.arm,
            "error": row.failure,
            "reason": row.failure_reason,
        }
        for row in results.rows
        if row.failure is not None
    ]
    return {
        "arms": arms,
        "differences": differences,
        "against_the_truth": [
            {**_verdicts(one), **_floor(one, results.floors.get(one.planner))}
            for one in results.truth
        ],
        "decomposition": [_loss(one) for one in results.losses],
        "failures": failures,
    }


def trust_rows(found: Mapping[str, Reliability]) -> Rows:
    """Scores of a trust figure, and its bins; `data` is "left out" or "validation"."""
    names = ("scenes", "rollouts", "agreeing", "auc", "verdict_auc", "brier", "base_brier")
    scores = [
        {"data": data, **{name: getattr(one, name) for name in names}}
        for data, one in found.items()
    ]
    bins = [{"data": data, **vars(b)} for data, one in found.items() for b in one.bins]
    return {"scores": scores, "bins": bins}


def level_rows(lines: Sequence[LevelRow]) -> Rows:
    """One row for each arm and score, with intervals over scenes; scores have no unit."""
    rows = []
    for line in lines:
        for score, value in line.values.items():
            difference = value.difference or (None, None, None)
            rows.append(
                {
                    "arm": line.arm,
                    "images": line.images,
                    "score": score,
                    **vars(value),
                    "difference": difference[0],
                    "difference_low": difference[1],
                    "difference_high": difference[2],
                }
            )
    return {"scores": rows}


def _arm(row: Mapping[str, Any]) -> dict[str, Any]:
    counted = ("planner", "arm", "asked", "rollouts", "failed", "cut", "plans")
    known = row["means"]
    return {
        **{name: row[name] for name in counted},
        **{with_unit(name, column_of(name).unit): row["means"][name] for name in known},
        **{f"{name}_rollouts": row["counts"][name] for name in known},
    }


def _interval(name: str, interval: Bootstrap | None) -> dict[str, float | None]:
    if interval is None:
        return {f"{name}_low": None, f"{name}_high": None}
    return {f"{name}_low": interval.low, f"{name}_high": interval.high}


def _verdicts(one: VerdictCounts) -> dict[str, Any]:
    error = one.ttc_error
    return {
        "planner": one.planner,
        "arm": one.arm,
        "same_verdict": one.agreeing,
        "pairs": one.pairs,
        "asked": one.asked,
        "same_verdict_percent": 100 * one.share.point,
        "same_verdict_low_percent": 100 * one.share.low,
        "same_verdict_high_percent": 100 * one.share.high,
        "false_collisions": one.false_collisions,
        "missed_collisions": one.missed_collisions,
        "ttc_error_s": None if error is None else error.point,
        "ttc_error_low_s": None if error is None else error.low,
        "ttc_error_high_s": None if error is None else error.high,
        "plans": one.plans,
        "cut": one.cut,
    }


def _floor(one: VerdictCounts, floor: VerdictCounts | None) -> dict[str, float | None]:
    ratio = one.over(floor)
    return {
        "noise_floor_percent": None if floor is None else 100 * floor.share.point,
        "of_noise_floor_percent": None if ratio is None else 100 * ratio,
    }


def _loss(one: PartLoss) -> dict[str, Any]:
    return {
        **{key: value for key, value in vars(one).items() if key != "loss"},
        "loss_percent": 100 * one.loss.point,
        "loss_low_percent": 100 * one.loss.low,
        "loss_high_percent": 100 * one.loss.high,
    }


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


def photograph_rows(evaluation: PhotographEvaluation) -> Rows:
    """Scores of each vehicle and means by generator, and the vehicles that could not be made."""
    vehicles, means, failures = [], [], []
    for one in evaluation.generators:
        for vehicle in one.vehicles:
            who = {"generator": one.name, "vehicle": vehicle.id, "views": len(vehicle.views)}
            vehicles.append({**who, **_scores(vehicle.mean)})
        for over, mean in (("all", one.mean), ("far", one.far)):
            who = {"generator": one.name, "seed": evaluation.seed, "over": over}
            means.append({**who, **_scores(mean)})
        failures += [
            {"generator": one.name, "vehicle": name, "reason": why}
            for name, why in one.failures.items()
        ]
    return {"vehicles": vehicles, "mean": means, "failures": failures}


def hidden_rows(results: Sequence[HiddenResult]) -> Rows:
    """Scores of the hidden images of each track by model."""
    rows = [
        {
            "track": one.track_id,
            "degrees": one.degrees,
            "model": model,
            "images_kept": one.kept,
            "images_hidden": one.hidden,
            **{("psnr_db" if key == "psnr" else key): value for key, value in scores.items()},
        }
        for one in results
        for model, scores in one.scores.items()
    ]
    return {"hidden": rows}


def agreement_rows(found: PlanAgreement) -> Rows:
    """Scores of each kind of image; shares in per cent."""
    rows = []
    for one in found.table:
        shares = {"near": one.near, "moved": one.moved, "other_decision": one.other_decision}
        rows.append(
            {
                "planner": found.planner,
                "log": found.log,
                "images": one.images,
                "kind": one.kind,
                "moments": one.moments,
                "psnr_db": one.psnr,
                "ade_m": one.ade,
                "fde_m": one.fde,
                "median_fde_m": one.median,
                **{f"{key}_percent": 100 * share for key, share in shares.items()},
                "same_boxes_percent": None if one.boxes is None else 100 * one.boxes,
            }
        )
    return {"scores": rows, "left_out": [{"moments": found.left_out}]}


def driving_rows(found: PlannerDriving) -> Rows:
    """Scores of each kind of moment; shares in per cent."""
    rows = []
    for one in found.scores:
        shares = {
            "stops_alone": one.stops_alone,
            "goes_alone": one.goes_alone,
            "leaves": one.leaves,
            **{f"moved_by_{name.replace(' ', '_')}": share for name, share in one.moved.items()},
        }
        rows.append(
            {
                "planner": found.planner,
                "kind": one.kind,
                "moments": one.moments,
                "ade_m": one.ade,
                "fde_m": one.fde,
                **{f"{k}_percent": None if v is None else 100 * v for k, v in shares.items()},
            }
        )
    return {"scores": rows}


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
    unit = {**PHOTOGRAPH_COLUMNS, **STUDY_COLUMNS}[score].unit
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
