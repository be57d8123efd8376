"""`pipeline.json`: which models a folder holds, how to sample, how latents are normalised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

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

from recast.core.errors import InputError
from recast.core.files import JSON_LIMIT, read_bytes, write_json
from recast.core.records import validation_error
from recast.trellis.sampler import SamplerSettings

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
_MEND = "download the file again, or correct it"


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
        """A record from its parts; mean and std are the latent's, one value a channel.

        Raises:
            pydantic.ValidationError: a value is out of range.
        """
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
    """Read `pipeline.json` of a checkpoint folder.

    Raises:
        InputError: it is missing or no JSON, a member is missing, out of range or of a wrong type,
            or a model's path leaves the folder.
    """
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
        raise validation_error(path, error, _MEND) from None


def write_pipeline(folder: Path, record: PipelineRecord) -> None:
    """Write `pipeline.json` into a folder."""
    write_json(folder / PIPELINE_FILE, record.model_dump(mode="json"))
