"""What conditions the generation: the crop of one object, and the encoder that reads it."""

from recast.trellis.conditioning.compact import CompactImageEncoder, CompactImageEncoderConfig
from recast.trellis.conditioning.crop import crop_to_object, training_crop
from recast.trellis.conditioning.dinov2 import Dinov2Config, Dinov2Encoder
from recast.trellis.conditioning.dinov2_load import load_dinov2
from recast.trellis.conditioning.encoder import ImageEncoder, images_from_crops
from recast.trellis.conditioning.read import check_crop, object_box, read_crop

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
