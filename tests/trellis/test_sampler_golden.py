"""The sampler around the tiny published-layout networks, against golden trajectories."""

from __future__ import annotations

import pytest
import torch
from tests.trellis.sparse_samples import one_sample
from torch import Tensor

from recast.trellis.flow_transformer import (
    SLatFlowConfig,
    SLatFlowModel,
    SparseStructureFlowConfig,
    SparseStructureFlowModel,
)
from recast.trellis.sampler import (
    Condition,
    MultiImageMode,
    SamplerSettings,
    StepRecord,
    noise_scale,
    sample,
)
from recast.trellis.sparse import SparseTensor
from support.trellis import AFTER_TIME, assert_same, golden_config, golden_tensors


@pytest.fixture(scope="module")
def structure_flow() -> SparseStructureFlowModel:
    config = SparseStructureFlowConfig(**golden_config("ss_flow")["args"])
    model = SparseStructureFlowModel(config)
    model.load_published(golden_tensors("ss_flow"))
    return model


@pytest.fixture(scope="module")
def latent_flow() -> SLatFlowModel:
    model = SLatFlowModel(SLatFlowConfig(**golden_config("slat_flow")["args"]))
    model.load_published(golden_tensors("slat_flow"))
    return model


def predicted_data(record: StepRecord, sigma_min: float = 1e-5) -> Tensor:
    """The data x_0 that this step alone points at."""
    return (1 - sigma_min) * record.before - noise_scale(record.t, sigma_min) * record.velocity


def trajectory(records: list[StepRecord]) -> tuple[Tensor, Tensor]:
    """States after the steps, and the data each pointed at."""
    return (
        torch.stack([record.after for record in records]),
        torch.stack([predicted_data(record) for record in records]),
    )


def test_structure_trajectory(structure_flow: SparseStructureFlowModel) -> None:
    golden = golden_tensors("sampler_ss")
    records: list[StepRecord] = []

    found = sample(
        structure_flow,
        golden["noise"],
        Condition(golden["cond"][None]),
        SamplerSettings(steps=6, cfg_strength=7.5),
        on_step=records.append,
    )

    states, data = trajectory(records)
    assert_same(states, golden["pred_x_t"], AFTER_TIME)
    assert_same(data, golden["pred_x_0"], AFTER_TIME)
    assert_same(found, golden["samples"], AFTER_TIME)


@pytest.mark.parametrize(
    ("noise", "settings", "expected"),
    [
        (
            "noise",
            SamplerSettings(steps=6, cfg_strength=3.0, cfg_interval=(0.0, 1.0), rescale_t=1.0),
            "samples_rescale1_cfg3_full",
        ),
        ("noise", SamplerSettings(steps=6, cfg_strength=0.0, rescale_t=1.0), "samples_nocfg"),
        ("noise_b3", SamplerSettings(steps=3), "samples_b3"),
    ],
)
def test_structure_variants(
    structure_flow: SparseStructureFlowModel, noise: str, settings: SamplerSettings, expected: str
) -> None:
    golden = golden_tensors("sampler_ss")
    condition = Condition(golden["cond"][None])

    found = sample(structure_flow, golden[noise], condition, settings)

    assert_same(found, golden[expected], AFTER_TIME)


def test_latent_trajectory(latent_flow: SLatFlowModel) -> None:
    golden = golden_tensors("sampler_slat")
    start = SparseTensor(golden["coords"], golden["noise"], batch_size=1)
    records: list[StepRecord] = []

    found = sample(
        lambda x, t, cond: latent_flow(start.with_feats(x), t, cond).feats,
        start.feats,
        Condition(golden["cond"][None]),
        SamplerSettings(steps=4, cfg_strength=3.0),
        samples=1,
        on_step=records.append,
    )

    states, data = trajectory(records)
    assert_same(states, golden["pred_x_t"], AFTER_TIME)
    assert_same(data, golden["pred_x_0"], AFTER_TIME)
    assert_same(found, golden["samples"], AFTER_TIME)


@pytest.mark.parametrize("mode", ["stochastic", "multidiffusion"])
def test_several_views(structure_flow: SparseStructureFlowModel, mode: MultiImageMode) -> None:
    golden = golden_tensors("sampler_multi_image")
    records: list[StepRecord] = []

    found = sample(
        structure_flow,
        golden["noise"],
        Condition(golden["cond"][:, None], mode),
        SamplerSettings(steps=5, cfg_strength=7.5),
        on_step=records.append,
    )

    assert_same(trajectory(records)[0], golden[f"{mode}_pred_x_t"], AFTER_TIME)
    assert_same(found, golden[f"{mode}_samples"], AFTER_TIME)


def test_samples_of_a_batch_are_those_made_alone(latent_flow: SLatFlowModel) -> None:
    # Two vehicles of different size, each with its own condition, and an empty one between.
    golden = golden_tensors("sampler_slat")
    coords, noise = golden["coords"][:, 1:], golden["noise"]
    both = SparseTensor.stack([coords, coords[:0], coords[:70]], [noise, noise[:0], noise[:70]])
    tokens = torch.cat([golden["cond"], golden["cond"], -golden["cond"]])
    settings = SamplerSettings(steps=2)

    def run(start: SparseTensor, cond: Tensor) -> Tensor:
        return sample(
            lambda x, t, c: latent_flow(start.with_feats(x), t, c).feats,
            start.feats,
            Condition(cond[None]),
            settings,
            samples=start.batch_size,
        )

    together = both.with_feats(run(both, tokens))
    for index in (0, 2):
        assert_same(
            one_sample(together, index).feats,
            run(one_sample(both, index), tokens[index : index + 1]),
        )
