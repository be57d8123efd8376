"""`pipeline.json`: which models a folder holds, how to sample, how latents are normalised."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

import torch
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import JSON_LIMIT, atomic_folder, read_bytes, read_json, write_json
from recast.core.records import validation_error
from recast.core.torch_file import DTYPES, read_header, state_error, state_faults
from recast.trellis.conditioning import CompactImageEncoder
from recast.trellis.dinov2 import Dinov2Encoder
from recast.trellis.flow_transformer import SLatFlowModel, SparseStructureFlowModel
from recast.trellis.layers import TrellisModel
from recast.trellis.sampler import SamplerSettings
from recast.trellis.vae import (
    SLatEncoder,
    SLatGaussianDecoder,
    SparseStructureDecoder,
    SparseStructureEncoder,
)

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
PIPELINE_FILE = "pipeline.json"
_MEND_RECORD = "download the file again, or correct it"


class _Member(BaseModel):
    """Types are exact; members that a later file may carry are kept and written again."""

    model_config = ConfigDict(frozen=True, strict=True, extra="allow", allow_inf_nan=False)


def _inside(path: str) -> str:
    parts = PurePosixPath(path).parts
    if not parts or path.startswith(("/", "~")) or ".." in parts or not path.isprintable():
        raise PydanticCustomError("path", "is not a path inside the folder")
    if "\\" in path or ":" in path:
        raise PydanticCustomError("path", "is not a path with forward slashes")
    return path


ModelPath = Annotated[str, AfterValidator(_inside)]


def _sampler(value: Any) -> SamplerSettings:
    if isinstance(value, SamplerSettings):
        return value
    if not isinstance(value, Mapping):
        raise PydanticCustomError("sampler", "is not an object")
    try:
        return SamplerSettings.from_published(value, "sampler")
    except InputError as error:
        raise PydanticCustomError(
            "sampler", "{field} {problem}", {"field": error.field, "problem": error.problem}
        ) from None


Sampler = Annotated[
    SamplerSettings,
    PlainValidator(_sampler),
    PlainSerializer(SamplerSettings.published, return_type=dict[str, Any]),
]


class SlatNormalization(_Member):
    """Per-channel statistics: the latent flow works on (raw - mean) / std."""

    mean: tuple[float, ...] = Field(min_length=1)
    std: tuple[Annotated[float, Field(gt=0)], ...]

    @model_validator(mode="after")
    def _same_length(self) -> SlatNormalization:
        if len(self.mean) != len(self.std):
            counts = {"mean": len(self.mean), "std": len(self.std)}
            raise PydanticCustomError("lengths", "{mean} means, {std} standard deviations", counts)
        return self


class PipelineArgs(_Member):
    """See `PipelineRecord`."""

    models: dict[str, ModelPath]
    sparse_structure_sampler: Sampler
    slat_sampler: Sampler
    slat_normalization: SlatNormalization
    image_cond_model: str = Field(min_length=1)


class PipelineRecord(_Member):
    """`pipeline.json` of the published image-to-3D checkpoints (Xiang et al. 2024).

    Models are named by role and path inside the folder, without ending. `image_cond_model` is
    "dinov2_vitl14_reg", whose weights are kept apart, or the role of an encoder among the models.
    """

    name: Literal["TrellisImageTo3DPipeline"] = "TrellisImageTo3DPipeline"
    args: PipelineArgs

    @classmethod
    def of(
        cls,
        models: Mapping[str, str],
        structure: SamplerSettings,
        latent: SamplerSettings,
        mean: Sequence[float],
        std: Sequence[float],
        image_cond_model: str = PUBLISHED_BACKBONE,
    ) -> PipelineRecord:
        """A record from its parts; mean and std are the latent's, one value a channel. Raises
        pydantic.ValidationError: a value is out of range."""
        return cls(
            args=PipelineArgs(
                models=dict(models),
                sparse_structure_sampler=structure,
                slat_sampler=latent,
                slat_normalization=SlatNormalization(mean=tuple(mean), std=tuple(std)),
                image_cond_model=image_cond_model,
            )
        )

    @property
    def models(self) -> dict[str, str]:
        """Role to path inside the folder, such as "ckpts/ss_flow", without ending."""
        return self.args.models

    @property
    def sparse_structure_settings(self) -> SamplerSettings:
        """Sampler of the sparse structure."""
        return self.args.sparse_structure_sampler

    @property
    def slat_settings(self) -> SamplerSettings:
        """Sampler of the structured latent."""
        return self.args.slat_sampler

    @property
    def slat_statistics(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """(mean, std) of the structured latent, one value a channel."""
        return self.args.slat_normalization.mean, self.args.slat_normalization.std

    @property
    def encoder_role(self) -> str | None:
        """Role of the image encoder among the models; None for the published backbone."""
        name = self.args.image_cond_model
        return None if name == PUBLISHED_BACKBONE else name


def read_pipeline(folder: Path) -> PipelineRecord:
    """Read `pipeline.json` of a checkpoint folder. Raises InputError: it is missing or no JSON, a
    member is missing, out of range or of a wrong type, or a model's path leaves the folder."""
    path = folder / PIPELINE_FILE
    if not path.is_file():
        raise InputError(
            folder, PIPELINE_FILE, "is missing", "name a folder in the published layout"
        )
    data = read_bytes(path, JSON_LIMIT)
    try:
        # From the text, not from parsed JSON: only so are lists of JSON tuples in strict mode.
        return PipelineRecord.model_validate_json(data)
    except ValidationError as error:
        raise validation_error(path, error, _MEND_RECORD) from None


