"""Flow matching: what the flow transformers are trained on, and how they are sampled."""

from recast.trellis.flow.clipping import AdaptiveGradClipper
from recast.trellis.flow.condition import Condition, MultiImageMode, drop_condition
from recast.trellis.flow.ema import ExponentialMovingAverage
from recast.trellis.flow.matching import FlowLoss, FlowMatching, sample_timesteps, time_bins
from recast.trellis.flow.path import TIME_SCALE, Velocity
from recast.trellis.flow.sampler import StepRecord, sample
from recast.trellis.flow.settings import SamplerSettings, time_steps

__all__ = [
    "TIME_SCALE",
    "AdaptiveGradClipper",
    "Condition",
    "ExponentialMovingAverage",
    "FlowLoss",
    "FlowMatching",
    "MultiImageMode",
    "SamplerSettings",
    "StepRecord",
    "Velocity",
    "drop_condition",
    "sample",
    "sample_timesteps",
    "time_bins",
    "time_steps",
]
