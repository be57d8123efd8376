"""How far to trust the verdict of a rollout, from what is known without the truth."""

from recast.metrics.trust.features import (
    FEATURES,
    Feature,
    GivenCamera,
    HeldOutFrame,
    RecordedViews,
    TrustFeatures,
    trust_features,
)
from recast.metrics.trust.model import (
    SIGHTLESS,
    JudgedRollout,
    Reliability,
    ReliabilityBin,
    RolloutTrust,
    TrustCalibration,
    area_under_roc,
    calibrate,
    judge,
    packaged_calibration,
    read_calibration,
    reliability,
    write_calibration,
)

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
