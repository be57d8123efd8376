"""The generator of people: a body from one crop, and as all images of the log show it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from recast.actors.actor import Actor, Refinement, Shares
from recast.actors.evidence import Evidence
from recast.actors.generate import PEOPLE_GENERATOR, VEHICLE, Asset, BaseGenerator
from recast.actors.insert import shadow_below
from recast.actors.observation import Observation
from recast.actors.people.body import BodySurface, surface_of
from recast.actors.people.clothes import DRESS_STEPS, dress
from recast.actors.people.fit import PersonFit, fit_person, outlined
from recast.actors.people.skeleton import SkeletonBody, rest_vertices, skeleton_body
from recast.actors.people.views import NOWHERE, PersonView, box_from_body, gait_of, gaussians_of
from recast.arrays import Array
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.logs.types import PEOPLE
from recast.scene import StreetScene
from recast.scene.deformation import Gait, Skinning
from recast.splats import MIP, Gaussians

if TYPE_CHECKING:
    from recast.actors.refine.images import Layers

SPACING = 0.02
"""Metres between the patches of a body."""
_WIDEST, _LONGEST, _TALLEST = 1.3, {"pedestrian": 1.9, "cyclist": 2.5}, 2.4
"""Metres of a box: longer steps or bicycles and wider bodies are those of several people."""
_CHILD = 1.45
"""Metres: smaller people have larger heads and shorter legs than the body."""
_RIDER = 1.25
"""Metres: what is lower is a bicycle without a rider."""
_LEAST = 0.6
_FITTED = "girth", "pack", "differs"  # details of the parametric body alone
_HOLD_BACK = 4  # of a person there are fewer images than of a vehicle


class PeopleGenerator(BaseGenerator):
    """Pedestrians and cyclists: a parametric body, posed and dressed as the crop shows it.

    How far a person walks in two steps one crop does not tell: that is as in other people of the
    height, until all images of the log are followed (`follow_person`).
    """

    name = PEOPLE_GENERATOR

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The body of the crop.

        Raises:
            InputError: the track is no person, its box holds several, or no rider.
        """
        doubts = require_person(observation.category, observation.size, observation.track_id)
        cyclist = observation.category == "cyclist"
        size = np.asarray(observation.size, np.float64)
        fit, views = fit_person([PersonView.of_crop(observation)], size, cyclist)
        body = dressed(fit, size, views)
        return Asset(
            body.gaussians,
            VEHICLE,
            self.name,
            seed,
            {**details_of(fit), **({"doubts": doubts} if doubts else {})},
            MIP,
            gait=body.gait,
        )


def require_person(category: str, size: Array, track_id: str) -> str:
    """What a person should look at, "" for nothing.

    Args:
        category: category of the track.
        size: (3,) box, metres.

    Raises:
        InputError: no person, several, or a bicycle without a rider.
    """
    length, width, height = (float(side) for side in size)
    box = f"{length:.2f} x {width:.2f} x {height:.2f} m"

    def refused(problem: str, mend: str) -> InputError:
        return InputError(f"track {track_id}", category, problem, mend, "docs/actors.md#people")

    if category not in PEOPLE:
        raise refused("is no pedestrian or cyclist", "choose another `generator`")
    if width > _WIDEST or length > _LONGEST[category]:
        raise refused(
            f"has a box of {box}: the box of a group?", "leave it reconstructed (arm native)"
        )
    if height > _TALLEST:
        raise refused(f"has a box of {box}: too high", "leave it reconstructed (arm native)")
    if height < (_RIDER if category == "cyclist" else _LEAST):
        what = "a bicycle without a rider" if category == "cyclist" else "nobody who walks"
        raise refused(f"has a box of {box}: {what}?", "leave it reconstructed (arm native)")
    if height < _CHILD:
        return "a child by its height: the body has the proportions of adults"
    return ""


@dataclass(frozen=True)
class DressedPerson:
    """A body in its clothes, box frame, on no way yet; shares of its Gaussians."""

    gaussians: Gaussians
    gait: Gait
    shares: Shares


def dressed(fit: PersonFit, size: Array, views: Sequence[PersonView]) -> DressedPerson:
    """The body of a fit in the clothes of the views, in a box of `size` (3,) metres."""
    surface, pose = surface_of(fit.shape, SPACING), box_from_body(size, fit.place)
    gait = gait_of(surface, pose, fit.shape.cycle, fit.phase, NOWHERE)
    return _dressed(surface, pose, gait, views)


def _dressed(
    surface: BodySurface, pose: Array, gait: Gait, views: Sequence[PersonView]
) -> DressedPerson:
    """A surface at `pose` (4, 4) `box_from_body` in the clothes of the views."""
    clothes = dress(surface, _posed(surface, pose, gait, views), views)
    return DressedPerson(gaussians_of(surface, pose, clothes.colours), gait, clothes.shares)


def _posed(
    surface: BodySurface, pose: Array, gait: Gait, views: Sequence[PersonView]
) -> list[Gaussians]:
    """A grey body in each view, in the view's box frame."""
    body = gaussians_of(surface, pose, np.full((len(surface.points), 3), 0.5))
    return [gait.posed(body, gait.phase_after(view.gone)) for view in views]


