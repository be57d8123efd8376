"""The kinds of exchangeable parts, and the built-in ones by name.

Only names: a part is imported when it is asked for, so that listing them costs nothing.
"""

from __future__ import annotations

from recast.core.plugins import Registry

PLANNERS = Registry(
    "planner",
    "recast.planners",
    {
        "constant-velocity": "recast.planning.simple:ConstantVelocity",
        "gtrs-mini": "recast.planning.registry:gtrs_mini_planner",
        "idm-follower": "recast.planning.idm_follower:IdmLaneFollower",
        "log-replay": "recast.planning.simple:LogReplay",
        "pdm-closed": "recast.planning.pdm:PdmClosedPlanner",
    },
    members=("name", "needs_images", "reset", "plan"),
    protocol="recast.planning.Planner",
    folder="recast.planning.gtrs:load_gtrs",
    prefixes={"navsim:": "recast.planning.registry:navsim_planner"},
)
"""Each is a class or function that makes a `recast.planning.Planner`."""

_VEHICLE_FILE = "recast.actors.vehicle_files:vehicle_generator"

GENERATORS = Registry(
    "generator",
    "recast.generators",
    {
        "auto": "recast.actors.candidates:AutoGenerator",
        "recast-mini": "recast.actors.image_to_3d:recast_mini_generator",
        "template": "recast.actors.template:TemplateGenerator",
    },
    members=("name", "generate"),
    protocol="recast.actors.ActorGenerator",
    folder="recast.actors.image_to_3d:model_generator",
    files={".ply": _VEHICLE_FILE, ".glb": _VEHICLE_FILE, ".obj": _VEHICLE_FILE},
    prefixes={"library:": "recast.actors.library:LibraryGenerator"},
)
"""Each is a class or function that makes a `recast.actors.ActorGenerator`."""

SEGMENTERS = Registry(
    "segmenter",
    "recast.segmenters",
    {"box-lidar": "recast.actors.segment:BoxLidarSegmenter"},
    members=("segment",),
    protocol="recast.actors.Segmenter",
    folder="recast.actors.grounded_segmenter:grounded_segmenter",
)
"""Each is a class or function that makes a `recast.actors.Segmenter`."""

IMPORTERS = Registry(
    "importer",
    "recast.importers",
    {
        "argoverse2": "recast.logs.importers.argoverse2:load_argoverse2",
        "drivestudio": "recast.logs.importers.drivestudio:load_drivestudio",
        "kitti": "recast.logs.importers.kitti:load_kitti",
        "nuscenes": "recast.logs.importers.nuscenes:load_nuscenes",
        "py123d": "recast.logs.importers.py123d:load_py123d",
        "street-gaussians": "recast.logs.importers.street_gaussians:load_street_gaussians",
        "waymo": "recast.logs.importers.waymo:load_waymo",
        "waymo-v2": "recast.logs.importers.waymo:load_waymo2",
    },
    members=("__call__",),
    protocol="recast.logs.importers.LogImporter",
    makes_parts=False,
    experimental=frozenset({"drivestudio", "nuscenes", "py123d", "street-gaussians", "waymo-v2"}),
)
"""Each is a `recast.logs.importers.LogImporter`."""

SCENES = Registry(
    "scene",
    "recast.scenes",
    {},
    members=("background", "actors", "at"),
    protocol="recast.scene.StreetScene",
    folder="recast.scene.store:load_scene",
)
"""Each is a class or function that makes a `recast.scene.StreetScene`."""
