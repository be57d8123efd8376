"""Put an actor in the place of a scene's own model of a track."""

from __future__ import annotations

from dataclasses import replace

from recast.actors.actor import Actor
from recast.actors.light import actor_light
from recast.errors import InputError
from recast.scene import StreetScene
from recast.scene.light import SceneLight


def insert(scene: StreetScene, actor: Actor, *, relit: bool = True) -> StreetScene:
    """The scene with the track's Gaussians replaced, and its poses if the actor has refined ones.

    Vehicle and contact shadow are both actor-local and so move under one transform.

    Args:
        relit: whether the actor gets the light of where it stands; if not, it keeps the light that
            it was recorded in, wherever it goes.

    Raises:
        InputError: the scene has no model of the track.
        ValueError: the actor is to be lit and has no surface, see `outer_surface`.
    """
    require_model(scene, actor.track_id)
    native = scene.actors[actor.track_id]
    trajectory = actor.trajectory or native.trajectory
    return scene.with_actor(
        replace(
            native,
            gaussians=actor.gaussians,
            size=actor.size,
            trajectory=trajectory,
            shadow=actor.shadow,
            appearance=None,
            deformation=None,
            low_pass=actor.low_pass,
            light=actor_light(_light(scene, actor), actor, trajectory) if relit else None,
        )
    )


def _light(scene: StreetScene, actor: Actor) -> SceneLight:
    """The light of the street, with what the actor's own shadow says of the sun."""
    light = SceneLight.of(scene)
    return light if actor.sun is None else replace(light, sun=light.sun.given(actor.sun))


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
