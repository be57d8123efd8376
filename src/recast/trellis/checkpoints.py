"""Checkpoint folders: loading, saving and verifying them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rich.markup import escape
from rich.table import Table

from recast.core.errors import InputError
from recast.core.torch_file import read_safetensors
from recast.trellis.conditioning import ImageEncoder
from recast.trellis.dinov2 import load_dinov2
from recast.trellis.layers import TrellisModel
from recast.trellis.model_files import (
    GAUSSIAN_DECODER,
    GENERATION_ROLES,
    LATENT_ENCODER,
    LATENT_FLOW,
    OPTIONAL_ROLES,
    PIPELINE_FILE,
    PUBLISHED_BACKBONE,
    STRUCTURE_DECODER,
    STRUCTURE_ENCODER,
    STRUCTURE_FLOW,
    ModelCheck,
    ModelFiles,
    PipelineRecord,
    model_files,
    read_pipeline,
    save_checkpoint,
)

# Loads a folder in the published layout, strictly: its models must fit; and cuts one down.
#
# The image encoder is the checkpoint's own, or the published backbone kept apart.

ROLE_CLASSES: Mapping[str, str] = {
    STRUCTURE_FLOW: "SparseStructureFlowModel",
    STRUCTURE_DECODER: "SparseStructureDecoder",
    LATENT_FLOW: "SLatFlowModel",
    GAUSSIAN_DECODER: "SLatGaussianDecoder",
    STRUCTURE_ENCODER: "SparseStructureEncoder",
    LATENT_ENCODER: "SLatEncoder",
}
BACKBONE_FOLDER = "dinov2"


def check_agreement(
    folder: Path,
    record: PipelineRecord,
    models: Mapping[str, TrellisModel],
    encoder: ImageEncoder | None,
) -> None:
    """Check that models, which may be on the meta device, can work together. Raises InputError: a
    model is not of its role's class, or channels or resolutions differ."""
    where = folder / PIPELINE_FILE
    for role, model in models.items():
        expected = ROLE_CLASSES.get(role, model.published_name)
        if model.published_name != expected:
            raise InputError(
                where,
                f"models.{role}",
                f"is a {model.published_name}, not a {expected}",
                "correct the path",
            )
    for what, members in _facts(record, models, encoder).items():
        if len(set(members.values())) > 1:
            listed = ", ".join(f"{value} of {name}" for name, value in members.items())
            raise InputError(where, what, f"differ ({listed})", "use models of one training run")


def _facts(
    record: PipelineRecord, models: Mapping[str, TrellisModel], encoder: ImageEncoder | None
) -> dict[str, dict[str, int]]:
    """Numbers that must be equal within each group, by who says so."""
    condition: dict[str, int] = {} if encoder is None else {"the image encoder": encoder.channels}
    structure: dict[str, int] = {}
    latent = {"slat_normalization": len(record.slat_statistics[0])}
    voxels: dict[str, int] = {}
    for role, model in models.items():
        config: Any = model.config
        if role in (STRUCTURE_FLOW, LATENT_FLOW):
            condition[role] = config.cond_channels
            group = structure if role == STRUCTURE_FLOW else latent
            group[f"{role} (in)"] = config.in_channels
            group[f"{role} (out)"] = config.out_channels
        if role in (STRUCTURE_DECODER, STRUCTURE_ENCODER):
            structure[role] = config.latent_channels
        if role in (GAUSSIAN_DECODER, LATENT_ENCODER):
            latent[role] = config.latent_channels
        if role in (LATENT_FLOW, GAUSSIAN_DECODER, LATENT_ENCODER):
            voxels[role] = config.resolution
    if STRUCTURE_FLOW in models:
        flow: Any = models[STRUCTURE_FLOW].config
        for role in (STRUCTURE_DECODER, STRUCTURE_ENCODER):
            if role in models:
                levels: Any = models[role].config
                voxels[role] = flow.resolution * 2 ** (len(levels.channels) - 1)
    return {
        "condition channels": condition,
        "channels of the structure": structure,
        "channels of the structured latent": latent,
        "voxels along an axis": voxels,
    }


