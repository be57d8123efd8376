"""Checkpoints that nothing has trained yet."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import torch

from recast.trellis.checkpoints.classes import MODEL_CLASSES
from recast.trellis.checkpoints.load import Checkpoint
from recast.trellis.checkpoints.sizes import CheckpointSizes, ModelSize
from recast.trellis.conditioning import ImageEncoder
from recast.trellis.models import TrellisModel, build


def new_checkpoint(
    sizes: CheckpointSizes,
    seed: int,
    *,
    roles: Sequence[str] | None = None,
    with_encoder: bool = True,
) -> Checkpoint:
    """Networks with initial weights, on the CPU, in evaluation mode.

    A model's weights depend on the seed and its role only, not on which others are made. Output
    layers of the flows and of the Gaussian decoder start at zero, as the published training does.

    Args:
        sizes: `OFFICIAL`, `SMALL` or others.
        seed: of all weights.
        roles: which models to make; all where not given.
        with_encoder: whether to make the image encoder; 1.2 GB for the published one.

    Returns:
        As `load_checkpoint` gives; the models are what `save_checkpoint` writes.
    """
    models = {
        role: _seeded(size, role, seed)
        for role, size in sizes.models.items()
        if roles is None or role in roles or (with_encoder and role == sizes.record.encoder_role)
    }
    encoder: TrellisModel | None = None
    if with_encoder and sizes.backbone is not None:
        encoder = _seeded(sizes.backbone, "image encoder", seed)
    elif with_encoder:
        encoder = models.get(sizes.record.encoder_role or "")
    known = encoder if isinstance(encoder, ImageEncoder) else None
    return Checkpoint(None, sizes.record, models, known)


def _seeded(size: ModelSize, role: str, seed: int) -> TrellisModel:
    # On the CPU torch takes no more than 32 bits of a seed.
    mixed = hashlib.blake2b(f"{role} {seed}".encode(), digest_size=4).digest()
    # Constructors draw from torch's own generator, which is put back as it was.
    with torch.random.fork_rng(devices=()):
        torch.random.default_generator.manual_seed(int.from_bytes(mixed, "little"))
        return build(size.name, size.args, f"size of {role}", MODEL_CLASSES).eval()
