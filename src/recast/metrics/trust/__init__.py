"""How far to trust the verdict of a rollout, from what is known without the truth."""

from recast.metrics.trust.calibration import (
    TrustCalibration,
    calibrate,
    packaged_calibration,
    read_calibration,
    write_calibration,
)
from recast.metrics.trust.features import FEATURES, Feature, TrustFeatures, trust_features
from recast.metrics.trust.judge import SIGHTLESS, RolloutTrust, judge
from recast.metrics.trust.reliability import (
    JudgedRollout,
    Reliability,
    ReliabilityBin,
    area_under_roc,
    reliability,
)
from recast.metrics.trust.views import GivenCamera, HeldOutFrame, RecordedViews

__all__ = [
    "FEATURES",
    "SIGHTLESS",
    "Feature",
    "GivenCamera",
    "HeldOutFrame",
    "JudgedRollout",
    "RecordedViews",
    "Reliability",
    "ReliabilityBin",
    "RolloutTrust",
    "TrustCalibration",
    "TrustFeatures",
    "area_under_roc",
    "calibrate",
    "judge",
    "packaged_calibration",
    "read_calibration",
    "reliability",
    "trust_features",
    "write_calibration",
]
