"""The kinds of exchangeable parts, and the built-in ones by name.

Only names: a part is imported when it is asked for, so that listing them costs nothing.
"""

from __future__ import annotations

from recast.plugins import Registry

PLANNERS = Registry(
    "planner",
    "recast.planners",
    {
        "constant-velocity": "recast.planning.constant_velocity:ConstantVelocity",
        "gtrs-mini": "recast.planning.shipped:gtrs_mini_planner",
        "idm-follower": "recast.planning.idm_follower:IdmLaneFollower",
        "log-replay": "recast.planning.log_replay:LogReplay",
        "pdm-closed": "recast.planning.pdm:PdmClosedPlanner",
    },
)
"""Each is a class or function that makes a `recast.planning.Planner`."""

GENERATORS = Registry(
    "generator",
    "recast.generators",
    {
        "auto": "recast.actors.auto_generator:AutoGenerator",
        "recast-mini": "recast.actors.image_to_3d_generator:recast_mini_generator",
        "template": "recast.actors.template:TemplateGenerator",
    },
)
"""Each is a class or function that makes a `recast.actors.ActorGenerator`."""

SEGMENTERS = Registry(
    "segmenter",
    "recast.segmenters",
    {"box-lidar": "recast.actors.box_lidar_segmenter:BoxLidarSegmenter"},
)
"""Each is a class or function that makes a `recast.actors.Segmenter`."""

IMPORTERS = Registry(
    "importer",
    "recast.importers",
    {
        "argoverse2": "recast.logs.importers.argoverse2:import_argoverse2",
        "drivestudio": "recast.logs.importers.drivestudio:import_drivestudio",
        "kitti": "recast.logs.importers.kitti:import_kitti",
        "nuscenes": "recast.logs.importers.nuscenes:import_nuscenes",
        "py123d": "recast.logs.importers.py123d:import_py123d",
        "street-gaussians": "recast.logs.importers.street_gaussians:import_street_gaussians",
        "waymo": "recast.logs.importers.waymo:import_waymo",
        "waymo-v2": "recast.logs.importers.waymo2:import_waymo2",
    },
)
"""Each is a `recast.logs.importers.LogImporter`."""
