"""The generator of people: a body from one crop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recast.actors.actor import Shares
from recast.actors.generate import PEOPLE_GENERATOR, VEHICLE, Asset, BaseGenerator
from recast.actors.observation import Observation
from recast.actors.people.body import surface_of
from recast.actors.people.clothes import dress
from recast.actors.people.fit import PersonFit, fit_person
from recast.actors.people.views import NOWHERE, PersonView, box_from_body, gait_of, gaussians_of
from recast.arrays import Array
from recast.core.errors import InputError
from recast.logs.types import PEOPLE
from recast.scene.deformation import Gait
from recast.splats import MIP, Gaussians

SPACING = 0.02
"""Metres between the patches of a body."""
_WIDEST, _LONGEST, _TALLEST = 1.3, {"pedestrian": 1.9, "cyclist": 2.5}, 2.4
"""Metres of a box: longer steps or bicycles and wider bodies are those of several people."""
_CHILD = 1.45
"""Metres: smaller people have larger heads and shorter legs than the body."""
_RIDER = 1.25
"""Metres: what is lower is a bicycle without a rider."""
_LEAST = 0.6


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
        category: of the track.
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
        raise refused(f"has a box of {box}: of a group?", "leave it reconstructed (arm native)")
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
    body = gaussians_of(surface, pose, np.full((len(surface.points), 3), 0.5))
    gait = gait_of(surface, pose, fit.shape.cycle, fit.phase, NOWHERE)
    posed = [gait.posed(body, fit.phase + view.gone / gait.cycle) for view in views]
    clothes = dress(surface, posed, views)
    return DressedPerson(gaussians_of(surface, pose, clothes.colours), gait, clothes.shares)


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
