"""One image to a view-complete vehicle: the TRELLIS image-to-3D model in PyTorch of our own."""

from recast.trellis.checkpoints import load_checkpoint, verify_checkpoint
from recast.trellis.conditioning import check_crop, crop_to_object, read_crop
from recast.trellis.generate import (
    RECAST_MINI,
    GeneratedVehicle,
    Generation,
    GenerationLimits,
    ImageTo3D,
    generate,
    recast_mini,
    viewer_frame,
)
from recast.trellis.model_files import save_checkpoint
from recast.trellis.sampler import MultiImageMode, SamplerSettings

__all__ = [
    "RECAST_MINI",
    "GeneratedVehicle",
    "Generation",
    "GenerationLimits",
    "ImageTo3D",
    "MultiImageMode",
    "SamplerSettings",
    "check_crop",
    "crop_to_object",
    "generate",
    "load_checkpoint",
    "read_crop",
    "recast_mini",
    "save_checkpoint",
    "verify_checkpoint",
    "viewer_frame",
]
