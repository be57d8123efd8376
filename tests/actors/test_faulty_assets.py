"""What registration, refinement and light do to assets with the faults of image-to-3D models."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from recast.actors import Actor, Asset, Observation, register, turntable
from recast.actors.icp import belonging, outer_surface
from recast.actors.insert import _normals
from recast.logs import DrivingLog
from recast.splats import Gaussians
from support import faulty_assets as faulty
from support import made_up_actors as made_up

HEADING = 2.6


@pytest.fixture(scope="module")
def clean(red_car: Gaussians, observation: Observation, street: DrivingLog) -> Actor:
    asset = faulty.in_cube(red_car, HEADING)
    return register(asset, observation, street, street.tracks["7"])


def placed(parts: list[Gaussians], observation: Observation, street: DrivingLog) -> Actor:
    asset = faulty.in_cube(faulty.together(*parts), HEADING)
    return register(asset, observation, street, street.tracks["7"])


def pictures(actor: Actor) -> np.ndarray:
    views = turntable(actor, views=4, width=160, height=90, with_shadow=False)
    return np.stack(views).astype(np.float64) / 255


def test_floaters_are_left_out_and_told(
    clean: Actor, red_car: Gaussians, observation: Observation, street: DrivingLog
) -> None:
    floating = faulty.floaters(made_up.SIZE)
    actor = placed([red_car, floating], observation, street)
    report = actor.provenance.registration
    assert report.floaters == len(floating)
    assert f"left out {len(floating)} floating" in report.explain()
    assert report.width_over_box == pytest.approx(1.0, abs=0.1)
    assert float((actor.gaussians.means - red_car.means).norm(dim=1).mean()) < 0.03
    # a millimetre moves the edges of lamps and panes
    assert np.quantile(np.abs(pictures(actor) - pictures(clean)), 0.999) < 0.1


def test_parts_that_stand_apart_belong_to_a_vehicle(red_car: Gaussians, asset: Asset) -> None:
    """A trailer is a part of its own, and large."""
    behind = torch.tensor([-6.0, 0.0, 0.0])
    trailer = dataclasses.replace(red_car, means=red_car.means + behind)
    assert belonging(faulty.together(red_car, trailer)).all()
    assert belonging(asset.gaussians).all()


def test_dark_insides_do_not_show(
    clean: Actor, red_car: Gaussians, observation: Observation, street: DrivingLog
) -> None:
    actor = placed([red_car, faulty.dark_inside(red_car)], observation, street)
    report, before = actor.provenance.registration, clean.provenance.registration
    assert report.after.median == pytest.approx(before.after.median, abs=0.005)
    assert report.icp_scale == pytest.approx(before.icp_scale, abs=0.01)
    difference = np.abs(pictures(actor) - pictures(clean))
    assert difference.mean() < 0.005
    assert (difference.max(axis=-1) > 0.25).mean() < 0.005


def test_baked_light_is_told(
    clean: Actor, red_car: Gaussians, observation: Observation, street: DrivingLog
) -> None:
    hull = outer_surface(red_car)
    normals = _normals(red_car, hull.points, hull.normals)
    actor = placed([faulty.lit_from_left(red_car, normals)], observation, street)
    report, before = actor.provenance.registration, clean.provenance.registration
    assert before.left_over_right == pytest.approx(1.0, abs=0.1)
    assert "baked in" not in before.explain()
    assert report.left_over_right > 1.6
    assert "left side" in report.explain() and "baked in" in report.explain()
