"""Batches, seeds, retries and limits of the whole generation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.trellis.generate import GenerationLimits, ImageTo3D, draw_structures, generate
from support.trellis_folder import write_golden_model


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ImageTo3D:
    return ImageTo3D.load(write_golden_model(tmp_path_factory.mktemp("golden") / "model"))


def blob(colour: int, shift: int = 0) -> NDArray[np.uint8]:
    y, x = np.mgrid[:64, :96]
    inside = (x - 40 - shift) ** 2 / 4 + (y - 34) ** 2 < 18**2
    image = np.zeros((64, 96, 4), np.uint8)
    image[inside] = [colour, 255 - colour, 60, 255]
    image[inside & (x > 50 + shift)] = [20, 20, colour, 255]
    return image


def test_same_seed_same_bytes_other_seed_other_vehicle(model: ImageTo3D) -> None:
    first, again, other = (generate(model, [[blob(90)]], [seed]).vehicles[0] for seed in (3, 3, 4))
    assert torch.equal(first.gaussians.means, again.gaussians.means)
    assert torch.equal(first.latent, again.latent)
    assert not torch.equal(first.structure, other.structure)


def test_a_batch_gives_what_each_gives_alone(model: ImageTo3D) -> None:
    pictures = [blob(30), blob(200, 5), blob(120, -8)]
    together = generate(model, [[p] for p in pictures], [1, 2, 3]).vehicles
    for picture, seed, one in zip(pictures, (1, 2, 3), together, strict=True):
        alone = generate(model, [[picture]], [seed]).vehicles[0]
        assert torch.equal(one.coords, alone.coords)
        torch.testing.assert_close(one.latent, alone.latent, rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(one.gaussians.means, alone.gaussians.means, rtol=1e-4, atol=1e-5)


def test_noise_is_that_of_the_published_pipeline(model: ImageTo3D) -> None:
    condition = model.condition([[blob(90)]], ["crop"])
    made = generate(model, [[blob(90)]], [7]).vehicles[0]
    torch.manual_seed(7)
    structure = model.sample_structure(torch.randn(1, 8, 4, 4, 4), condition)
    coords = model.active_voxels(structure[0])
    latent = model.sample_latent([coords], [torch.randn(len(coords), 8)], condition)
    assert torch.equal(made.structure, structure[0])
    assert torch.equal(made.coords, coords)
    assert torch.equal(made.latent, latent.feats)


def test_the_order_of_views_matters(model: ImageTo3D) -> None:
    views = [blob(30), blob(200)]
    first = generate(model, [views], [1]).vehicles[0]
    turned = generate(model, [views[::-1]], [1]).vehicles[0]
    mean = generate(model, [views], [1], mode="multidiffusion").vehicles[0]
    assert not torch.equal(first.structure, turned.structure)
    assert not torch.equal(first.structure, mean.structure)


def test_too_many_voxels_are_refused_with_name_and_seed(model: ImageTo3D) -> None:
    with pytest.raises(InputError, match=r"car\.png: seeds 5 to 6: .* at most 3 are allowed"):
        generate(
            model,
            [[blob(90)]],
            [5],
            names=["car.png"],
            limits=GenerationLimits(max_voxels=3, retries=1),
        )


def _draw(counts: dict[float, int], seeds: list[int], retries: int):
    """Structures whose number of voxels is looked up by their first noise value."""
    asked = []

    def sample(noise: torch.Tensor, which: list[int]) -> torch.Tensor:
        asked.append(which)
        return noise

    def decode(latent: torch.Tensor) -> torch.Tensor:
        return torch.zeros(counts.get(round(float(latent.flatten()[0]), 5), 10), 3)

    drawn = draw_structures(
        seeds, ["a", "b", "c"], (1, 2, 2, 2), sample, decode, GenerationLimits(retries=retries), 50
    )
    return drawn, asked


def _first_noise(seed: int) -> float:
    return round(float(torch.randn(1, generator=torch.Generator().manual_seed(seed))), 5)


def test_only_failed_vehicles_are_drawn_again() -> None:
    counts = {_first_noise(20): 0, _first_noise(21): 60}
    drawn, asked = _draw(counts, [10, 20, 30], retries=2)
    assert asked == [[0, 1, 2], [1], [1]]
    assert [one.seed for one in drawn] == [10, 22, 30]


def test_an_empty_structure_is_named() -> None:
    with pytest.raises(InputError, match="b: seed 20: the sampled structure is empty"):
        _draw({_first_noise(20): 0}, [10, 20, 30], retries=0)


def test_arguments_must_agree(model: ImageTo3D) -> None:
    with pytest.raises(ValueError, match="2 seeds"):
        generate(model, [[blob(90)]], [1, 2])


def test_times_and_memory_are_told(model: ImageTo3D) -> None:
    stages: list[tuple[str, int, int]] = []
    made = generate(model, [[blob(90)]], [1], progress=lambda *step: stages.append(step))
    assert list(made.seconds) == ["condition", "structure", "latent", "decode"]
    assert made.peak_bytes > 1e6
    assert stages == [("structure", i, 6) for i in range(1, 7)] + [
        ("latent", i, 4) for i in range(1, 5)
    ]
