"""A red car as a refined actor: its rear was seen, its left is mirrored, the rest is invented."""

from __future__ import annotations

import numpy as np

from recast.actors import Actor
from recast.actors.actor import (
    CandidateRecord,
    CandidateScore,
    FrontEvidence,
    Provenance,
    Refinement,
    RegistrationReport,
    Shares,
)
from recast.actors.icp import Fit
from recast.actors.insert import contact_shadow
from recast.actors.observation import MaskQuality
from recast.logs import Trajectory
from recast.scene.light.sun import DIRECTIONS
from recast.splats import CLASSIC
from reporting.made_up_rollouts import HOSTILE
from support import made_up_actors as made_up

CANDIDATES = (
    CandidateRecord(
        generator="template",
        seed=0,
        label=f"estate {HOSTILE}",
        chosen=True,
        score=CandidateScore(
            outline=0.93,
            colour=None,
            lidar=0.96,
            lidar_median=0.03,
            free=0.02,
            total=12.3,
            fits=True,
        ),
    ),
    CandidateRecord(generator="recast-mini", seed=1, label=f"is empty, {HOSTILE} " * 9),
)


def refined_actor() -> Actor:
    """The whole story, with hostile names wherever a name comes from outside."""
    car = made_up.car()
    x, y = car.means[:, 0], car.means[:, 1]
    rear = x < -0.35 * made_up.SIZE[0]
    source = np.random.default_rng(0).integers(0, 255, (40, 60, 4), dtype=np.uint8)
    half = made_up.SIZE / 2
    return Actor(
        track_id=f"7 {HOSTILE}",
        category="car",
        size=made_up.SIZE,
        gaussians=car,
        shadow=contact_shadow(-half, half, -half[2]),
        provenance=_provenance(),
        source=source,
        low_pass=CLASSIC,
        shares=Shares(rear.float(), ((y > 0.3 * made_up.SIZE[1]) & ~rear).float()),
        trajectory=Trajectory(np.array([0, 1]), np.tile(np.eye(4), (2, 1, 1))),
        sun=np.zeros(DIRECTIONS),
        seen_shadow=contact_shadow(-half, half, -half[2]),
    )


def _provenance() -> Provenance:
    fit = Fit(0.03, 0.04, 0.9)
    registration = RegistrationReport(
        axes="vehicle",
        initial_scale=1.0,
        initial_yaw=0.0,
        width_over_box=1.0,
        height_over_box=1.0,
        front=FrontEvidence(votes={"lidar": 4.0}, flipped=False, heading_agreement=1.0, margin=4.0),
        before=fit,
        after=fit,
        icp_scale=1.0,
        icp_yaw=0.0,
        icp_translation=(0.0, 0.0, 0.0),
        icp_iterations=3,
        icp_converged=True,
        ground_gap=0.0,
        lidar_points=100,
        lidar_by_side={"rear": 100},
    )
    refinement = Refinement(
        images=9,
        held_back=1,
        left_out={f"too small {HOSTILE}": 2},
        loss_before=0.2,
        loss_bent=0.15,
        loss_after=0.1,
        kept=True,
        steps=40,
        moved=(0.0, 0.0, 0.0),
        turned=0.0,
        grew=(1.0, 1.0, 1.0),
        pose_correction=0.01,
        seen=0.2,
        mirrored=0.1,
        shadow=0.8,
    )
    return Provenance(
        generator=f"template {HOSTILE}",
        seed=0,
        details={"style": "estate"},
        camera=f"front {HOSTILE}",
        frame=3,
        timestamp_us=0,
        azimuth=3.0,
        sides_seen=("rear",),
        mask=MaskQuality(0.2, 0.5, 0.4, 0.4),
        observation=f"track 7 {HOSTILE}\nnext: another",
        registration=registration,
        candidates=CANDIDATES,
        refinement=refinement,
    )
