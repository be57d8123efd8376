"""Folders in the layout of the published TRELLIS checkpoints: read, check, write, begin anew."""

from recast.trellis.checkpoints.load import Checkpoint, export_model, load_checkpoint, load_model
from recast.trellis.checkpoints.model_files import ModelCheck, build, save_checkpoint, save_model
from recast.trellis.checkpoints.pipeline_record import (
    GENERATION_ROLES,
    OPTIONAL_ROLES,
    PipelineRecord,
    read_pipeline,
    write_pipeline,
)
from recast.trellis.checkpoints.sizes import OFFICIAL, SMALL, CheckpointSizes, new_checkpoint
from recast.trellis.checkpoints.verify import (
    check_details,
    check_table,
    first_fault,
    verify_checkpoint,
)

__all__ = [
    "GENERATION_ROLES",
    "OFFICIAL",
    "OPTIONAL_ROLES",
    "SMALL",
    "Checkpoint",
    "CheckpointSizes",
    "ModelCheck",
    "PipelineRecord",
    "build",
    "check_details",
    "check_table",
    "export_model",
    "first_fault",
    "load_checkpoint",
    "load_model",
    "new_checkpoint",
    "read_pipeline",
    "save_checkpoint",
    "save_model",
    "verify_checkpoint",
    "write_pipeline",
]
