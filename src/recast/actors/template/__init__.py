"""A parametric vehicle coloured from one crop: the generator `template`."""

from recast.actors.template.generator import TemplateGenerator
from recast.actors.template.proportions import STYLES, Proportions

__all__ = ["STYLES", "Proportions", "TemplateGenerator"]
