"""One sample: what the network sees, and what it should say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import state as ego
from recast.geometry import se2
from recast.pipeline.planner_data.situation import Situation
from recast.pipeline.planner_data.stage import Stage
from recast.planning.gtrs.vocabulary import Trajectories
from recast.planning.gtrs_training.network import HALF_VIEWS
from recast.planning.gtrs_training.store import CLUES, Sample
from recast.planning.gtrs_training.targets import score_vocabulary
from recast.planning.status import ego_status
from recast.synthetic.oracle import Oracle
from recast.synthetic.rig import exposure, make_rig

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_LOOK_AHEAD = (10.0, 20.0, 30.0)
"""Metres at which the route's offset is told as a clue."""
_SEEN = np.deg2rad(68.0)


def render(oracle: Oracle, stage: Stage, situation: Situation, rng: np.random.Generator) -> Image:
    """(128, 512, 3) uint8: the three views cropped and stitched; only what is kept is rendered."""
    poses = {} if situation.actor is None else {
        situation.actor.obstacle.token: situation.actor.world_from_actor
    }  # fmt: skip
    for other in situation.others:
        vehicle = stage.world.vehicles[other.token]
        poses[other.token] = stage.surface.actor_poses(other.poses[:1], vehicle.model.size)[0]
    world_from_rig = stage.surface.ego_poses(situation.states[0, ego.POSE])
    layout = HALF_VIEWS
    rig = make_rig(layout.width, layout.height, layout.cameras)
    parts = []
    for name in layout.cameras:
        mounted = rig.cameras[name]
        margin = 0 if name == layout.cameras[1] else layout.crop_columns
        camera = mounted.camera.cropped(
            margin, layout.crop_rows,
            layout.width - 2 * margin, layout.height - 2 * layout.crop_rows,
        )  # fmt: skip
        frame = oracle.render(
            camera, world_from_rig @ mounted.rig_from_camera, poses,
            exposure=exposure(stage.world.seed, name), rng=rng,
        )  # fmt: skip
        parts.append(frame.rgb)
    return np.concatenate(parts, axis=1)


def describe(stage: Stage, situation: Situation, image: Image, vocabulary: Trajectories) -> Sample:
    """The sample of a situation and its picture."""
    targets = [
        score_vocabulary(vocabulary, state, stage.road, situation.obstacles)
        for state in situation.states
    ]
    return Sample(
        image=image,
        status=np.stack([ego_status(situation.command, state) for state in situation.states]),
        scores=np.stack([found.scores for found in targets]),
        best=np.array([found.best for found in targets], np.int32),
        clues=_clues(stage, situation),
    )


def _clues(stage: Stage, situation: Situation) -> NDArray[np.float32]:
    """What the picture tells, see `CLUES`."""
    pose = situation.states[0, ego.POSE]
    clues = np.zeros(len(CLUES), np.float32)
    if situation.actor is not None:
        x, y, heading = se2.relative(pose, situation.actor.obstacle.poses[0])
        if x > 0 and abs(np.arctan2(y, x)) < _SEEN:
            clues[:5] = 1.0, x, y, np.cos(heading), np.sin(heading)
    s, lateral = stage.route.project(pose)
    turn = se2.wrap_angle(pose[2] - stage.route.heading(s))
    ahead = se2.relative(pose, stage.route.pose(s + np.array(_LOOK_AHEAD)))[:, 1]
    clues[5:] = lateral, turn, *ahead
    return clues
