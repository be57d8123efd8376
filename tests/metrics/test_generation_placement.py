"""Placing vehicles for comparison: by pictures, or as the model says."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.actors import Asset, Observation
from recast.actors.generate import UNIT_CUBE_Y_UP, UNIT_CUBE_Z_UP
from recast.actors.observe import observation_of_view
from recast.core.errors import InputError
from recast.geometry import se3
from recast.scene.actor import look_at
from recast.splats import Gaussians
from recast.studies.generation.cells import place
from support.crops import CAMERA, DISTANCE, SIZE, direction, photograph, two_coloured_box


def turned(rotation: np.ndarray) -> Gaussians:
    """The vehicle in a unit cube, turned."""
    pose = se3.from_rotation_translation(rotation, np.array([0.1, -0.05, 0.02]))
    return two_coloured_box().transformed(torch.from_numpy(pose), 1 / SIZE[0])


@pytest.fixture(scope="module")
def observation() -> Observation:
    pose = look_at(DISTANCE * direction(130.0, 10.0), np.zeros(3))
    rgba = photograph(two_coloured_box(), 130.0, 10.0)
    return observation_of_view(rgba, CAMERA, pose, SIZE, name="car/view")


def test_canonical_believes_the_declared_axis(observation: Observation) -> None:
    asset = Asset(turned(np.eye(3)), UNIT_CUBE_Z_UP, "made", 0)
    placed, facts = place(asset, SIZE, [observation], "canonical")
    apart = (placed.means - two_coloured_box().means).numpy()
    assert np.abs(apart).max() < 0.06
    assert facts["by"] == "canonical" and facts["scale"] == pytest.approx(SIZE[0], rel=0.02)
    # the front points to +x whatever the picture says
    reverse = Asset(turned(se3.rotation_z(np.pi)), UNIT_CUBE_Z_UP, "made", 0)
    placed, _ = place(reverse, SIZE, [observation], "canonical")
    green = placed.sh[:, 0, 1] > placed.sh[:, 0, 0]
    assert placed.means[green, 0].mean() < -0.1


def test_canonical_minds_the_axes(observation: Observation) -> None:
    from_z_up = UNIT_CUBE_Y_UP.rotation().T
    asset = Asset(turned(from_z_up), UNIT_CUBE_Y_UP, "made", 0)
    placed, _ = place(asset, SIZE, [observation], "canonical")
    assert np.abs((placed.means - two_coloured_box().means).numpy()).max() < 0.06


def test_views_find_the_heading(observation: Observation) -> None:
    reverse = Asset(turned(se3.rotation_z(np.pi)), UNIT_CUBE_Z_UP, "made", 0)
    placed, facts = place(reverse, SIZE, [observation], "views")
    green = placed.sh[:, 0, 1] > placed.sh[:, 0, 0]
    assert placed.means[green, 0].mean() > 0.1
    assert facts["by"] == "views" and abs(facts["yaw"]) == pytest.approx(np.pi, abs=0.1)


@pytest.mark.parametrize("how", ["views", "canonical"])
def test_what_cannot_be_seen_is_refused(observation: Observation, how: str) -> None:
    box = two_coloured_box()
    box.logit_opacities.fill_(-9.0)
    with pytest.raises(InputError, match="asset of made: shape"):
        place(Asset(box, UNIT_CUBE_Z_UP, "made", 0), SIZE, [observation], how)  # type: ignore[arg-type]
