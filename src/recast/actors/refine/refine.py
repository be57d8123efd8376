"""Refinement: a registered vehicle follows all images of the log, where they show it.

First the whole body moves and bends (outlines, LiDAR, colours), together with the track's poses;
then colours follow, then every Gaussian, as free as the images have seen it. What they did not
show takes over the paint's correction. Held-back images say when to stop, and whether it was worth
it.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors.actor import Actor, Refinement, triple
from recast.actors.evidence import Evidence
from recast.actors.people.generator import follow_person
from recast.actors.refine.descent import (
    FIELDS,
    Bend,
    FreeDescent,
    FreeGaussians,
    FreeShadow,
    PoseOffsets,
    RefinementTask,
    fit_shape,
    split,
    split_rows,
)
from recast.actors.refine.images import (
    follow_paint,
    make_layers,
    shadow_evidence,
    shadow_sheet,
    visibility_of,
)
from recast.actors.refine.settings import REFINE, Steps
from recast.core.diagnostics import Progress
from recast.logs import Trajectory
from recast.scene import StreetScene
from recast.scene.light import darkened
from recast.scene.store import read_tensors, write_tensors
from recast.scene.street_scene import DEFORMABLE
from recast.splats import Gaussians


def refine(
    actor: Actor,
    evidence: Evidence,
    scene: StreetScene,
    seed: int = 0,
    *,
    steps: Steps | None = None,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
) -> Actor:
    """The actor with all that the evidence says of it; never worse than before by its judges.

    Args:
        actor: registered actor, not refined yet.
        evidence: evidence of the actor's track, with the poses of `scene`.
        scene: street that the actor stands in; of its own model of the track only the trajectory is
            used, and a person's skeleton.
        seed: seed of the order of images.
        steps: numbers of steps; those of `Steps` if None.
        checkpoint: file to go on from after a kill, and to be removed by whoever keeps the result;
            one of another task is written anew.
        progress: called with the number of steps done, and of all.

    Raises:
        InputError: the checkpoint is broken, or the disk refuses.
        ValueError: the evidence is of another track.
    """
    if evidence.track_id != actor.track_id:
        raise ValueError(
            f"refine: evidence is of track {evidence.track_id}, actor of {actor.track_id}"
        )
    count = len(evidence.sightings)
    if count < REFINE.least_images:
        note = f"not refined: {count} usable images, at least {REFINE.least_images} are needed"
        left_out = dict(Counter(evidence.left_out))
        return _reported(actor, Refinement(images=count, left_out=left_out, notes=(note,)))
    views = make_layers(scene, evidence, actor.shadow)
    if actor.gait is not None:
        return follow_person(actor, evidence, views, scene, progress)
    told = shadow_evidence(actor, scene, views)
    views = [replace(view, shade=told.darkness * view.shade) for view in views]
    held = views[REFINE.hold_back // 2 :: REFINE.hold_back] or [views[count // 2]]
    kept = [view for view in views if view not in held]
    symmetric = actor.category not in DEFORMABLE
    task = RefinementTask(kept, held, actor.low_pass, symmetric, seed, steps or Steps())
    # A body as a whole is placed by whole masks; later colours decide where their border is.
    firm = replace(task, views=[replace(view, outlined=view.trust) for view in kept])
    times = np.array([one.timestamp_us for one in evidence.sightings], np.int64)
    bend, poses = Bend(actor.size), PoseOffsets(times)
    counter = _Counter(progress, task.steps)

    fit_shape(firm, actor, evidence.hits, bend, poses, counter.step)
    with torch.no_grad():
        bent = bend(actor.gaussians.detach())
    visible = visibility_of(bent, actor.low_pass, views, symmetric)
    loss_before, loss_bent = task.judged(actor.gaussians, None), task.judged(bent, poses)
    shares = visible.shares
    known = shares.seen + shares.mirrored
    source = split_rows(bent, visible.shown & (known > REFINE.split_from))
    finer, visible = split(bent, *source), visible.select(torch.cat(source))
    freedom = visible.freedom(finer)
    moving = freedom > REFINE.least_freedom
    drawn = moving | visible.drawn
    order = torch.cat([one.nonzero()[:, 0] for one in (moving, drawn & ~moving, ~drawn)])
    finer, shares = finer.select(order), visible.shares.select(order)
    free = FreeGaussians(finer, freedom[moving], int(drawn.sum()))
    stood = [one.world_from_object for one in evidence.sightings]
    shadow = FreeShadow(shadow_sheet(replace(actor, gaussians=bent), scene, told, stood))
    descent = FreeDescent(task, free, shadow, poses, shares.seen[: int(drawn.sum())])
    _descend(descent, _identity(actor, evidence, seed), checkpoint, counter)

    refined = follow_paint(free.prior, free.whole(descent.best), shares)
    loss_after = task.judged(refined, poses, descent.best_shadow)
    better = loss_after < loss_before
    report = Refinement(
        images=len(kept),
        held_back=len(held),
        left_out=dict(Counter(evidence.left_out)),
        loss_before=loss_before,
        loss_bent=loss_bent,
        loss_after=loss_after,
        kept=better,
        steps=descent.index,
        moved=triple(bend.move.detach()),
        turned=float(bend.turn.detach()),
        grew=triple(bend.grow.detach().exp()),
        pose_correction=_correction(poses, times),
        shadow=told.darkness,
        seen=_surface_share(refined, shares.seen),
        mirrored=_surface_share(refined, shares.mirrored),
    )
    if not better:
        return _reported(actor, report)
    trajectory = _corrected(scene.actors[actor.track_id].trajectory, poses)
    return _reported(
        replace(
            actor,
            gaussians=refined,
            shares=shares,
            trajectory=trajectory,
            shadow=darkened(actor.shadow, told.darkness),
            sun=told.sun,
            seen_shadow=descent.best_shadow,
        ),
        report,
    )


class _Counter:
    """Counts the steps of both descents."""

    def __init__(self, progress: Progress | None, steps: Steps) -> None:
        self._progress, self.done = progress, 0
        self.total = steps.shape + steps.paint + steps.free

    def step(self, count: int = 1) -> None:
        self.done += count
        if self._progress is not None:
            self._progress(self.done, self.total)


def _descend(
    descent: FreeDescent, identity: str, checkpoint: Path | None, counter: _Counter
) -> None:
    """Go to the end of a descent, from its checkpoint if there is one of the same task."""
    if checkpoint is not None and checkpoint.exists():
        tensors, header = read_tensors(checkpoint)
        if header.get("identity") == identity:
            descent.load(tensors, header)
            counter.step(descent.index)
    while not descent.done:
        descent.step()
        counter.step()
        if checkpoint is not None and descent.index % descent.task.steps.look_every == 0:
            tensors, numbers = descent.state()
            write_tensors(checkpoint, tensors, {"identity": identity, **numbers})
    counter.step(counter.total - counter.done)


def _identity(actor: Actor, evidence: Evidence, seed: int) -> str:
    """Hash of what a descent starts from."""
    digest = hashlib.sha256(f"{seed} {actor.track_id}".encode())
    for name in FIELDS:
        digest.update(getattr(actor.gaussians, name).contiguous().numpy().tobytes())
    for sighting in evidence.sightings:
        for part in (sighting.image, sighting.mask, sighting.trust, sighting.camera_from_object):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def _reported(actor: Actor, report: Refinement) -> Actor:
    return replace(actor, provenance=actor.provenance.model_copy(update={"refinement": report}))


def _correction(poses: PoseOffsets, times: NDArray[np.int64]) -> float:
    shifts = [poses.at(int(time))[:3, 3].detach().square().sum() for time in times]
    return float(torch.stack(shifts).mean().sqrt())


def _corrected(trajectory: Trajectory, poses: PoseOffsets) -> Trajectory:
    """The track's poses with the corrections in the vehicle's frame."""
    with torch.no_grad():
        offsets = [poses.at(int(time)).double().numpy() for time in trajectory.timestamps_us]
    return Trajectory(trajectory.timestamps_us, trajectory.poses @ np.stack(offsets))


def _surface_share(gaussians: Gaussians, share: torch.Tensor) -> float:
    """Mean share (N,) over the opaque Gaussians, by the area of their discs."""
    area = gaussians.log_scales.sort(dim=1).values[:, 1:].sum(dim=1).exp()
    area = area * (gaussians.logit_opacities.sigmoid() > REFINE.surface_opacity)
    return float((area * share).sum()) / max(float(area.sum()), 1e-12)
