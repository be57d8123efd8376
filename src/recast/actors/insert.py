"""Put an actor in the place of a scene's own model of a track."""

from __future__ import annotations

from dataclasses import replace

from recast.actors.actor import Actor
from recast.errors import InputError
from recast.scene import StreetScene


def insert(scene: StreetScene, actor: Actor) -> StreetScene:
    """The scene with the track's Gaussians replaced, and its poses if the actor has refined ones.

    Vehicle and contact shadow are both actor-local and so move under one transform.

    Raises:
        InputError: the scene has no model of the track.
    """
    require_model(scene, actor.track_id)
    native = scene.actors[actor.track_id]
    return scene.with_actor(
        replace(
            native,
            gaussians=actor.gaussians,
            size=actor.size,
            trajectory=actor.trajectory or native.trajectory,
            shadow=actor.shadow,
            appearance=None,
            low_pass=actor.low_pass,
        )
    )


def require_model(scene: StreetScene, track_id: str) -> None:
    """Refuse a scene that has no model of a track.

    Raises:
        InputError: it has none.
    """
    if track_id not in scene.actors:
        known = ", ".join(scene.actors) or "none"
        raise InputError(
            scene.log_name or "scene", f"track {track_id}",
            f"is not an actor of the scene (actors: {known})",
            "train the scene with the track in force_dynamic",
        )  # fmt: skip
