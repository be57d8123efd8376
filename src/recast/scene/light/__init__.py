"""Light: what a street says of it, and vehicles lit where they stand."""

from recast.scene.light.relight import (
    ActorLight,
    CastShadow,
    LitSurface,
    PlaceLight,
    SceneLight,
    SeenShadow,
    darkened,
    recorded_light,
)
from recast.scene.light.sun import SunBelief

__all__ = [
    "ActorLight",
    "CastShadow",
    "LitSurface",
    "PlaceLight",
    "SceneLight",
    "SeenShadow",
    "SunBelief",
    "darkened",
    "recorded_light",
]
