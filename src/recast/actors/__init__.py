"""Actors: observe a track, generate a view-complete vehicle, register it, insert it."""

from recast.actors.actor import Actor, Provenance, RegistrationReport
from recast.actors.axes import CONVENTIONS, AxisConvention
from recast.actors.generate import GENERATORS, ActorGenerator, Asset, make_generator
from recast.actors.insert import insert
from recast.actors.observation import MaskQuality, Observation, ViewScore
from recast.actors.observe import observe
from recast.actors.ply_generator import PlyGenerator
from recast.actors.register import register
from recast.actors.segment import BoxLidarSegmenter, SegmentationTarget, Segmenter
from recast.actors.store import load_actor, save_actor
from recast.actors.template import TemplateGenerator
from recast.actors.turntable import turntable

__all__ = [
    "CONVENTIONS",
    "GENERATORS",
    "Actor",
    "ActorGenerator",
    "Asset",
    "AxisConvention",
    "BoxLidarSegmenter",
    "MaskQuality",
    "Observation",
    "PlyGenerator",
    "Provenance",
    "RegistrationReport",
    "SegmentationTarget",
    "Segmenter",
    "TemplateGenerator",
    "ViewScore",
    "insert",
    "load_actor",
    "make_generator",
    "observe",
    "register",
    "save_actor",
    "turntable",
]
