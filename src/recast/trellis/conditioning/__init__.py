"""What conditions the generation: the crop of one object, and the encoder that reads it."""

from recast.trellis.conditioning.crop import crop_to_object, training_crop
from recast.trellis.conditioning.read import check_crop, object_box, read_crop

__all__ = ["check_crop", "crop_to_object", "object_box", "read_crop", "training_crop"]
