"""Pseudo-targets of a vehicle set: made from four views, once, and cached; and their figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from recast.core import files
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError, printable
from recast.core.images import decode_image, rgb
from recast.core.workers import in_this_process, worker_pool
from recast.recar.screening import PASSED, ScreenedVehicle, summary_table
from recast.recar.target_cache import CACHE_FILE, CacheRecord, TargetCache, TargetRecord
from recast.recar.target_maker import (
    ModelSource,
    TargetSettings,
    VehicleTask,
    absolute,
    filter_record,
    start_maker,
)
from recast.recar.target_views import encoded_view, nearest_views
from recast.recar.vehicle_set import SPLITS, VehicleSet, first_difference
from recast.trellis.checkpoints import read_pipeline
from recast.trellis.generate import TRAINED_VOXEL_SHARE

_PREVIEW = (348, 261)  # pixels of a target's contact sheet on the sheets of the screening


def build_targets(
    vehicles: VehicleSet,
    model: ModelSource,
    out: str | Path,
    settings: TargetSettings | None = None,
    *,
    workers: int = 1,
    ray: str | None = None,
    identities: Collection[str] | None = None,
    retry_failures: bool = False,
    progress: Progress | None = None,
) -> TargetCache:
    """Make a target of every vehicle from its front, rear, left and right view (paper, section 2).

    Finished targets stay when the run is killed, and the same call goes on from there; more
    vehicles make a finished cache grow. Either way the files are the same bytes as those of one
    run, whatever the number of workers. A vehicle that fails is recorded with the reason, and the
    others go on. Only this process writes, record last, every file whole or not at all.

    Args:
        out: folder of the cache; new, empty, or a cache of the same model and settings. Another
            threshold of the filter is taken over without making anything anew.
        workers: processes on this machine, or actors of the cluster.
        ray: address of a Ray cluster, see `recast.core.workers.on_ray`.

    Raises:
        InputError: no views near the four sides, unknown vehicles, a model or weights that cannot
            be read, Ray not installed, or `out` holds something else, all before any work; or the
            disk is full.
    """
    settings, out = settings or TargetSettings(), Path(out)
    wanted = _wanted(vehicles, identities)
    views = nearest_views(vehicles.record)
    record = _cache_record(vehicles, views, model, settings)
    pool = worker_pool(workers, ray, gpu=model.device != "cpu")
    cache = _begin(out, record)
    finished = {
        one.id for one in cache.records.values() if not (retry_failures and one.failure is not None)
    }
    left = [name for name in wanted if name not in finished]
    done = len(wanted) - len(left)
    tell(progress, done, len(wanted))
    if left:
        _write_record(cache, record)
        tasks = (_task(vehicles, name, views) for name in left)
        if ray is None and len(left) == 1:
            pool = in_this_process
        plan = (model, settings) if ray is None else absolute(model, settings)
        with files.alone_in(out):
            for _, outcome in pool(
                start_maker, plan, lambda: next(tasks, None), "finished targets"
            ):
                cache.write_target(outcome.record, outcome.target, outcome.preview)
                done += 1
                tell(progress, done, len(wanted))
    failures = sum(one.failure is not None for one in cache.records.values())
    changes = {"complete": True, "identities": len(cache.records), "failures": failures}
    _write_record(cache, record.model_copy(update=changes))
    return TargetCache.open(out)


def _wanted(vehicles: VehicleSet, identities: Collection[str] | None) -> list[str]:
    if identities is None:
        return list(vehicles.identities)
    if unknown := sorted(set(identities) - vehicles.identities.keys()):
        raise InputError(
            vehicles.folder, unknown[0], "is not in the set", "name vehicles of the set"
        )
    return sorted(set(identities))


def _cache_record(
    vehicles: VehicleSet, views: tuple[int, ...], model: ModelSource, settings: TargetSettings
) -> CacheRecord:
    made_by, pipeline = model.record(), read_pipeline(model.folder)
    front, rear, left, right = (vehicles.record.azimuths_deg[index] for index in views)
    return CacheRecord(
        complete=False,
        vehicle_set=vehicles.record.name,
        model=made_by,
        mode=settings.mode,
        views_deg=(front, rear, left, right),
        structure_sampler=settings.structure or pipeline.sparse_structure_settings,
        latent_sampler=settings.latent or pipeline.slat_settings,
        seed=settings.seed,
        retries=settings.retries,
        max_voxels=settings.max_voxels or TRAINED_VOXEL_SHARE * made_by.resolution**2,
        heading=settings.heading,
        filter=filter_record(settings.filter),
    )


def _begin(out: Path, record: CacheRecord) -> TargetCache:
    """The cache that lies there, or an empty one; nothing is written."""
    if not (out / CACHE_FILE).is_file():
        # a kill at the very start leaves no more than the beginning of cache.json
        inside = {path.name for path in out.iterdir()} if out.is_dir() else set()
        if not out.exists() or (out.is_dir() and inside <= {files.partial_name(CACHE_FILE).name}):
            return TargetCache(out, record, {}, {})
        raise InputError(
            out, "output folder", "exists and is not a target cache", "choose a new or empty folder"
        )
    cache = TargetCache.open(out, complete=False)
    free: dict[str, Any] = {
        "complete": True,
        "identities": True,
        "failures": True,
        "filter": {"threshold"},
    }
    theirs, ours = (one.model_dump(mode="json", exclude=free) for one in (cache.record, record))
    if name := first_difference(theirs, ours):
        problem = "differs: the folder holds targets of another configuration"
        mend = "choose another folder, or use the options of the targets in it"
        raise InputError(out / CACHE_FILE, name, problem, mend)
    return cache


def _write_record(cache: TargetCache, record: CacheRecord) -> None:
    """Write cache.json, unless it says so already."""
    path = cache.folder / CACHE_FILE
    if cache.record != record or not path.exists():
        files.write_json(path, record.model_dump(mode="json"))
        cache.record = record


def _task(vehicles: VehicleSet, name: str, views: tuple[int, ...]) -> VehicleTask:
    identity = vehicles.identities[name]
    own = identity.record
    encoded = []
    for index in views:
        try:
            encoded.append(encoded_view(identity, index))
        except InputError as error:
            reason = f"view {index}: {error.field} {error.problem}"
            return VehicleTask(own.id, own.split, own.kind, own.colour, (), reason)
    return VehicleTask(own.id, own.split, own.kind, own.colour, tuple(encoded))


@dataclass(frozen=True)
class TargetStatistics:
    """Figures of a cache.

    Attributes:
        failures: reasons with how often, the most frequent first.
        rejected: number of targets rejected by a person.
        below: number of targets that are not rejected, but below the threshold.
        accepted: numbers of accepted targets, by split.
        doubtful: number of targets nobody decided about that score higher with front and rear
            exchanged.
        voxels: least, median and greatest number of voxels of accepted targets; zeros where there
            is none.
        scores: scores of all targets that have one, sorted.
    """

    done: int
    failures: dict[str, int]
    rejected: int
    below: int
    accepted: dict[str, int]
    doubtful: int
    voxels: tuple[int, int, int]
    scores: tuple[float, ...]


def target_statistics(cache: TargetCache) -> TargetStatistics:
    """Count targets."""
    made, accepted = cache.ids(accepted_only=False), cache.ids()
    rejected = sum(cache.decisions.get(one) == "no" for one in made)
    splits = Counter(cache.records[one].split for one in accepted)
    voxels = [cache.records[one].voxels for one in accepted]
    failures = Counter(one.failure for one in cache.records.values() if one.failure is not None)
    return TargetStatistics(
        done=len(cache.records),
        failures=dict(sorted(failures.items(), key=lambda item: (-item[1], item[0]))),
        rejected=rejected,
        below=len(made) - rejected - len(accepted),
        accepted={split: splits[split] for split in SPLITS},
        doubtful=sum(
            _rear_to_front(cache.records[one]) for one in made if one not in cache.decisions
        ),
        voxels=(min(voxels), int(np.median(voxels)), max(voxels)) if voxels else (0, 0, 0),
        scores=tuple(sorted(r.score for r in cache.records.values() if r.score is not None)),
    )


def _rear_to_front(record: TargetRecord) -> bool:
    if record.score is None or record.score_flipped is None:
        return False
    return record.score_flipped > record.score


def screened_targets(cache: TargetCache) -> Iterator[ScreenedVehicle]:
    """The targets of a cache by their contact sheets, with what the quality filter says of them.

    Raises:
        InputError: a contact sheet is broken.
    """
    threshold = cache.record.filter.threshold
    for name in cache.ids(accepted_only=False):
        one = cache.records[name]
        doubts = []
        if threshold is not None and (one.score is None or one.score < threshold):
            doubts.append(f"score below the threshold {threshold:g}")
        if _rear_to_front(one):
            doubts.append("agrees better with front and rear exchanged")
        path = cache.preview_path(name)
        picture = rgb(decode_image(path, path, what="contact sheet", mend="make the target again"))
        yield ScreenedVehicle(
            name,
            {
                "kind": one.kind,
                "colour": one.colour,
                "split": one.split,
                "voxels": one.voxels,
                "score": one.score,
                "score_flipped": one.score_flipped,
                "heading_deg": one.heading_deg,
            },
            "; ".join(doubts) or PASSED,
            np.asarray(cv2.resize(picture, _PREVIEW, interpolation=cv2.INTER_AREA), np.uint8),
        )


def target_table(cache: TargetCache, statistics: TargetStatistics) -> Group:
    """The figures for a terminal."""
    record, score = cache.record, statistics.scores
    failed = sum(statistics.failures.values())
    accepted = sum(statistics.accepted.values())
    rows = [
        ("model", f"{record.model.name} ({record.model.sha256[:12]})"),
        ("vehicles", f"{statistics.done:,} done, {failed:,} without a target"),
        (
            "accepted",
            f"{accepted:,}: {statistics.accepted['train']:,} train, "
            f"{statistics.accepted['held-out']:,} held out",
        ),
        ("left out", f"{statistics.below:,} below the threshold, {statistics.rejected:,} rejected"),
        ("rear to front", f"{statistics.doubtful:,} agree better when reversed: check them"),
        ("voxels", "{:,} to {:,}, median {:,}".format(*(statistics.voxels[i] for i in (0, 2, 1)))),
    ]
    if score:
        tenth, median, most = (score[int(q * (len(score) - 1))] for q in (0.1, 0.5, 0.9))
        rows.append(
            (
                record.filter.score or "score",
                f"median {median:.3f}, 80 % in {tenth:.3f} to {most:.3f}, "
                f"threshold {record.filter.threshold:g}",
            )
        )
    parts = [summary_table(record.vehicle_set, rows)]
    if statistics.failures:
        reasons = Table(box=SIMPLE_HEAD)
        reasons.add_column("reason for the missing target")
        reasons.add_column("vehicles", justify="right")
        for reason, count in statistics.failures.items():
            reasons.add_row(Text(printable(reason)), f"{count:,}")
        parts.append(reasons)
    return Group(*parts)