def load_image_encoder(
    folder: Path,
    record: PipelineRecord,
    models: Mapping[str, TrellisModel],
    named: Path | None,
    device: torch.device,
) -> ImageEncoder:
    """The image encoder that the record of a checkpoint's folder asks for.

    Args:
        models: models by role; an encoder of the folder's own is one of them, and is given back.
        named: path that the user gives for the published backbone's weights; None takes the
            checkpoint's subfolder `dinov2`.
        device: device that the published backbone goes to.

    Raises:
        InputError: the weights are not there or cannot be read, the role names no image encoder, or
            weights are named that the checkpoint does not use.
    """
    role = record.encoder_role
    if role is None:
        path = named or folder / BACKBONE_FOLDER
        if not path.exists():
            raise InputError(
                path,
                "image encoder",
                f"the weights of {PUBLISHED_BACKBONE} are missing",
                "give their file or folder with `image_encoder`, or put them there",
            )
        return load_dinov2(path).to(device).eval()
    if named is not None:
        raise InputError(
            named,
            "image encoder",
            f"{folder} already has one ({role})",
            "leave `image_encoder` out",
        )
    encoder = models[role]
    if not isinstance(encoder, ImageEncoder):
        raise InputError(
            folder / PIPELINE_FILE,
            "args.image_cond_model",
            f"names {role}, but {encoder.published_name} is not an image encoder",
            "name the role of an image encoder",
        )
    return encoder


@dataclass(frozen=True)
class Checkpoint:
    """The models of a folder, ready to run."""

    folder: Path | None  # folder that they were read from; None for new ones
    record: PipelineRecord  # its `pipeline.json`
    # models by role; an image encoder of the folder's own is among them.
    models: dict[str, TrellisModel]
    # what turns crops into condition tokens, where it was asked for.
    image_encoder: ImageEncoder | None

    @property
    def encoder(self) -> ImageEncoder:
        """The image encoder. Raises InputError: it was not loaded."""
        if self.image_encoder is None:
            raise InputError(
                self.folder or "checkpoint",
                "image encoder",
                "was not loaded",
                "load the checkpoint with its image encoder",
            )
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
        folder: folder with `pipeline.json` and `ckpts/`.
        roles: roles of the models to load.
        device: device to load them to.
        torso_dtype: dtype of the transformer and convolution blocks; None takes float32 on the CPU,
            and what each configuration says elsewhere.
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
    models = {role: files[role].checked_model() for role in wanted}
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
    model = files.checked_model()
    _fill(model, files, torch.device(device), torso_dtype)
    return model


def _fill(
    model: TrellisModel, files: ModelFiles, device: torch.device, torso_dtype: torch.dtype | None
) -> None:
    """Give a model on the meta device its memory and weights."""
    if torso_dtype is None and device.type == "cpu":
        torso_dtype = torch.float32
    if torso_dtype is not None:
        model.set_torso_dtype(torso_dtype)
    tensors = read_safetensors(files.weights, "file", "download it again")[0]
    model.to_empty(device=device)
    model.load_published(tensors)
    model.eval()
    for name, loaded in model.published_state().items():
        if not bool(torch.isfinite(loaded).all()):
            problem = "holds NaN or infinite values"
            if bool(torch.isfinite(tensors[name]).all()):
                problem = f"exceeds the range of {loaded.dtype}, to which it was converted"
            raise InputError(files.weights, name, problem, "download or write the file again")


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


LISTED = 8  # names of bad tensors written out of each kind


