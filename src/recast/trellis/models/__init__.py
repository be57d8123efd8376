"""The six networks of TRELLIS, under their published class names."""

from recast.trellis.models.base import ModelConfig, TrellisModel
from recast.trellis.models.gaussians import RepresentationConfig, raw_to_gaussians
from recast.trellis.models.posterior import Posterior
from recast.trellis.models.registry import MODELS, build, model_class
from recast.trellis.models.slat_decoder_gs import SLatGaussianDecoder, SLatGaussianDecoderConfig
from recast.trellis.models.slat_encoder import SLatEncoder, SLatEncoderConfig, SparsePosterior
from recast.trellis.models.slat_flow import SLatFlowConfig, SLatFlowModel
from recast.trellis.models.ss_decoder import SparseStructureDecoder, SparseStructureDecoderConfig
from recast.trellis.models.ss_encoder import SparseStructureEncoder, SparseStructureEncoderConfig
from recast.trellis.models.ss_flow import SparseStructureFlowConfig, SparseStructureFlowModel

__all__ = [
    "MODELS",
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
    "build",
    "model_class",
    "raw_to_gaussians",
]
