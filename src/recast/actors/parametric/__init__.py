"""The parametric model: the template's parameters read from one photograph, with uncertainty."""

from recast.actors.parametric.codec import DesignCodec, ParametricVehicle, VehicleLook
from recast.actors.parametric.model import (
    PARAMETRIC,
    DesignPrediction,
    ParametricGenerator,
    ParametricModel,
    parametric_model,
    predict_design,
)

__all__ = [
    "PARAMETRIC",
    "DesignCodec",
    "DesignPrediction",
    "ParametricGenerator",
    "ParametricModel",
    "ParametricVehicle",
    "VehicleLook",
    "parametric_model",
    "predict_design",
]