def write_pipeline(folder: Path, record: PipelineRecord) -> None:
    """Write `pipeline.json` into a folder."""
    write_json(folder / PIPELINE_FILE, record.model_dump(mode="json"))


# A model's two files, `<stem>.json` (class, arguments) and `<stem>.safetensors`: found, checked by
# the header alone, and written as a folder in the published layout.

MODEL_CLASSES: dict[str, type[TrellisModel]] = {
    model.published_name: model
    for model in (
        SparseStructureFlowModel,
        SparseStructureEncoder,
        SparseStructureDecoder,
        SLatFlowModel,
        SLatEncoder,
        SLatGaussianDecoder,
        Dinov2Encoder,
        CompactImageEncoder,
    )
}
"""The networks and image encoders by published name."""

# Training configurations name these classes with a controller of activation memory; their modules
# and weights are the same.
MODEL_CLASSES |= {
    f"Elastic{model.published_name}": model
    for model in (SLatFlowModel, SLatEncoder, SLatGaussianDecoder)
}

_MEND = "download or write the file again"


def build(name: str, args: Any, where: str | Path) -> TrellisModel:
    """A new network from its published configuration, `{"name": ..., "args": {...}}`.

    Args:
        name: published name, such as "SLatFlowModel" or "ElasticSLatFlowModel".
        args: constructor arguments.
        where: the file that holds it, for messages.

    Raises:
        InputError: no such network, or an argument that is unknown, missing, wrong or makes layers
            too large to exist.
    """
    if name not in MODEL_CLASSES:
        known = ", ".join(sorted(one for one in MODEL_CLASSES if not one.startswith("Elastic")))
        raise InputError(
            where, "name", f"{name!r} is not a known network", f"choose one of {known}"
        )
    chosen = MODEL_CLASSES[name]
    mend = f"give the arguments of {chosen.published_name}"
    try:
        return chosen(chosen.config_class.model_validate(args))
    except ValidationError as error:
        raise validation_error(where, error, mend) from None
    except (RuntimeError, ValueError, TypeError, OverflowError) as error:  # of torch's layers
        reason = str(error).partition("\n")[0]
        raise InputError(
            where, "args", f"do not describe a valid network ({reason})", mend
        ) from None


