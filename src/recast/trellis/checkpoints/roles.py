"""The roles that models play in a checkpoint folder."""

from __future__ import annotations

STRUCTURE_FLOW = "sparse_structure_flow_model"
STRUCTURE_DECODER = "sparse_structure_decoder"
LATENT_FLOW = "slat_flow_model"
GAUSSIAN_DECODER = "slat_decoder_gs"
STRUCTURE_ENCODER = "sparse_structure_encoder"
LATENT_ENCODER = "slat_encoder"

GENERATION_ROLES = (STRUCTURE_FLOW, STRUCTURE_DECODER, LATENT_FLOW, GAUSSIAN_DECODER)
"""What an image needs to become Gaussians, besides the image encoder."""

OPTIONAL_ROLES = (STRUCTURE_ENCODER, LATENT_ENCODER)
"""What real assets need to become latents."""

IMAGE_ENCODER = "image_encoder"
"""Role of an image encoder that comes with the folder, where it is not the published backbone."""

PUBLISHED_BACKBONE = "dinov2_vitl14_reg"
"""`image_cond_model` of the published checkpoints: DINOv2 ViT-L/14 with registers, kept apart."""
