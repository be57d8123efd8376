"""Published networks in folders of the user's: read strictly, never fetched."""

from recast.pretrained.clip import ClipImages
from recast.pretrained.folder import PretrainedFolder, model_type
from recast.pretrained.pictures import whole_picture

__all__ = ["ClipImages", "PretrainedFolder", "model_type", "whole_picture"]