def file_bytes(tensors: Mapping[str, Tensor]) -> int:
    """Size of the safetensors file of these tensors, which may be on the meta device.

    The file has no metadata: the header's length (8 bytes), the JSON header padded to a multiple of
    8 bytes, and the tensors one after another.
    """
    codes = {dtype: code for code, dtype in DTYPES.items()}
    ranks = list(codes)
    header, end = {}, 0
    for name in sorted(tensors, key=lambda name: (-ranks.index(tensors[name].dtype), name)):
        tensor = tensors[name]
        begin, end = end, end + tensor.nbytes
        code, shape = codes[tensor.dtype], list(tensor.shape)
        header[name] = {"dtype": code, "shape": shape, "data_offsets": [begin, end]}
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    return 8 + -(-len(text) // 8) * 8 + end


@dataclass(frozen=True)
class ModelCheck:
    """What was found of one model, and what its class expects."""

    role: str  # role of the model in `pipeline.json`
    file: Path  # the weights, or what names them
    class_name: str = ""  # published name of the class; empty where it could not be told
    # tensors of the file, on the meta device unless their values are checked too.
    found: Mapping[str, Tensor] | None = None
    expected: Mapping[str, Tensor] | None = None  # tensors of the class
    bytes_found: int = 0  # size of the file
    parameters: int = 0  # trainable numbers of the class, saved buffers left out
    # the file cannot be read, or its class cannot be built; nothing else is known then.
    error: InputError | None = None
    note: str = ""  # why nothing was checked, of a model that may be absent

    @property
    def bytes_expected(self) -> int:
        """Size of the file of this class without metadata."""
        return file_bytes(self.expected) if self.expected else 0

    def faults(self, *, loading: bool = False) -> dict[str, dict[str, str]]:
        """Tensors at fault by kind, see `state_faults`.

        Args:
            loading: let another floating-point type pass, which loading converts.
        """
        return state_faults(self.found or {}, self.expected or {}, exact=not loading)

    def fault(self, *, loading: bool = False) -> InputError | None:
        """The error that stands for all that is wrong, or None; see `faults`.

        It names the file and the first bad tensor, and counts the others.
        """
        found = state_error(self.file, self.faults(loading=loading), _MEND, self.class_name)
        return self.error or found


class ModelRecord(BaseModel):
    """`<stem>.json`: class and constructor arguments of a model."""

    model_config = ConfigDict(frozen=True, strict=True, extra="allow", allow_inf_nan=False)

    name: str = Field(min_length=1)
    args: dict[str, Any]


@dataclass(frozen=True)
class ModelFiles:
    """Where a model of a checkpoint folder lies."""

    role: str  # role of the model in `pipeline.json`
    config: Path  # the JSON file
    weights: Path  # the safetensors file

    def meta_model(self) -> TrellisModel:
        """The model on the meta device: names, shapes and types, no memory. Raises InputError: the
        JSON file is missing or wrong, its class or an argument is unknown."""
        try:
            record = ModelRecord.model_validate(read_json(self.config))
        except ValidationError as error:
            raise validation_error(self.config, error, _MEND) from None
        with torch.device("meta"):
            return build(record.name, record.args, self.config)

    def checked_model(self) -> TrellisModel:
        """The model on the meta device, which the weights fit by their header. Raises InputError:
        see `meta_model` and `ModelCheck.fault`."""
        model = self.meta_model()
        fault = self.check(model).fault(loading=True)
        if fault is not None:
            raise fault
        return model

    def check(self, model: TrellisModel) -> ModelCheck:
        """Compare the header of the weights with a model. Raises InputError: see `read_header`."""
        return ModelCheck(
            self.role,
            self.weights,
            model.published_name,
            read_header(self.weights, _MEND),
            model.published_state(),
            self.weights.stat().st_size,
            sum(parameter.numel() for parameter in model.parameters()),
        )


def model_files(folder: Path, record: PipelineRecord, role: str) -> ModelFiles:
    """The files of a role; both exist. Raises InputError: `pipeline.json` does not name the role,
    or names files that are not there."""
    stem = record.models.get(role)
    if stem is None:
        raise InputError(
            folder / PIPELINE_FILE, f"models.{role}", "is missing", "name the model's path"
        )
    # Not with_suffix: stems may hold dots.
    files = ModelFiles(role, folder / f"{stem}.json", folder / f"{stem}.safetensors")
    for path in (files.config, files.weights):
        if not path.is_file():
            raise InputError(
                folder / PIPELINE_FILE,
                f"models.{role}",
                f"names {stem}, but {path.relative_to(folder)} is not in the folder",
                "put the model's files there, or correct the path",
            )
    return files


def save_checkpoint(
    folder: str | Path, record: PipelineRecord, models: Mapping[str, TrellisModel]
) -> None:
    """Write `pipeline.json` and both files of every model, whole or not at all.

    The same weights give the same bytes. Element types are kept, but for bfloat16, which the
    published layout does not know: it is written as float32, without loss.

    Args:
        folder: new folder to write.
        record: names the path of each model by role. Roles without a model stay named, as in the
            published checkpoints, whose parts are fetched as needed.
        models: models by role.

    Raises:
        InputError: the folder exists, the disk is full, the record does not name a role, or two
            roles have the same path.
    """
    for role in models:
        if role not in record.models:
            raise InputError(PIPELINE_FILE, f"models.{role}", "is missing", "name the model's path")
    stems = [record.models[role] for role in models]
    if len(set(stems)) != len(stems):
        raise InputError(
            PIPELINE_FILE, "models", "name the same path twice", "give each role its own path"
        )
    with atomic_folder(folder) as partial:
        write_pipeline(partial, record)
        for role, model in models.items():
            save_model(partial / record.models[role], model)


def save_model(stem: Path, model: TrellisModel) -> None:
    """Write `<stem>.json` (class and arguments) and `<stem>.safetensors` (weights)."""
    tensors = {name: _storable(tensor) for name, tensor in model.published_state().items()}
    # Arguments that were not given are left out: other readers may not know all of ours.
    args = model.config.model_dump(
        mode="json", by_alias=True, exclude={"use_fp16"}, exclude_unset=True
    )
    if model.torso:
        args["use_fp16"] = any(tensor.dtype == torch.float16 for tensor in tensors.values())
    stem.parent.mkdir(parents=True, exist_ok=True)
    # Not with_suffix: stems may hold dots.
    write_json(stem.parent / f"{stem.name}.json", {"name": model.published_name, "args": args})
    try:
        save_file(tensors, stem.parent / f"{stem.name}.safetensors")
    except SafetensorError as error:
        if f"os error {errno.ENOSPC}" in str(error):  # said by safetensors in its own way
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
        raise


def _storable(tensor: Tensor) -> Tensor:
    tensor = tensor.detach().cpu()
    return (tensor.float() if tensor.dtype == torch.bfloat16 else tensor).contiguous()
