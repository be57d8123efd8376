"""Refinement of a registered vehicle by all that the log knows of it."""

from recast.actors.refine.refine import refine
from recast.actors.refine.settings import RefinementSettings, Steps

__all__ = ["RefinementSettings", "Steps", "refine"]
