"""The six networks of TRELLIS, under their published class names."""

from recast.trellis.models.base import ModelConfig, Posterior, TrellisModel
from recast.trellis.models.flow_transformer import (
    SLatFlowConfig,
    SLatFlowModel,
    SparseStructureFlowConfig,
    SparseStructureFlowModel,
)
from recast.trellis.models.gaussians import RepresentationConfig, raw_to_gaussians
from recast.trellis.models.slat_vae import (
    SLatEncoder,
    SLatEncoderConfig,
    SLatGaussianDecoder,
    SLatGaussianDecoderConfig,
    SparsePosterior,
)
from recast.trellis.models.ss_vae import (
    SparseStructureDecoder,
    SparseStructureDecoderConfig,
    SparseStructureEncoder,
    SparseStructureEncoderConfig,
)

__all__ = [
    "ModelConfig",
    "Posterior",
    "RepresentationConfig",
    "SLatEncoder",
    "SLatEncoderConfig",
    "SLatFlowConfig",
    "SLatFlowModel",
    "SLatGaussianDecoder",
    "SLatGaussianDecoderConfig",
    "SparsePosterior",
    "SparseStructureDecoder",
    "SparseStructureDecoderConfig",
    "SparseStructureEncoder",
    "SparseStructureEncoderConfig",
    "SparseStructureFlowConfig",
    "SparseStructureFlowModel",
    "TrellisModel",
    "raw_to_gaussians",
]
