"""Actors: observe a track, generate a view-complete vehicle, register it, insert it."""

from recast.actors.actor import Actor, Provenance, RegistrationReport
from recast.actors.generate import (
    AUTO,
    CONVENTIONS,
    DEFAULT_GENERATOR,
    GENERATORS,
    ActorGenerator,
    Asset,
    AxisConvention,
    BaseGenerator,
    axes_of,
    make_generator,
)
from recast.actors.grounded_segmenter import (
    DEFAULT_SEGMENTER,
    SEGMENTERS,
    GroundedSamSegmenter,
    is_segmenter_folder,
    segmenter_of,
)
from recast.actors.insert import insert, turntable
from recast.actors.mesh_generator import MeshGenerator
from recast.actors.observation import MaskQuality, Observation, ViewScore
from recast.actors.observe import observe
from recast.actors.register import register
from recast.actors.segment import BoxLidarSegmenter, Segmentation, SegmentationTarget, Segmenter
from recast.actors.template import TemplateGenerator
from recast.actors.vehicle_files import SplatGenerator, export_actor, load_actor, save_actor
from recast.scene.actor import orbit

__all__ = [
    "AUTO",
    "CONVENTIONS",
    "DEFAULT_GENERATOR",
    "DEFAULT_SEGMENTER",
    "GENERATORS",
    "SEGMENTERS",
    "Actor",
    "ActorGenerator",
    "Asset",
    "AxisConvention",
    "BaseGenerator",
    "BoxLidarSegmenter",
    "GroundedSamSegmenter",
    "MaskQuality",
    "MeshGenerator",
    "Observation",
    "Provenance",
    "RegistrationReport",
    "Segmentation",
    "SegmentationTarget",
    "Segmenter",
    "SplatGenerator",
    "TemplateGenerator",
    "ViewScore",
    "axes_of",
    "export_actor",
    "insert",
    "is_segmenter_folder",
    "load_actor",
    "make_generator",
    "observe",
    "orbit",
    "register",
    "save_actor",
    "segmenter_of",
    "turntable",
]
