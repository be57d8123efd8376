"""What conditions the generation: the crop of one object, and the encoder that reads it."""

from recast.trellis.conditioning.crop import (
    check_crop,
    crop_to_object,
    object_box,
    read_crop,
    training_crop,
)
from recast.trellis.conditioning.dinov2 import Dinov2Config, Dinov2Encoder
from recast.trellis.conditioning.dinov2_load import load_dinov2
from recast.trellis.conditioning.encoder import (
    CompactImageEncoder,
    CompactImageEncoderConfig,
    ImageEncoder,
    images_from_crops,
)

__all__ = [
    "CompactImageEncoder",
    "CompactImageEncoderConfig",
    "Dinov2Config",
    "Dinov2Encoder",
    "ImageEncoder",
    "check_crop",
    "crop_to_object",
    "images_from_crops",
    "load_dinov2",
    "object_box",
    "read_crop",
    "training_crop",
]