def verify_checkpoint(folder: str | Path, *, values: bool = False) -> list[ModelCheck]:
    """Compare every model that `pipeline.json` names with its class.

    Models that recast never loads, such as the mesh and radiance-field decoders of the published
    checkpoints, may be absent and are not looked at; the structure and latent encoders may be
    absent. A last entry with an error stands for models that do not fit together.

    Args:
        folder: model folder in the published layout.
        values: read every tensor and check that it is finite.

    Returns:
        One check for each role. Faults of a model are in its check, see `ModelCheck.fault`.

    Raises:
        InputError: `pipeline.json` is missing or wrong.
    """
    folder = Path(folder)
    record = read_pipeline(folder)
    encoder_role = record.encoder_role
    needed = [*GENERATION_ROLES, *([encoder_role] if encoder_role else [])]
    checks: list[ModelCheck] = []
    models: dict[str, TrellisModel] = {}
    for role in dict.fromkeys([*needed, *record.models]):
        if role in needed or role in OPTIONAL_ROLES:
            checks.append(_check(folder, record, role, role in needed, values, models))
        else:
            path = folder / f"{record.models[role]}.safetensors"
            checks.append(ModelCheck(role, path, note="not used"))
    if encoder_role is None:
        path = folder / BACKBONE_FOLDER
        note = "not checked" if path.exists() else "stored elsewhere"
        checks.append(ModelCheck("image encoder", path, PUBLISHED_BACKBONE, note=note))
    encoder = models.get(encoder_role or "")
    try:
        known = encoder if isinstance(encoder, ImageEncoder) else None
        check_agreement(folder, record, models, known)
    except InputError as error:
        checks.append(ModelCheck("all together", folder / PIPELINE_FILE, error=error))
    return checks


def first_fault(checks: Sequence[ModelCheck]) -> InputError | None:
    """The first error among checks, saying how many models are at fault; None if all are well."""
    faults = [fault for fault in (check.fault() for check in checks) if fault is not None]
    if len(faults) < 2:
        return faults[0] if faults else None
    first = faults[0]
    more = f"{first.problem}; {len(faults) - 1} more models are at fault"
    return InputError(first.where, first.field, more, first.mend)


def check_table(checks: Sequence[ModelCheck], folder: str | Path) -> Table:
    """What was found of each model, what is missing or wrong; made to fit 80 columns.

    Args:
        checks: see `verify_checkpoint`.
        folder: folder that the files are named relative to.
    """
    table = Table(box=None, pad_edge=False, padding=(0, 2, 1, 0))
    table.add_column("model", overflow="fold")
    table.add_column("tensors", no_wrap=True)
    table.add_column("file", justify="right", no_wrap=True)
    for check in checks:
        verdict = check.note or ("ok" if check.fault() is None else "wrong")
        file = check.file.relative_to(folder) if check.file.is_relative_to(folder) else check.file
        model = "\n".join(filter(None, (check.role, check.class_name, str(file))))
        tensors, sizes = verdict, ""
        if check.expected is not None and check.found is not None:
            counts = {kind: len(names) for kind, names in check.faults().items()}
            tensors = (
                f"{len(check.found)}/{len(check.expected)}: {verdict}\n"
                f"{counts['missing']} missing, {counts['unexpected']} unexpected\n"
                f"{counts['of another shape']} shapes, {counts['of another type']} types wrong"
            )
            sizes = (
                f"{check.bytes_found:,} bytes\n{check.bytes_expected:,} expected\n"
                f"{check.parameters:,} parameters"
            )
        table.add_row(escape(model), tensors, sizes)
    return table


def check_details(check: ModelCheck) -> list[str]:
    """Lines that name the bad tensors of a model, the first few of each kind."""
    lines = [] if check.error is None else [f"{check.role}: {check.error}"]
    for kind, names in check.faults().items():
        if names:
            more = f", and {len(names) - LISTED} more" if len(names) > LISTED else ""
            lines.append(f"{check.role}: {kind}: {', '.join([*names][:LISTED])}{more}")
    return lines


def _check(
    folder: Path,
    record: PipelineRecord,
    role: str,
    needed: bool,
    values: bool,
    models: dict[str, TrellisModel],
) -> ModelCheck:
    stem = record.models.get(role)
    path = folder / PIPELINE_FILE if stem is None else folder / f"{stem}.safetensors"
    try:
        files = model_files(folder, record, role)
    except InputError as error:
        return (
            ModelCheck(role, path, error=error) if needed else ModelCheck(role, path, note="absent")
        )
    try:
        models[role] = files.meta_model()
        check = files.check(models[role])
        if values:
            return dataclasses.replace(
                check, found=read_safetensors(path, "file", "download it again")[0]
            )
        return check
    except InputError as error:
        return ModelCheck(role, path, error=error)
