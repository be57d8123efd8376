"""A model folder cut down to what generation needs, in half precision: for handing on."""

from __future__ import annotations

from pathlib import Path

import torch

from recast.trellis.checkpoints.load import load_checkpoint
from recast.trellis.checkpoints.record import read_pipeline
from recast.trellis.checkpoints.save import save_checkpoint


def export_model(folder: str | Path, out: str | Path) -> None:
    """Write the four models of generation, and the folder's own image encoder, in half precision.

    As in the published checkpoints the blocks of the networks are float16, input and output layers
    float32; a CPU computes in float32 all the same.

    Args:
        folder: model in the published layout.
        out: folder to make.

    Raises:
        InputError: see `load_checkpoint` and `save_checkpoint`.
    """
    own_encoder = read_pipeline(Path(folder)).encoder_role is not None
    found = load_checkpoint(folder, torso_dtype=torch.float16, with_encoder=own_encoder)
    named = {role: found.record.models[role] for role in found.models}
    args = found.record.args.model_copy(update={"models": named})
    save_checkpoint(out, found.record.model_copy(update={"args": args}), found.models)
