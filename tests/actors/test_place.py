"""Placement by pictures alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.actors import Asset, Observation, TemplateGenerator
from recast.actors.generate import UNIT_CUBE_Y_UP, UNIT_CUBE_Z_UP, VEHICLE, AxisConvention
from recast.actors.observe import observation_of_view
from recast.actors.place import PlacedAsset, place_asset
from recast.core.errors import InputError
from recast.geometry import se3
from recast.recar.views import pinhole
from recast.scene.actor import look_at
from recast.splats import Gaussians
from support import made_up_actors as made_up
from support.crops import DISTANCE, FOV_DEG, PIXELS, SIZE, direction, photograph, two_coloured_box

VEHICLE_SHOWN = two_coloured_box()


def seen(azimuth: float, elevation: float = 4.0) -> Observation:
    pose = look_at(DISTANCE * direction(azimuth, elevation), np.zeros(3))
    rgba = photograph(VEHICLE_SHOWN, azimuth, elevation)
    return observation_of_view(rgba, pinhole(PIXELS, PIXELS, FOV_DEG), pose, SIZE, name="view")


def turned(yaw: float, axes: AxisConvention = UNIT_CUBE_Z_UP, scale: float = 0.21) -> Asset:
    """The vehicle as a generator of any heading and unit would give it."""
    rotation = axes.rotation().T @ se3.rotation_z(yaw)
    pose = torch.from_numpy(se3.from_rotation_translation(rotation, [0.1, -0.2, 0.3]))
    return Asset(VEHICLE_SHOWN.transformed(pose, scale), axes, "test", 0)


def placed(asset: Asset, views: Sequence[Observation]) -> PlacedAsset:
    return place_asset(asset, SIZE, views)


def yaw_error(result: PlacedAsset, yaw: float) -> float:
    """Degrees between what was undone and what was done."""
    return float(abs(np.degrees((result.report.yaw + yaw + np.pi) % (2 * np.pi) - np.pi)))


def offset(gaussians: Gaussians) -> float:
    return float((gaussians.means - VEHICLE_SHOWN.means).norm(dim=1).mean())


@settings(max_examples=5, deadline=None)
@given(
    yaw=st.floats(-np.pi, np.pi),
    azimuth=st.sampled_from([35.0, 130.0, 160.0, 235.0]),
)
def test_any_heading_is_found(yaw: float, azimuth: float) -> None:
    result = placed(turned(yaw), [seen(azimuth)])
    assert yaw_error(result, yaw) < 5
    assert offset(result.gaussians) < 0.2
    assert result.report.overlap > 0.93


@pytest.mark.parametrize("yaw", [0.0, np.pi])
def test_front_and_back_are_told_apart(yaw: float) -> None:
    result = placed(turned(yaw, UNIT_CUBE_Y_UP), [seen(130.0)])
    assert yaw_error(result, yaw) < 3
    assert result.report.axes == "unit_cube_y_up"
    # either way, the best yaw of the search is right and its opposite is worse
    assert abs(result.report.votes["silhouette"]) + abs(result.report.votes["colour"]) > 1
    assert result.report.votes["heading"] == 0.0
    assert offset(result.gaussians) < 0.15


def test_a_declared_front_is_kept_unless_the_picture_is_against_it() -> None:
    views = [seen(130.0)]
    kept = placed(turned(0.0, VEHICLE, 1.0), views)
    assert not kept.report.flipped and kept.report.yaw == 0.0
    assert kept.report.votes["heading"] == 3.0
    against = placed(turned(np.pi, VEHICLE, 1.0), views)
    assert against.report.flipped
    assert offset(against.gaussians) < 0.1
    # a vehicle alike at both ends gives no reason to turn it
    plain = replace(VEHICLE_SHOWN, sh=torch.zeros_like(VEHICLE_SHOWN.sh))
    low = plain.select(plain.means[:, 2] < 0.05)
    asset = Asset(low.transformed(torch.eye(4, dtype=torch.float64)), VEHICLE, "test", 0)
    assert not placed(asset, views).report.flipped


def test_scale_and_place_are_refined_by_the_silhouette() -> None:
    """A box 6 % too large, as labels are."""
    large = np.array(SIZE) * 1.06
    views = [seen(130.0), seen(215.0, 8.0)]
    result = place_asset(turned(0.8), large, views)
    assert result.report.overlap > result.report.overlap_before + 0.03
    length = float(np.ptp(result.gaussians.means[:, 0].numpy()))
    assert length == pytest.approx(float(np.ptp(VEHICLE_SHOWN.means[:, 0].numpy())), rel=0.045)


def test_haze_is_refused_and_so_is_no_view() -> None:
    asset = turned(0.0)
    haze = replace(
        asset.gaussians, logit_opacities=torch.full_like(asset.gaussians.logit_opacities, -5.0)
    )
    with pytest.raises(InputError, match="opaque"):
        placed(replace(asset, gaussians=haze), [seen(130.0)])
    with pytest.raises(ValueError, match="at least one observation"):
        placed(asset, [])


def test_an_observation_is_cut_around_the_mask() -> None:
    whole = photograph(VEHICLE_SHOWN, 130.0, 4.0)
    observation = seen(130.0)
    height, width = observation.rgba.shape[:2]
    assert width < PIXELS and height <= width
    assert (observation.rgba[..., 3] > 0).sum() == (whole[..., 3] > 0).sum()
    assert (observation.camera.width, observation.camera.height) == (width, height)
    # a corner of the box is at the same place in the crop as in the whole picture
    corner = se3.apply(observation.camera_from_object, np.array([SIZE]) / 2)
    first, _ = observation.camera.project(corner)
    second, _ = pinhole(PIXELS, PIXELS, FOV_DEG).project(corner)
    inside = tuple(int(v) for v in first[0, ::-1])
    assert (observation.rgba[inside] == whole[tuple(int(v) for v in second[0, ::-1])]).all()
    assert observation.points.shape == (0, 3)
    assert observation.azimuth == pytest.approx(np.radians(130.0))
    assert not observation.mask_quality.warnings()
    with pytest.raises(ValueError, match="mask is empty"):
        observation_of_view(
            np.zeros((8, 8, 4), np.uint8), pinhole(8, 8, 30.0), np.eye(4), SIZE, name="none"
        )


def test_the_template_needs_no_lidar() -> None:
    """The outline tells the style, and nothing is said about distances to no points."""
    camera, pose = pinhole(128, 128, 35.0), look_at(9.0 * direction(125.0, 5.0), np.zeros(3))
    rgba = photograph(made_up.car(style="sedan"), 125.0, 5.0, camera, 9.0)
    observation = observation_of_view(rgba, camera, pose, made_up.SIZE, name="view")
    asset = TemplateGenerator(spacing=0.1).generate(observation, seed=0)
    assert asset.details["style"] == "sedan"  # the box alone says estate
    assert "median_lidar_distance_m" not in asset.details
    assert asset.details["silhouette_overlap"] > 0.85
    asset.gaussians.validate()
