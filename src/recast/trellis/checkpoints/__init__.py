"""Folders in the layout of the published TRELLIS checkpoints: read, check, write, begin anew."""

from recast.trellis.checkpoints.check import ModelCheck
from recast.trellis.checkpoints.export import export_model
from recast.trellis.checkpoints.load import Checkpoint, load_checkpoint, load_model
from recast.trellis.checkpoints.new import new_checkpoint
from recast.trellis.checkpoints.record import PipelineRecord, read_pipeline, write_pipeline
from recast.trellis.checkpoints.roles import GENERATION_ROLES, OPTIONAL_ROLES
from recast.trellis.checkpoints.save import save_checkpoint, save_model
from recast.trellis.checkpoints.sizes import OFFICIAL, SMALL, CheckpointSizes
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
