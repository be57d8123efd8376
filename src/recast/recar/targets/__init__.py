"""Pseudo-targets of the adaptation: made from four views, filtered, cached."""

from recast.recar.targets.cache import TargetCache
from recast.recar.targets.channels import ChannelStatistics
from recast.recar.targets.record import CacheRecord, FilterRecord, ModelRecord, TargetRecord
from recast.recar.targets.statistics import TargetStatistics, target_statistics
from recast.recar.targets.target import Target

__all__ = [
    "CacheRecord",
    "ChannelStatistics",
    "FilterRecord",
    "ModelRecord",
    "Target",
    "TargetCache",
    "TargetRecord",
    "TargetStatistics",
    "target_statistics",
]
