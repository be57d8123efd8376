from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from recast.actors import Actor, Asset, Observation, register
from recast.actors.generate import UNIT_CUBE_Y_UP, UNIT_CUBE_Z_UP, VEHICLE
from recast.actors.icp import outer_surface
from recast.actors.place import heading_agreement
from recast.actors.register import lidar_by_side
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.splats import Gaussians


def moved(gaussians: Gaussians, rotation: np.ndarray, scale: float = 1.0) -> Gaussians:
    pose = se3.from_rotation_translation(rotation, np.zeros(3))
    return gaussians.transformed(torch.from_numpy(pose), scale)


def offset(actor: Actor, truth: Gaussians) -> float:
    """Mean distance between corresponding Gaussians, metres."""
    return float((actor.gaussians.means - truth.means).norm(dim=1).mean())


def test_an_asset_in_place_stays_in_place(
    actor: Actor, asset: Asset, observation: Observation
) -> None:
    report = actor.provenance.registration
    assert report.icp_converged
    assert not report.front.flipped
    assert report.after.median <= report.before.median + 1e-3
    assert report.after.median < 0.03
    assert report.after.inlier_share > 0.9
    assert abs(report.icp_scale - 1) < 0.02
    assert offset(actor, asset.gaussians) < 0.05
    surface = outer_surface(actor.gaussians)
    assert surface.points[:, 2].min() == pytest.approx(-observation.size[2] / 2, abs=0.01)


@pytest.mark.parametrize(
    ("convention", "yaw"), [(UNIT_CUBE_Z_UP, 0.4), (UNIT_CUBE_Z_UP, 2.6), (UNIT_CUBE_Y_UP, -1.9)]
)
def test_unit_cube_assets_of_any_heading(
    convention, yaw: float, red_car: Gaussians, observation: Observation, street: DrivingLog
) -> None:
    cube = moved(red_car, convention.rotation().T @ se3.rotation_z(yaw), 1 / 4.5)
    asset = Asset(cube, convention, "test", 0)
    placed = register(asset, observation, street, street.tracks["7"])
    report = placed.provenance.registration
    assert offset(placed, red_car) < 0.06
    assert report.initial_scale == pytest.approx(4.5, rel=0.05)
    assert report.after.median < 0.03


def test_a_flipped_asset_is_turned(
    red_car: Gaussians, observation: Observation, street: DrivingLog
) -> None:
    """It claims to face forward, but its tail lamps are where its headlamps should be."""
    asset = Asset(moved(red_car, se3.rotation_z(np.pi)), VEHICLE, "test", 0)
    placed = register(asset, observation, street, street.tracks["7"])
    report = placed.provenance.registration
    assert report.front.flipped
    assert report.front.votes["heading"] > 0  # the declared front spoke for the wrong way
    assert report.front.votes["silhouette"] < 0
    assert report.front.margin > 1
    assert offset(placed, red_car) < 0.06


def test_colours_alone_tell_front_from_rear(observation: Observation, street: DrivingLog) -> None:
    """A box with a dark end: its shape is the same both ways round."""
    rng = np.random.default_rng(0)
    faces = []
    half = np.array([2.15, 0.86, 0.72])
    for axis in range(3):
        for sign in (-1.0, 1.0):
            face = rng.uniform(-half, half, (2500, 3))
            face[:, axis] = sign * half[axis]
            faces.append(face)
    points = np.concatenate(faces)
    rear_is_red = np.where(points[:, :1] < 0.5, [[0.6, 0.05, 0.05]], [[0.1, 0.8, 0.2]])
    count = len(points)

    def box(turn: float) -> Asset:
        gaussians = Gaussians(
            torch.tensor(points, dtype=torch.float32),
            torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
            torch.full((count, 3), float(np.log(0.03))),
            torch.full((count,), 4.0),
            torch.tensor((rear_is_red - 0.5) / 0.28209479, dtype=torch.float32)[:, None],
        )
        return Asset(moved(gaussians, se3.rotation_z(turn)), UNIT_CUBE_Z_UP, "test", 0)

    for turn, flipped in ((0.0, False), (np.pi, True)):
        report = register(box(turn), observation, street, street.tracks["7"]).provenance
        front = report.registration.front
        assert front.votes["colour"] * (-1 if flipped else 1) > 1
        assert front.flipped == flipped
        assert front.votes["heading"] == 0.0  # a unit cube declares no front


def test_heading_against_motion(street: DrivingLog) -> None:
    track = street.tracks["7"]
    assert heading_agreement(track) == pytest.approx(1.0)
    turned = track.trajectory.poses @ se3.from_rotation_translation(
        se3.rotation_z(np.pi), np.zeros(3)
    )
    backwards = dataclasses.replace(
        track, trajectory=dataclasses.replace(track.trajectory, poses=turned)
    )
    assert heading_agreement(backwards) == pytest.approx(-1.0)
    parked = dataclasses.replace(
        track,
        trajectory=dataclasses.replace(
            track.trajectory, poses=np.repeat(track.trajectory.poses[:1], 5, axis=0)
        ),
    )
    assert heading_agreement(parked) == 0.0


def test_sides_with_lidar() -> None:
    points = np.array([[2.1, 0, 0], [2.0, 0, 0], [0, -0.85, 0], [0, 0, 0]])
    sides = lidar_by_side(points, np.array([4.4, 1.75, 1.45]))
    assert sides == {"front": 2, "rear": 0, "left": 0, "right": 1, "top": 0}


def test_too_few_points(asset: Asset, observation: Observation, street: DrivingLog) -> None:
    with pytest.raises(InputError, match="0 LiDAR points"):
        register(asset, observation, street, street.tracks["10"])


def test_an_asset_of_haze_is_refused(
    asset: Asset, observation: Observation, street: DrivingLog
) -> None:
    haze = dataclasses.replace(
        asset,
        gaussians=dataclasses.replace(
            asset.gaussians, logit_opacities=torch.full((len(asset.gaussians),), -5.0)
        ),
    )
    with pytest.raises(InputError, match="opaque"):
        register(haze, observation, street, street.tracks["7"])


def test_explanation_has_the_residuals(actor: Actor) -> None:
    text = actor.provenance.registration.explain()
    assert f"{actor.provenance.registration.after.median:.3f} m" in text
    assert "rear" in text


def test_a_generator_that_makes_nonsense_is_one_line(
    asset: Asset, observation: Observation, street: DrivingLog
) -> None:
    log_scales = asset.gaussians.log_scales.clone()
    log_scales[5, 2] = 30.0
    wrong = dataclasses.replace(
        asset, gaussians=dataclasses.replace(asset.gaussians, log_scales=log_scales)
    )
    with pytest.raises(InputError, match=r"asset of template: log_scales: row 5 is out of"):
        register(wrong, observation, street, street.tracks["7"])
