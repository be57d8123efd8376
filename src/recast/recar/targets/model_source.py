"""The model that makes targets: where it lies, and what the cache says of it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recast.recar.targets.record import ModelRecord
from recast.trellis import ImageTo3D
from recast.trellis.checkpoints import GENERATION_ROLES, PipelineRecord, read_pipeline
from recast.trellis.checkpoints.backbone import BACKBONE_FOLDER
from recast.trellis.checkpoints.model_files import model_files
from recast.trellis.checkpoints.record import PIPELINE_FILE
from recast.trellis.checkpoints.roles import LATENT_FLOW

_BLOCK = 1 << 22


@dataclass(frozen=True)
class ModelSource:
    """A model folder in the published layout; every process loads a model of its own from it.

    Attributes:
        folder: with pipeline.json and ckpts/.
        image_encoder: weights of the published image encoder, where the folder has none.
        device: None takes CUDA where there is some, one device a process in turn.
    """

    folder: Path
    image_encoder: Path | None = None
    device: str | None = None

    def load(self, device: str | None = None) -> ImageTo3D:
        """The model, on `device` or its own.

        Raises:
            InputError: see `ImageTo3D.load`.
        """
        return ImageTo3D.load(
            self.folder, device=device or self.device, image_encoder=self.image_encoder
        )

    def record(self) -> ModelRecord:
        """What the cache says of the model, all its files read for the hash.

        Raises:
            InputError: no such folder, or a file is missing or wrong.
        """
        pipeline = read_pipeline(self.folder)
        config: Any = model_files(self.folder, pipeline, LATENT_FLOW).meta_model().config
        mean, std = pipeline.slat_statistics
        return ModelRecord(
            name=self.folder.absolute().name,
            sha256=file_hash(self._files(pipeline)),
            resolution=int(config.resolution),
            latent_mean=mean,
            latent_std=std,
        )

    def pipeline(self) -> PipelineRecord:
        """pipeline.json, for its samplers."""
        return read_pipeline(self.folder)

    def _files(self, pipeline: PipelineRecord) -> Iterator[Path]:
        yield self.folder / PIPELINE_FILE
        roles = list(GENERATION_ROLES)
        if pipeline.encoder_role is not None:
            roles.append(pipeline.encoder_role)
        for role in roles:
            files = model_files(self.folder, pipeline, role)
            yield from (files.config, files.weights)
        if pipeline.encoder_role is None:
            backbone = self.image_encoder or self.folder / BACKBONE_FOLDER
            inside = backbone.rglob("*") if backbone.is_dir() else iter([backbone])
            yield from sorted(path for path in inside if path.is_file())


def file_hash(paths: Iterator[Path]) -> str:
    """SHA-256 of the contents of files, one after the other with their lengths before them."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.stat().st_size.to_bytes(8, "big"))
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                digest.update(block)
    return digest.hexdigest()
