"""The model that comes with the package: whole, small, and it looks at the picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from recast.recar import Identity, SynthesisSettings, synthesize_set
from recast.trellis import GeneratedVehicle, ImageTo3D, generate, recast_mini, verify_checkpoint
from recast.trellis.checkpoints import first_fault

pytest.importorskip("embreex")

_DC = 0.28209479177387814  # of the constant spherical harmonic


@pytest.fixture(scope="module")
def model() -> ImageTo3D:
    return ImageTo3D.load(recast_mini(), device="cpu")


@pytest.fixture(scope="module")
def vehicles(tmp_path_factory: pytest.TempPathFactory) -> tuple[Identity, ...]:
    """Two that the model has never seen: other seeds make other vehicles."""
    settings = SynthesisSettings(seed=4242, views=8, width=192, height=128)
    made = synthesize_set(tmp_path_factory.mktemp("set"), 4, settings)
    return tuple(made.identities.values())


def colour(vehicle: GeneratedVehicle) -> np.ndarray:
    """Mean colour of the Gaussians."""
    rgb = vehicle.gaussians.sh[:, 0] * _DC + 0.5
    return rgb.clamp(0, 1).mean(dim=0).numpy()


def test_it_is_whole_and_small() -> None:
    folder: Path = recast_mini()
    assert first_fault(verify_checkpoint(folder, values=True)) is None
    assert sum(path.stat().st_size for path in folder.rglob("*")) < 40e6


def test_it_makes_the_vehicle_in_the_picture(
    model: ImageTo3D, vehicles: tuple[Identity, ...]
) -> None:
    """Its length is along x, and it has the colour of its picture rather than of another's."""
    pictures = [one.view(3) for one in vehicles]
    made = [generate(model, [[one]], [0], names=["car"]).vehicles[0] for one in pictures]
    shown = [np.mean(one[one[..., 3] > 200][:, :3].astype(float) / 255, axis=0) for one in pictures]
    for index, vehicle in enumerate(made):
        extent = np.ptp(vehicle.coords.numpy(), axis=0)
        assert extent[0] > 1.3 * max(extent[1], extent[2])
        apart = [float(np.linalg.norm(colour(vehicle) - other)) for other in shown]
        # two are silver and alike; a black one is 0.5 away from them
        assert apart[index] < 0.2 or int(np.argmin(apart)) == index


def test_the_same_seed_gives_the_same_vehicle(
    model: ImageTo3D, vehicles: tuple[Identity, ...]
) -> None:
    first, again = (
        generate(model, [[vehicles[0].view(1)]], [5], names=["car"]).vehicles[0] for _ in range(2)
    )
    assert torch.equal(first.gaussians.means, again.gaussians.means)
