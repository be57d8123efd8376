"""Loads a folder in the published layout, strictly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from recast.errors import InputError
from recast.torch_file import read_safetensors
from recast.trellis.checkpoints.agreement import check_agreement
from recast.trellis.checkpoints.backbone import load_image_encoder
from recast.trellis.checkpoints.model_files import ModelFiles, model_files
from recast.trellis.checkpoints.record import PipelineRecord, read_pipeline
from recast.trellis.checkpoints.roles import GENERATION_ROLES
from recast.trellis.conditioning import ImageEncoder
from recast.trellis.models.base import TrellisModel


@dataclass(frozen=True)
class Checkpoint:
    """The models of a folder, ready to run.

    Attributes:
        folder: where they were read; None for new ones.
        record: its `pipeline.json`.
        models: by role; an image encoder of the folder's own is among them.
        image_encoder: what turns crops into condition tokens, where it was asked for.
    """

    folder: Path | None
    record: PipelineRecord
    models: dict[str, TrellisModel]
    image_encoder: ImageEncoder | None

    @property
    def encoder(self) -> ImageEncoder:
        """The image encoder.

        Raises:
            InputError: it was not loaded.
        """
        if self.image_encoder is None:
            raise InputError(
                self.folder or "checkpoint", "image encoder", "was not loaded",
                "load the checkpoint with its image encoder",
            )  # fmt: skip
        return self.image_encoder


def load_checkpoint(
    folder: str | Path,
    *,
    roles: Sequence[str] = GENERATION_ROLES,
    device: str | torch.device = "cpu",
    torso_dtype: torch.dtype | None = None,
    image_encoder: Path | None = None,
    with_encoder: bool = True,
) -> Checkpoint:
    """Load models of a folder in the published layout; every name and shape must agree.

    The models are in evaluation mode. Other roles of the folder are not looked at. No pickle is
    read, except that a named `image_encoder` may be a torch-hub file, see `load_dinov2`.

    Args:
        folder: with `pipeline.json` and `ckpts/`.
        roles: which models to load.
        device: where to.
        torso_dtype: of the transformer and convolution blocks; None takes float32 on the CPU, and
            what each configuration says elsewhere.
        image_encoder: weights of the published backbone; None takes `folder`/dinov2.
        with_encoder: whether to load the image encoder.

    Raises:
        InputError: a file is missing, truncated or of another kind, a class or argument is unknown,
            a tensor is missing, unexpected, of another shape or not finite, or the models do not
            fit together. The line names the first bad tensor and counts the others.
    """
    folder, device = Path(folder), torch.device(device)
    record = read_pipeline(folder)
    wanted = list(dict.fromkeys(roles))
    if with_encoder and record.encoder_role is not None:
        wanted = list(dict.fromkeys([*wanted, record.encoder_role]))
    # Headers of all files first: a fault in the last one shows before gigabytes are read.
    files = {role: model_files(folder, record, role) for role in wanted}
    models = {role: files[role].meta_model() for role in wanted}
    for role in wanted:
        fault = files[role].check(models[role]).fault(loading=True)
        if fault is not None:
            raise fault
    encoder = None
    if with_encoder:
        encoder = load_image_encoder(folder, record, models, image_encoder, device)
    check_agreement(folder, record, models, encoder)
    for role in wanted:
        _fill(models[role], files[role], device, torso_dtype)
    return Checkpoint(folder, record, models, encoder)


def load_model(
    files: ModelFiles, device: str | torch.device = "cpu", torso_dtype: torch.dtype | None = None
) -> TrellisModel:
    """Load one model from its two files; see `load_checkpoint`."""
    model = files.meta_model()
    fault = files.check(model).fault(loading=True)
    if fault is not None:
        raise fault
    _fill(model, files, torch.device(device), torso_dtype)
    return model


def read_tensors(path: Path) -> dict[str, Tensor]:
    """All tensors of a checked safetensors file, mapped from disk until they are copied.

    Raises:
        InputError: the file cannot be read.
    """
    return read_safetensors(path, "file", "fetch it anew")[0]


def _fill(
    model: TrellisModel, files: ModelFiles, device: torch.device, torso_dtype: torch.dtype | None
) -> None:
    """Give a model on the meta device its memory and weights."""
    if torso_dtype is None and device.type == "cpu":
        torso_dtype = torch.float32
    if torso_dtype is not None:
        model.set_torso_dtype(torso_dtype)
    tensors = read_tensors(files.weights)
    model.to_empty(device=device)
    model.load_published(tensors)
    model.eval()
    for name, loaded in model.published_state().items():
        if not bool(torch.isfinite(loaded).all()):
            problem = "holds NaN or infinite values"
            if bool(torch.isfinite(tensors[name]).all()):
                problem = f"exceeds the range of {loaded.dtype}, to which it was converted"
            raise InputError(files.weights, name, problem, "fetch or write the file anew")
