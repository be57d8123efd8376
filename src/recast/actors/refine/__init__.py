"""Refinement of a registered vehicle by all that the log knows of it."""

from recast.actors.refine.descent import Steps
from recast.actors.refine.refine import LEAST_IMAGES, refine

__all__ = ["LEAST_IMAGES", "Steps", "refine"]
