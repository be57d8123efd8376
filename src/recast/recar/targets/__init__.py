"""Pseudo-targets of the adaptation: made from four views, filtered, cached."""

from recast.recar.targets.builder import (
    TargetStatistics,
    build_targets,
    target_statistics,
    target_table,
)
from recast.recar.targets.cache import ChannelStatistics, Target, TargetCache
from recast.recar.targets.cache_records import (
    CacheRecord,
    FilterRecord,
    FilterSettings,
    ModelRecord,
    ModelSource,
    TargetRecord,
    TargetSettings,
    identity_seed,
)
from recast.recar.targets.quality import Candidate, Quality, QualityScore

__all__ = [
    "CacheRecord",
    "Candidate",
    "ChannelStatistics",
    "FilterRecord",
    "FilterSettings",
    "ModelRecord",
    "ModelSource",
    "Quality",
    "QualityScore",
    "Target",
    "TargetCache",
    "TargetRecord",
    "TargetSettings",
    "TargetStatistics",
    "build_targets",
    "identity_seed",
    "target_statistics",
    "target_table",
]
