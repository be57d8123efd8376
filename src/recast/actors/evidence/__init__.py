"""All that a log knows of one vehicle: every training image of it, masks, LiDAR, free space."""

from recast.actors.evidence.free_space import FreeSpace, free_space
from recast.actors.evidence.gather import gather_evidence
from recast.actors.evidence.masks import VisualHull, settle_masks
from recast.actors.evidence.sighting import Evidence, Sighting
from recast.actors.evidence.store import load_evidence, save_evidence

__all__ = [
    "Evidence",
    "FreeSpace",
    "Sighting",
    "VisualHull",
    "free_space",
    "gather_evidence",
    "load_evidence",
    "save_evidence",
    "settle_masks",
]
