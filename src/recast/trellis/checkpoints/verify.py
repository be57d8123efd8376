"""Checks a checkpoint folder by its headers: nothing is loaded, no network is built in memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from recast.core.errors import InputError
from recast.core.torch_file import read_safetensors
from recast.trellis.checkpoints.load import BACKBONE_FOLDER, check_agreement
from recast.trellis.checkpoints.model_files import ModelCheck, model_files
from recast.trellis.checkpoints.pipeline_record import (
    GENERATION_ROLES,
    OPTIONAL_ROLES,
    PIPELINE_FILE,
    PUBLISHED_BACKBONE,
    PipelineRecord,
    read_pipeline,
)
from recast.trellis.conditioning import ImageEncoder
from recast.trellis.models.base import TrellisModel

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
