from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.actors.parametric import DesignCodec, ParametricModel
from recast.core.errors import InputError
from recast_tools.parametric import photographs, training
from recast_tools.parametric.dataset import DesignsRecord, make_designs, read_rows

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


@pytest.fixture(scope="module")
def designs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("designs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(photographs, "_SEEDS", 1)
        make_designs(folder, 2, DesignsRecord(seed=5, vehicles=2, views=4))
    return folder


def small(**sizes: int) -> ParametricModel:
    del sizes
    return fresh(channels=(8, 8, 8, 8), feature=16, hidden=16, depth=1)


fresh = ParametricModel.fresh


def test_photographs_show_the_vehicle(designs: Path) -> None:
    rows, held_out = read_rows(designs)
    assert 5 <= len(rows.numbers) <= 8
    assert len(held_out.numbers) <= 8
    assert rows.planes.shape[2] == 5
    crop = rows.planes[:, -48 * 48 :]
    assert (crop[..., 3] > 127).float().mean(dim=1).min() > 0.03
    codec = DesignCodec()
    vehicle = codec.decode(rows.numbers[0].numpy(), rows.choices[0].numpy())
    assert vehicle.style in codec.choices[0].choices


def test_a_shard_depends_on_seed_and_index_alone(designs: Path, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(photographs, "_SEEDS", 1)
        make_designs(tmp_path, 1, DesignsRecord(seed=5, vehicles=2, views=4))
    first, second = ({**np.load(path / "shard-0000.npz")} for path in (designs, tmp_path))
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name])
    with pytest.raises(InputError, match="settings"):
        make_designs(tmp_path, 1, DesignsRecord(seed=6, vehicles=2, views=4))


def test_a_killed_training_ends_in_the_same_bytes(
    designs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ParametricModel, "fresh", staticmethod(small))
    train = training.ParametricTask.loss

    def run(out: Path) -> bytes:
        training.train_parametric(designs, out, 5, 0, ignored, checkpoint_every=2)
        return (out / "model.safetensors").read_bytes()

    whole = run(tmp_path / "whole")

    def killed(task: training.ParametricTask, step: int, random: object) -> object:
        if step == 3:
            raise KeyboardInterrupt
        return train(task, step, random)  # type: ignore[arg-type]

    monkeypatch.setattr(training.ParametricTask, "loss", killed)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "killed")
    monkeypatch.setattr(training.ParametricTask, "loss", train)
    assert run(tmp_path / "killed") == whole


def ignored(step: int, logs: Mapping[str, float]) -> None:
    del step, logs


def test_it_learns_what_it_sees_and_the_gap_tells(designs: Path) -> None:
    """Four vehicles by heart: the error falls, and other photographs make the flow worse."""
    rows, _ = read_rows(designs)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = small().network
        training.standardise(network, rows.numbers)
        gap = training.DesignGap(network, rows)
        before = gap()
        task = training.ParametricTask(network, rows, 8)
        optimiser = torch.optim.Adam(network.parameters(), lr=1e-2)
        for step in range(60):
            optimiser.zero_grad()
            task.loss(step, training.StepRandom.of(0, step)).loss.backward()
            optimiser.step()
    after = gap()
    assert after["error"] < 0.5 * before["error"]
    assert after["held_out"] < before["held_out"]
    assert after["gap"] > 0.02
