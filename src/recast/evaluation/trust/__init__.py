"""How far to trust the verdict of a rollout, from what is known without the truth."""

from recast.evaluation.trust.calibration import (
    Calibration,
    calibrate,
    packaged_calibration,
    read_calibration,
    write_calibration,
)
from recast.evaluation.trust.features import FEATURES, Feature, TrustFeatures, trust_features
from recast.evaluation.trust.judge import SIGHTLESS, RolloutTrust, judge
from recast.evaluation.trust.reliability import (
    JudgedRollout,
    Reliability,
    ReliabilityBin,
    area_under_roc,
    reliability,
)
from recast.evaluation.trust.views import GivenCamera, HeldOutFrame, RecordedViews

__all__ = [
    "FEATURES",
    "SIGHTLESS",
    "Calibration",
    "Feature",
    "GivenCamera",
    "HeldOutFrame",
    "JudgedRollout",
    "RecordedViews",
    "Reliability",
    "ReliabilityBin",
    "RolloutTrust",
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
