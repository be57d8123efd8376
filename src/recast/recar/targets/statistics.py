"""What is in a cache of targets, in figures."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from recast.recar.record import SPLITS
from recast.recar.targets.cache import TargetCache


@dataclass(frozen=True)
class TargetStatistics:
    """Figures of a cache.

    Attributes:
        done: vehicles with a record.
        failures: reasons with how often, the most frequent first.
        rejected: by a person.
        below: not rejected, below the threshold.
        accepted: by split.
        flipped: accepted ones that are turned when read.
        voxels: least, median and most of accepted targets; zeros where there is none.
        scores: of all targets that have one, sorted.
    """

    done: int
    failures: dict[str, int]
    rejected: int
    below: int
    accepted: dict[str, int]
    flipped: int
    voxels: tuple[int, int, int]
    scores: tuple[float, ...]


def target_statistics(cache: TargetCache) -> TargetStatistics:
    """Count targets; see `TargetCache.statistics` for the values of their latents."""
    made, accepted = cache.ids(accepted_only=False), cache.ids()
    rejected = sum(cache.decisions.get(one) == "reject" for one in made)
    splits = Counter(cache.records[one].split for one in accepted)
    voxels = [cache.records[one].voxels for one in accepted]
    failures = Counter(one.failure for one in cache.records.values() if one.failure is not None)
    return TargetStatistics(
        done=len(cache.records),
        failures=dict(sorted(failures.items(), key=lambda item: (-item[1], item[0]))),
        rejected=rejected,
        below=len(made) - rejected - len(accepted),
        accepted={split: splits[split] for split in SPLITS},
        flipped=sum(cache.decisions.get(one) == "flip" for one in accepted),
        voxels=(min(voxels), int(np.median(voxels)), max(voxels)) if voxels else (0, 0, 0),
        scores=tuple(sorted(r.score for r in cache.records.values() if r.score is not None)),
    )
