"""Pseudo-targets of the adaptation: made from four views, filtered, cached."""

from recast.recar.targets.builder import build_targets
from recast.recar.targets.cache import TargetCache
from recast.recar.targets.channels import ChannelStatistics
from recast.recar.targets.model_source import ModelSource
from recast.recar.targets.quality import Candidate, Quality, QualityScore
from recast.recar.targets.record import CacheRecord, FilterRecord, ModelRecord, TargetRecord
from recast.recar.targets.settings import FilterSettings, TargetSettings, identity_seed
from recast.recar.targets.statistics import TargetStatistics, target_statistics, target_table
from recast.recar.targets.target import Target

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
