"""A person as all images of the log show it: build, gait and clothes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from recast.actors.actor import Actor, Refinement
from recast.actors.evidence import Evidence
from recast.actors.insert import shadow_below
from recast.actors.people.clothes import DRESS_STEPS
from recast.actors.people.fit import fit_person
from recast.actors.people.generator import details_of, dressed
from recast.actors.people.views import PersonView
from recast.core.diagnostics import Progress
from recast.geometry import Polyline
from recast.logs import Trajectory
from recast.splats import MIP

if TYPE_CHECKING:
    from recast.actors.refine.images import Layers

_HOLD_BACK = 4  # of a person there are fewer images than of a vehicle


def follow_person(
    actor: Actor,
    evidence: Evidence,
    layers: Sequence[Layers],
    trajectory: Trajectory,
    progress: Progress | None = None,
) -> Actor:
    """The person as all images of the log show it, unless it was better before.

    Build, place, length of the steps and their phase are fitted to masks and images between the
    street's layers, the clothes to the images. Every fourth image judges.

    Args:
        actor: registered person.
        evidence: evidence of its track, with the poses of the scene.
        layers: its images between the layers of the street.
        trajectory: the track's poses in the scene.
        progress: called with the number of parts done, and of all.
    """
    assert actor.gait is not None
    size = np.asarray(actor.size, np.float64)
    way = Polyline.from_points(actor.gait.way)
    views = [PersonView.of_layers(one, way) for one in layers]
    held = range(_HOLD_BACK // 2, len(views), _HOLD_BACK)
    kept = [view for number, view in enumerate(views) if number not in held]

    def told(done: int, parts: int) -> None:
        if progress is not None:
            progress(done, parts + 1)

    fit, cut = fit_person(kept, size, actor.category == "cyclist", told)
    body = dressed(fit, size, cut)
    found = replace(
        actor,
        gaussians=body.gaussians,
        gait=replace(body.gait, way=actor.gait.way),
        shares=body.shares,
        trajectory=trajectory,
        shadow=shadow_below(body.gaussians, size),
        low_pass=MIP,
    )
    if progress is not None:
        progress(1, 1)
    judges = [views[number] for number in held]
    before, after = _judged(actor, judges), _judged(found, judges)
    report = Refinement(
        images=len(kept),
        held_back=len(judges),
        left_out=dict(Counter(evidence.left_out)),
        loss_before=before,
        loss_bent=after,
        loss_after=after,
        kept=after < before,
        steps=DRESS_STEPS,
        moved=(float(fit.place[0]), float(fit.place[1]), 0.0),
        seen=float(body.shares.seen.mean()),
        mirrored=float(body.shares.mirrored.mean()),
    )
    details = {**actor.provenance.details, **(details_of(fit) if report.kept else {})}
    update = {"refinement": report, "details": details}
    provenance = actor.provenance.model_copy(update=update)
    return replace(found if report.kept else actor, provenance=provenance)


def _judged(actor: Actor, views: Sequence[PersonView]) -> float:
    """Mean difference of display values from images, as a share of the masks' areas."""
    assert actor.gait is not None
    losses = []
    for view in views:
        posed = actor.gait.posed(actor.gaussians, actor.gait.phase + view.gone / actor.gait.cycle)
        with torch.no_grad():
            losses.append(view.differs(*view.drawn(posed))[1])
    return float(np.average(losses, weights=[view.weight for view in views]))
