"""What surfaces are made of: how they look to a camera and to a LiDAR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Texture = Literal[
    "none", "asphalt", "concrete", "grass", "soil", "foliage", "bark", "brick", "plaster", "tiles",
    "corrugated", "wood", "fabric",
]  # fmt: skip


@dataclass(frozen=True)
class Material:
    """One material; the diffuse colour is given per face.

    Attributes:
        name: unique.
        texture: procedural pattern that multiplies the diffuse colour.
        specular: reflectance at normal incidence, Fresnel F0 in [0, 1].
        roughness: 0 mirrors, 1 has no highlight.
        metallic: reflections take the face's colour, and there is no diffuse part.
        emission: radiance added, in units of the diffuse colour under full daylight.
        lidar: reflectivity at normal incidence in [0, 1] at 905 nm, of a mid-grey surface.
        retroreflective: sends light back where it came from (plates, signs, road markings).
    """

    name: str
    texture: Texture = "none"
    specular: float = 0.0
    roughness: float = 1.0
    metallic: bool = False
    emission: float = 0.0
    lidar: float = 0.3
    retroreflective: bool = False


MATERIALS: tuple[Material, ...] = (
    Material("matte"),
    Material("asphalt", "asphalt", lidar=0.12),
    Material("concrete", "concrete", lidar=0.35),
    Material("marking", "none", lidar=0.65, retroreflective=True),
    Material("grass", "grass", lidar=0.45),
    Material("soil", "soil", lidar=0.25),
    Material("foliage", "foliage", lidar=0.45),
    Material("bark", "bark", lidar=0.25),
    Material("brick", "brick", lidar=0.3),
    Material("plaster", "plaster", lidar=0.5),
    Material("tiles", "tiles", lidar=0.25),
    Material("corrugated", "corrugated", specular=0.04, roughness=0.5, lidar=0.4),
    Material("wood", "wood", lidar=0.35),
    Material("fabric", "fabric", lidar=0.3),
    Material("window", specular=0.06, roughness=0.02, lidar=0.05),
    Material("metal", specular=0.5, roughness=0.4, metallic=True, lidar=0.45),
    Material("sign", lidar=0.9, retroreflective=True),
    Material("signal", emission=1.0, lidar=0.4),
    Material("paint", specular=0.05, roughness=0.02, lidar=0.4),
    Material("glass", specular=0.05, roughness=0.01, lidar=0.04),
    Material("rubber", lidar=0.05),
    Material("chrome", specular=0.75, roughness=0.08, metallic=True, lidar=0.6),
    Material("plastic", specular=0.04, roughness=0.35, lidar=0.12),
    Material("headlamp", specular=0.08, roughness=0.03, lidar=0.7, retroreflective=True),
    Material("taillamp", specular=0.06, roughness=0.05, lidar=0.7, retroreflective=True),
    Material("plate", specular=0.02, roughness=0.4, lidar=0.9, retroreflective=True),
)
"""All materials; `Surface.materials` holds indices into this tuple. Append, never reorder."""

MATERIAL_INDEX: dict[str, int] = {material.name: i for i, material in enumerate(MATERIALS)}