def dressed_skeleton(body: SkeletonBody, views: Sequence[PersonView]) -> DressedPerson:
    """A body on a skeleton in the clothes of the views, whose masks are cut about it; box frame."""
    surface, pose = body.surface, np.eye(4)
    gait = gait_of(surface, pose, body.cycle, body.phase, NOWHERE)
    cut = outlined(views, _posed(surface, pose, gait, views))
    return _dressed(surface, pose, gait, cut)


def details_of(fit: PersonFit) -> dict[str, str | float | int]:
    """What an asset's record says of a body."""
    shape = fit.shape
    return {
        "height_m": round(shape.height, 3),
        "girth": round(shape.girth, 3),
        "pack": "yes" if shape.pack else "no",
        "cycle_m": round(shape.cycle, 3),
        "differs": round(fit.cost, 3),
    }


def skeleton_details(body: SkeletonBody) -> dict[str, str | float | int]:
    """What an asset's record says of a body on a skeleton."""
    return {
        "body": "skeleton",
        "height_m": round(body.height, 3),
        "cycle_m": round(body.cycle, 3),
        "explained": round(body.explained, 3),
    }


def follow_person(
    actor: Actor,
    evidence: Evidence,
    layers: Sequence[Layers],
    street: StreetScene,
    progress: Progress | None = None,
) -> Actor:
    """The person as all images of the log show it, unless it was better before.

    Build, place, length of the steps and their phase are fitted to masks and images between the
    street's layers, the clothes to the images. If the street has the person on a skeleton of SMPL's
    joints, its body and steps are tried as well. Every fourth image judges; the report's notes say
    why a skeleton is not used.

    Args:
        actor: registered person.
        evidence: evidence of its track, with the poses of the scene.
        layers: its images between the layers of the street.
        street: the street, with its own model of the track.
        progress: called with the number of parts done, and of all.
    """
    assert actor.gait is not None
    size = np.asarray(actor.size, np.float64)
    views = [PersonView.of_layers(one, actor.gait) for one in layers]
    held = range(_HOLD_BACK // 2, len(views), _HOLD_BACK)
    kept = [view for number, view in enumerate(views) if number not in held]

    def told(done: int, parts: int) -> None:
        if progress is not None:
            progress(done, parts + 1)

    fit, cut = fit_person(kept, size, actor.category == "cyclist", told)
    place = (float(fit.place[0]), float(fit.place[1]), 0.0)
    before = actor.provenance.details
    tried = [(dressed(fit, size, cut), place, {**before, **details_of(fit)})]
    skeleton, notes = _skeleton_of(actor, street)
    if skeleton is not None:
        plain = {key: before[key] for key in before if key not in _FITTED}
        details = {**plain, **skeleton_details(skeleton)}
        tried.append((dressed_skeleton(skeleton, kept), (0.0, 0.0, 0.0), details))
    found = [
        replace(
            actor,
            gaussians=body.gaussians,
            gait=replace(body.gait, way=actor.gait.way),
            shares=body.shares,
            trajectory=street.actors[actor.track_id].trajectory,
            shadow=shadow_below(body.gaussians, size),
            low_pass=MIP,
        )
        for body, _, _ in tried
    ]
    if progress is not None:
        progress(1, 1)
    judges = [views[number] for number in held]
    losses = [_judged(one, judges) for one in found]
    best, loss_before = int(np.nanargmin(losses)), _judged(actor, judges)
    body, place, details = tried[best]
    if skeleton is not None and losses[1] >= (other := min(losses[0], loss_before)):
        told_why = "the held-back images differ by {:.3f} with it and by {:.3f} without"
        notes = (f"the skeleton is not used: {told_why.format(losses[1], other)}",)
    report = Refinement(
        images=len(kept),
        held_back=len(judges),
        left_out=dict(Counter(evidence.left_out)),
        loss_before=loss_before,
        loss_bent=losses[best],
        loss_after=losses[best],
        kept=losses[best] < loss_before,
        steps=DRESS_STEPS,
        moved=place,
        seen=float(body.shares.seen.mean()),
        mirrored=float(body.shares.mirrored.mean()),
        notes=notes,
    )
    update = {"refinement": report, **({"details": details} if report.kept else {})}
    provenance = actor.provenance.model_copy(update=update)
    return replace(found[best] if report.kept else actor, provenance=provenance)


def _skeleton_of(actor: Actor, street: StreetScene) -> tuple[SkeletonBody | None, tuple[str, ...]]:
    """The body on the street's skeleton of a person; None without one, or with notes why not."""
    assert actor.gait is not None
    native = street.actors[actor.track_id]
    if not isinstance(native.deformation, Skinning):
        return None, ()
    if actor.category == "cyclist":
        return None, ("the skeleton is not used: it has no bicycle",)
    try:
        vertices = rest_vertices(street, actor.track_id)
        return skeleton_body(native, vertices, actor.gait.way), ()
    except ValueError as error:  # also of files: the parametric body does without them
        return None, (f"the skeleton is not used: {error}",)


def _judged(actor: Actor, views: Sequence[PersonView]) -> float:
    """Mean difference of display values from images, as a share of the masks' areas."""
    assert actor.gait is not None
    losses = []
    for view in views:
        posed = actor.gait.posed(actor.gaussians, actor.gait.phase_after(view.gone))
        with torch.no_grad():
            losses.append(view.differs(*view.drawn(posed))[1])
    return float(np.average(losses, weights=[view.weight for view in views]))
