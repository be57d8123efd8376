"""Which perturbations are drawn, how often and how strong: a file that people can edit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from recast import storage
from recast.recar.perturb.border import Border
from recast.recar.perturb.compression import Compression
from recast.recar.perturb.cropping import Cropping
from recast.recar.perturb.defocus import Defocus
from recast.recar.perturb.dilation import Dilation
from recast.recar.perturb.erosion import Erosion
from recast.recar.perturb.fog import Fog
from recast.recar.perturb.holes import Holes
from recast.recar.perturb.jagged import Jagged
from recast.recar.perturb.kind import Kind, Share
from recast.recar.perturb.leak import Leak
from recast.recar.perturb.low_light import LowLight
from recast.recar.perturb.motion_blur import MotionBlur
from recast.recar.perturb.other_vehicle import OtherVehicle
from recast.recar.perturb.pole import Pole
from recast.recar.perturb.resampling import Resampling
from recast.records import Record, read_record

PERTURBATIONS_FORMAT = "recast-perturbations"
PERTURBATIONS_VERSION = 1


def _at_least_one(interval: tuple[int, int]) -> tuple[int, int]:
    if not 1 <= interval[0] <= interval[1]:
        raise ValueError("two numbers from 1 up are needed, the larger one last")
    return interval


class PerturbationConfig(Record):
    """How conditioning pictures are perturbed in Stage II.

    The default weights make the paper's eight groups equally likely: down-up sampling, blur,
    compression, low light, fog, occlusion, cropping, and mask errors. Kinds are listed, and
    applied, in the order in which a picture comes about: the scene, the air, the lens, the sensor,
    the recorder, the segmenter.

    Attributes:
        rho_clean: chance that a picture stays as it is (paper, Stage II: 0.2).
        composed: fewest and most kinds on one picture, drawn uniformly.
        least_visible: share of the object's opaque area that must be left; draws that leave less
            are drawn again.
        finest: longest extent, in pixels, of a spoilt object; larger ones are brought down to it,
            which is finer than what a crop of 518 pixels shows and spares most of the time.
    """

    format: Literal["recast-perturbations"] = "recast-perturbations"
    version: Literal[1] = 1
    rho_clean: Share = 0.2
    composed: Annotated[tuple[int, int], AfterValidator(_at_least_one)] = (1, 3)
    least_visible: Share = 0.3
    finest: Annotated[float, Field(ge=64, allow_inf_nan=False)] = 448.0
    other_vehicle: OtherVehicle = OtherVehicle()
    pole: Pole = Pole()
    border: Border = Border()
    cropping: Cropping = Cropping()
    fog: Fog = Fog()
    motion_blur: MotionBlur = MotionBlur()
    defocus: Defocus = Defocus()
    low_light: LowLight = LowLight()
    resampling: Resampling = Resampling()
    compression: Compression = Compression()
    erosion: Erosion = Erosion()
    dilation: Dilation = Dilation()
    holes: Holes = Holes()
    leak: Leak = Leak()
    jagged: Jagged = Jagged()

    def kinds(self) -> tuple[Kind, ...]:
        """All kinds, switched off ones included, in the order in which they are applied."""
        members = (getattr(self, name) for name in type(self).model_fields)
        return tuple(member for member in members if isinstance(member, Kind))

    @model_validator(mode="after")
    def _something_to_draw(self) -> Self:
        if self.rho_clean < 1 and not any(kind.weight > 0 for kind in self.kinds()):
            raise ValueError("all kinds have weight 0: give one a weight, or set rho_clean to 1")
        return self


def read_perturbations(path: str | Path) -> PerturbationConfig:
    """Read what `write_perturbations` wrote, or a part of it: what is absent has its default.

    Raises:
        InputError: missing, no JSON, another format or version, or a wrong member.
    """
    return read_record(
        path, PerturbationConfig, PERTURBATIONS_VERSION,
        "mend it, or start from `recast recar perturb --write-config FILE`", PERTURBATIONS_FORMAT,
    )  # fmt: skip


def write_perturbations(path: str | Path, config: PerturbationConfig) -> None:
    """Write a configuration as JSON, every figure of it."""
    storage.write_json(path, config.model_dump(mode="json"))
