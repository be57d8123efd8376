"""3D Gaussians: type, harmonics, files and the differentiable rasterizer."""

from recast.splats.gaussians import Gaussians, concatenate
from recast.splats.native import set_threads
from recast.splats.order import morton_order
from recast.splats.rasterization import Rasterization, RasterMeta
from recast.splats.rasterize import rasterize

__all__ = [
    "Gaussians",
    "RasterMeta",
    "Rasterization",
    "concatenate",
    "morton_order",
    "rasterize",
    "set_threads",
]
