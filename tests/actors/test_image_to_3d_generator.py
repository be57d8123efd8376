"""The image-to-3D model behind the generator seam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from recast.actors import Observation, make_generator
from recast.actors.generate import ImageTo3DGenerator
from recast.core.errors import InputError
from recast.splats import MIP
from recast.trellis import GenerationLimits
from support.trellis_folder import write_golden_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_golden_model(tmp_path_factory.mktemp("golden") / "tiny-model")


def test_a_model_folder_is_a_generator(folder: Path, observation: Observation) -> None:
    generator = make_generator(str(folder))
    assert isinstance(generator, ImageTo3DGenerator)
    generator.limits = GenerationLimits(max_voxels=4096, retries=3)
    asset = generator.generate(observation, seed=5)
    again = generator.generate(observation, seed=5)
    assert torch.equal(asset.gaussians.means, again.gaussians.means)
    assert asset.generator == "image-to-3d"
    assert not asset.axes.declares_front
    assert asset.low_pass == MIP  # as the decoder's configuration says
    assert asset.details == {
        "model": "tiny-model",
        "voxels": len(asset.gaussians) // 8,
        "views": 1,
    }


def test_the_axes_of_a_model_may_be_named(folder: Path) -> None:
    generator = make_generator(str(folder), "x,z")
    assert isinstance(generator, ImageTo3DGenerator) and generator.axes.declares_front


def test_the_crop_decides(folder: Path, observation: Observation) -> None:
    generator = ImageTo3DGenerator(folder, limits=GenerationLimits(max_voxels=4096))
    turned = replace(observation, rgba=observation.rgba[:, ::-1].copy())
    first, second = (generator.generate(o, seed=1).gaussians for o in (observation, turned))
    assert first.means.shape != second.means.shape or not torch.equal(first.means, second.means)


def test_whole_further_views_count(folder: Path, observation: Observation) -> None:
    """... and one that the image cuts off is left out."""
    generator = ImageTo3DGenerator(folder, limits=GenerationLimits(max_voxels=4096))
    turned = replace(observation, rgba=observation.rgba[:, ::-1].copy())
    cut = replace(turned, view=replace(turned.view, in_image=0.5))
    alone, whole, both = (
        generator.generate(replace(observation, further=further), seed=1)
        for further in ((), (turned,), (turned, cut))
    )
    assert [one.details["views"] for one in (alone, whole, both)] == [1, 2, 2]
    first, second, third = (one.gaussians.means for one in (alone, whole, both))
    assert first.shape != second.shape or not torch.equal(first, second)
    assert torch.equal(second, third)
    generator.offers = 2
    seen = replace(observation, further=(turned,))
    assert [make().details["views"] for make in generator.candidates(seen, 1)] == [2, 1]


def test_an_empty_mask_names_the_track(folder: Path, observation: Observation) -> None:
    rgba = observation.rgba.copy()
    rgba[..., 3] = 0
    generator = ImageTo3DGenerator(folder)
    with pytest.raises(InputError, match="crop of track 7"):
        generator.generate(replace(observation, rgba=rgba), seed=0)


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"pipeline\.json"):
        make_generator(str(tmp_path))
