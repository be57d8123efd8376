"""Cameras and LiDARs in the synthetic world, by ray tracing.

`RayScene` holds the triangles; `render_camera` and `scan_lidar` are the sensors. Needs the extra
`synthetic` (embreex) when a scene is made, not when this package is imported.
"""

from recast.synthetic.rendering.rays import SKY, STREET, Hits, RayScene, require_embree
from recast.synthetic.rendering.sensors import (
    WAYMO_TOP,
    CameraFrame,
    LidarScan,
    LidarSpec,
    render_camera,
    scan_lidar,
)
from recast.synthetic.rendering.shading import working_llvm

__all__ = [
    "SKY",
    "STREET",
    "WAYMO_TOP",
    "CameraFrame",
    "Hits",
    "LidarScan",
    "LidarSpec",
    "RayScene",
    "render_camera",
    "require_embree",
    "scan_lidar",
    "working_llvm",
]
