"""The image encoder of a checkpoint: one of its own, or the published backbone kept apart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch

from recast.errors import InputError
from recast.trellis.checkpoints.record import PIPELINE_FILE, PipelineRecord
from recast.trellis.checkpoints.roles import PUBLISHED_BACKBONE
from recast.trellis.conditioning import ImageEncoder, load_dinov2
from recast.trellis.models.base import TrellisModel

BACKBONE_FOLDER = "dinov2"


def load_image_encoder(
    folder: Path,
    record: PipelineRecord,
    models: Mapping[str, TrellisModel],
    named: Path | None,
    device: torch.device,
) -> ImageEncoder:
    """The image encoder that a record asks for.

    Args:
        folder: of the checkpoint.
        record: its `pipeline.json`.
        models: by role; an encoder of the folder's own is one of them, and is given back.
        named: where the user says that the published backbone's weights lie; None takes the
            checkpoint's subfolder `dinov2`.
        device: where the published backbone goes.

    Raises:
        InputError: the weights are not there or cannot be read, the role names no image encoder, or
            weights are named that the checkpoint does not use.
    """
    role = record.encoder_role
    if role is None:
        path = named or folder / BACKBONE_FOLDER
        if not path.exists():
            raise InputError(
                path, "image encoder", f"the weights of {PUBLISHED_BACKBONE} are not there",
                "name their file or folder with --image-encoder, or put them there",
            )  # fmt: skip
        return load_dinov2(path).to(device).eval()
    if named is not None:
        raise InputError(
            named, "image encoder", f"{folder} has one of its own ({role})", "do not name one"
        )
    encoder = models[role]
    if not isinstance(encoder, ImageEncoder):
        raise InputError(
            folder / PIPELINE_FILE, "args.image_cond_model",
            f"names {role}, and {encoder.published_name} is no image encoder",
            "name the role of an image encoder",
        )  # fmt: skip
    return encoder
