"""A parametric vehicle coloured from one crop: the generator `template`."""

from recast.actors.template.design import STYLES, VehicleDesign
from recast.actors.template.generator import TemplateGenerator

__all__ = ["STYLES", "TemplateGenerator", "VehicleDesign"]
