"""Pseudo-targets of the adaptation: made from four views, filtered, cached."""

from recast.recar.targets.builder import (
    TargetStatistics,
    build_targets,
    screened_targets,
    target_statistics,
    target_table,
)
from recast.recar.targets.cache import Target, TargetCache
from recast.recar.targets.cache_records import (
    CachedModelRecord,
    CacheRecord,
    FilterRecord,
    FilterSettings,
    ModelSource,
    TargetRecord,
    TargetSettings,
    identity_seed,
)
from recast.recar.targets.quality import Quality, QualityScore, TargetCandidate

__all__ = [
    "CacheRecord",
    "CachedModelRecord",
    "FilterRecord",
    "FilterSettings",
    "ModelSource",
    "Quality",
    "QualityScore",
    "Target",
    "TargetCache",
    "TargetCandidate",
    "TargetRecord",
    "TargetSettings",
    "TargetStatistics",
    "build_targets",
    "identity_seed",
    "screened_targets",
    "target_statistics",
    "target_table",
]
