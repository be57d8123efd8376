"""3D Gaussians: type, harmonics, files and the differentiable rasterizer."""

from recast.splats.adam import RowAdam
from recast.splats.cuda import pick_device
from recast.splats.gaussians import Gaussians, concatenate, morton_order
from recast.splats.native import set_threads
from recast.splats.ply import read_ply, write_ply
from recast.splats.rasterization import (
    CLASSIC,
    MIP,
    LowPass,
    RasterImages,
    Rasterization,
    RasterMeta,
    Window,
    refiltered,
)
from recast.splats.rasterize import FrozenGaussians, freeze, rasterize, rasterize_frozen

__all__ = [
    "CLASSIC",
    "MIP",
    "FrozenGaussians",
    "Gaussians",
    "LowPass",
    "RasterImages",
    "RasterMeta",
    "Rasterization",
    "RowAdam",
    "Window",
    "concatenate",
    "freeze",
    "morton_order",
    "pick_device",
    "rasterize",
    "rasterize_frozen",
    "read_ply",
    "refiltered",
    "set_threads",
    "write_ply",
]
