"""A street as 3D Gaussians: background, actors and sky; how it is drawn, stored and imported."""

from recast.scene.actor import SceneActor
from recast.scene.exchange import export_scene, export_scene_at
from recast.scene.sky import SkyMap
from recast.scene.store import load_scene, save_scene
from recast.scene.street_scene import SceneImage, SceneRasterizer, StreetScene, render_scene

__all__ = [
    "SceneActor",
    "SceneImage",
    "SceneRasterizer",
    "SkyMap",
    "StreetScene",
    "export_scene",
    "export_scene_at",
    "load_scene",
    "render_scene",
    "save_scene",
]
