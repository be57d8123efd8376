"""Nine kinds of street, each drawn anew from a seed."""

from recast.synthetic.streets.catalogue import SCENES, make_street
from recast.synthetic.streets.site import EGO_START

__all__ = ["EGO_START", "SCENES", "make_street"]
