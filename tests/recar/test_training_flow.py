"""Flow matching towards targets, its conditions, and configurations of stages."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import write_json
from recast.recar.target_cache import Target, TargetCache
from recast.recar.training_conditions import (
    AssetConditions,
    ConditionTokens,
    ConditionView,
    TrainingAsset,
    balanced_parts,
    draw_identities,
    open_conditions,
)
from recast.recar.training_config import (
    BASE,
    MINI_STAGE_1,
    MINI_STAGE_2,
    PRESETS,
    STAGE_1,
    STAGE_2,
    FlowObjective,
    chosen_stage,
    read_stage_config,
)
from recast.recar.training_flow import ConditionGap, FlowTask, LatentFlow, StructureFlow
from recast.training.loop import StepRandom
from recast.trellis import ImageTo3D
from recast.trellis.sampler import FlowMatching
from support.tiny_stage import TinyStage, write_tiny_stage
from support.trellis import AFTER_TIME, assert_same, golden_tensors

CPU = torch.device("cpu")


class CountingEncoder:
    """Tokens that say what the mean colour is; counts its calls."""

    image_size, channels = 16, 48

    def __init__(self) -> None:
        self.calls: list[int] = []

    def encode(self, images: Tensor) -> Tensor:
        self.calls.append(len(images))
        return images.mean((2, 3)).repeat(1, 16)[:, None].repeat(1, 5, 1)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> TinyStage:
    return write_tiny_stage(tmp_path_factory.mktemp("flow"))


@pytest.fixture(scope="module")
def model(stage: TinyStage) -> Iterator[ImageTo3D]:
    yield ImageTo3D.load(stage.model, device="cpu")


def tokens_of(stage: TinyStage, **options: Any) -> ConditionTokens:
    return ConditionTokens(CountingEncoder(), open_conditions(stage.pictures), CPU, **options)


def task_of(stage: TinyStage, flow: Any, **options: Any) -> FlowTask:
    objective = options.pop("objective", FlowObjective(batch=4, autocast=None))
    cache = TargetCache.open(stage.targets)
    tokens = options.pop("tokens", None) or tokens_of(stage)
    return FlowTask(flow, cache, cache.ids("train"), tokens, objective, **options)


def latent_flow(model: ImageTo3D) -> LatentFlow:
    return LatentFlow(model.latent_flow, model.latent_mean, model.latent_std)


def flow_of(model: ImageTo3D, name: str) -> Any:
    return StructureFlow(model.structure_flow) if name == "structure" else latent_flow(model)


def test_the_latent_flow_is_given_normalised_latents_as_in_the_golden_step(
    model: ImageTo3D,
) -> None:
    golden = golden_tensors("train_slat_flow")
    rows = [golden["coords"][:, 0] == i for i in range(2)]
    raw = golden["x_0"] * model.latent_std + model.latent_mean
    structure = np.zeros(model.structure_shape, np.float32)
    targets = [Target(structure, golden["coords"][r, 1:].numpy(), raw[r].numpy()) for r in rows]
    data = latent_flow(model).data(targets)
    assert_same(data.x0, golden["x_0"])
    assert torch.equal(data.batch, golden["coords"][:, 0].long())
    dropped = golden["cond"].masked_fill(golden["drop_mask"][:, None, None], 0.0)
    found = FlowMatching().loss(
        data.velocity, data.x0, dropped, golden["t"], golden["noise"], data.batch
    )
    assert_same(found.loss.detach(), golden["loss"], AFTER_TIME)


@pytest.mark.parametrize("name", ["structure", "latent"])
def test_a_step_repeats_and_differs_from_the_next(
    stage: TinyStage, model: ImageTo3D, name: str
) -> None:
    task = task_of(stage, flow_of(model, name))
    losses = [float(task.loss(step, StepRandom.of(0, step)).loss.detach()) for step in (0, 0, 1)]
    assert losses[0] == losses[1] != losses[2]
    assert all(np.isfinite(losses))


@pytest.mark.parametrize("name", ["structure", "latent"])
def test_checkpointing_and_bfloat16_change_little(
    stage: TinyStage, model: ImageTo3D, name: str
) -> None:
    def gradient(autocast: str | None, checkpointing: bool) -> tuple[float, Tensor]:
        flow = flow_of(model, name)
        flow.model.train().requires_grad_(True)
        flow.model.checkpointing = checkpointing
        objective = FlowObjective.model_validate({"batch": 2, "autocast": autocast})
        flow.model.zero_grad()
        found = task_of(stage, flow, objective=objective).loss(0, StepRandom.of(0, 0))
        found.loss.backward()
        flow.model.checkpointing = False
        assert all(p.grad is None or p.grad.dtype == torch.float32 for p in flow.model.parameters())
        return float(found.loss.detach()), flow.model.out_layer.weight.grad.clone()

    loss, plain = gradient(None, False)
    again, recomputed = gradient(None, True)
    assert again == loss and torch.equal(recomputed, plain)
    rough, low = gradient("bfloat16", True)
    assert rough != loss and rough == pytest.approx(loss, rel=0.02)
    assert float((low - plain).norm() / plain.norm()) < 0.05


def test_parts_of_a_step_are_its_batch_and_hold_different_vehicles(
    stage: TinyStage, model: ImageTo3D
) -> None:
    task = task_of(stage, latent_flow(model))
    seen = [
        [view.identity for view in task._part(StepRandom.of(0, 5, part, 2))[0]] for part in range(2)
    ]
    assert sorted(seen[0] + seen[1]) == ["car-0", "car-1", "car-2", "car-3"]
    voxels = [sum(task.targets.records[one].voxels for one in part) for part in seen]
    assert voxels == [110, 110]  # 40 + 70 and 50 + 60


def test_all_views_of_a_vehicle_are_drawn(stage: TinyStage, model: ImageTo3D) -> None:
    task = task_of(stage, StructureFlow(model.structure_flow))
    views = {v for step in range(40) for v in task._part(StepRandom.of(0, step))[0]}
    assert views == {ConditionView(f"car-{i}", index) for i in range(4) for index in range(3)}


def test_conditions_are_dropped_and_altered_as_often_as_asked(
    stage: TinyStage, model: ImageTo3D
) -> None:
    def darker(rgba: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return rgba // np.array([2, 2, 2, 1], np.uint8)

    task = task_of(
        stage,
        StructureFlow(model.structure_flow),
        perturb=darker,
        clean_share=0.2,
        objective=FlowObjective(batch=4, condition_drop=0.3, autocast=None),
    )
    logs = [task.loss(step, StepRandom.of(0, step)).logs for step in range(60)]
    assert np.mean([one["altered"] for one in logs]) == pytest.approx(0.8, abs=0.08)
    assert np.mean([one["dropped"] for one in logs]) == pytest.approx(0.3, abs=0.09)
    assert sum(np.isfinite(one["t9"]) for one in logs) > sum(np.isfinite(one["t2"]) for one in logs)


def test_clean_tokens_are_kept_within_the_bound_and_altered_ones_never(stage: TinyStage) -> None:
    one = 5 * 48 * 4
    tokens = tokens_of(stage, kept_bytes=2 * one)
    views = [ConditionView("car-0", 0), ConditionView("car-1", 0), ConditionView("car-2", 0)]
    rng = np.random.default_rng(0)
    first = tokens.of(views, [None] * 3, rng)
    again = tokens.of(views, [None] * 3, rng)
    assert torch.equal(first, again)
    assert tokens.encoder.calls == [1, 1, 1, 1]  # the third one anew
    assert tokens.used_bytes == 2 * one
    half = tokens.of(views[:1], [lambda rgba, rng: rgba // np.array([2, 2, 2, 1], np.uint8)], rng)
    assert float(half.sum()) < 0.7 * float(first[:1].sum())
    assert torch.equal(tokens.of(views[:1], [None], rng), first[:1])


def test_a_training_encoder_has_gradients_and_nothing_is_kept(stage: TinyStage) -> None:
    tokens = tokens_of(stage, frozen=False, kept_bytes=1 << 20)
    scale = torch.ones((), requires_grad=True)
    encode = tokens.encoder.encode
    tokens.encoder.encode = lambda images: scale * encode(images)
    out = tokens.of(
        [ConditionView("car-0", 0), ConditionView("car-1", 1)],
        [None, None],
        np.random.default_rng(0),
    )
    out.sum().backward()
    assert scale.grad is not None and tokens.used_bytes == 0


def test_the_gap_is_zero_for_a_flow_that_ignores_its_picture_and_not_for_another(
    stage: TinyStage, model: ImageTo3D
) -> None:
    class Blind(StructureFlow):
        def data(self, targets: Any) -> Any:
            data = super().data(targets)
            blind = lambda x, t, cond: self.model(x, t, torch.zeros_like(cond))  # noqa: E731
            return dataclasses.replace(data, velocity=blind)

    held_out = ("car-4", "car-5")
    for flow, sees in ((StructureFlow, True), (Blind, False)):
        task = task_of(stage, flow(model.structure_flow))
        gap = ConditionGap(task, task.tokens, held_out)
        found = gap()
        assert found == gap()  # always the same times and noise
        assert (found["gap"] != 0) == sees
        assert found["shuffled"] - found["held_out"] == found["gap"]


def test_one_vehicle_is_not_enough(stage: TinyStage, model: ImageTo3D) -> None:
    cache = TargetCache.open(stage.targets)
    with pytest.raises(InputError, match="train identities: 1 can be used, at least two"):
        FlowTask(latent_flow(model), cache, ("car-0",), tokens_of(stage), FlowObjective())


def test_conditions_of_assets_are_their_crops() -> None:
    def read(path: Path) -> TrainingAsset:
        pictures = np.full((5, 4, 4, 4), int(path.stem), np.uint8)
        pictures += np.arange(5, dtype=np.uint8)[:, None, None, None]
        empty = np.zeros(0, np.float32)
        return TrainingAsset(
            "van",
            empty,
            empty,
            empty,
            pictures,
            empty,
            empty,
            2,  # type: ignore[arg-type]
        )

    source = AssetConditions([Path("a/20.npz"), Path("a/10.npz")], read)
    assert source.ids == ("10", "20")
    assert source.count("10") == 2
    assert source.picture("20", 1)[0, 0, 0] == 21
    with pytest.raises(IndexError):
        source.picture("20", 2)


@given(st.lists(st.integers(1, 1000), min_size=1, max_size=12), st.data())
def test_parts_are_balanced(loads: list[int], data: st.DataObject) -> None:
    parts = data.draw(st.integers(1, len(loads)))
    groups = balanced_parts(loads, parts)
    assert sorted(i for group in groups for i in group) == list(range(len(loads)))
    assert len(groups) == parts and all(groups)
    totals = [sum(loads[i] for i in group) for group in groups]
    # Graham 1969: at most 4/3 - 1/(3 parts) of the best, which is at least the mean and the most.
    best = max(sum(loads) / parts, max(loads))
    assert max(totals) <= (4 / 3) * best + max(loads) / 3 + 1e-9


def test_more_parts_than_samples_is_an_error() -> None:
    with pytest.raises(ValueError, match="does not split into 3"):
        balanced_parts([1, 2], 3)


@given(st.integers(2, 9), st.integers(1, 20), st.integers(0, 99))
def test_no_vehicle_is_drawn_twice_before_all_were(many: int, count: int, seed: int) -> None:
    names = [f"v{i}" for i in range(many)]
    drawn = draw_identities(names, count, np.random.default_rng(seed))
    assert len(drawn) == count
    counts = [drawn.count(name) for name in names]
    assert max(counts) - min(counts) <= 1


def test_the_presets_are_the_papers() -> None:
    for stage, rate, steps in ((STAGE_1, 1e-5, (10_000, 16_000)), (STAGE_2, 2e-6, (12_000,) * 2)):
        assert stage.structure and stage.latent
        assert (stage.structure.steps, stage.latent.steps) == steps
        for settings in stage.settings.values():
            assert (settings.lr, settings.ema_decay) == (rate, 0.9999)
            assert settings.schedule == "constant" and settings.weight_decay == 0
        assert (stage.objective.batch, stage.objective.condition_drop) == (2, 0.1)
        assert (stage.objective.time_mean, stage.objective.time_std) == (1.0, 1.0)
        assert not stage.train_encoder
    assert STAGE_1.perturbation is None
    assert STAGE_2.perturbation and STAGE_2.perturbation.rho_clean == 0.2
    assert MINI_STAGE_1.perturbation is None
    assert MINI_STAGE_2.perturbation == STAGE_2.perturbation
    assert not BASE.train_encoder  # its tokens are kept


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_written_out_in_full_reads_back(name: str, tmp_path: Path) -> None:
    path = tmp_path / "stage.json"
    write_json(path, PRESETS[name].model_dump(mode="json"))
    assert read_stage_config(path) == PRESETS[name]


def test_a_file_changes_a_preset_member_by_member(tmp_path: Path) -> None:
    path = tmp_path / "stage.json"
    write_json(
        path,
        {
            "preset": "stage-2",
            "structure": {"steps": 7},
            "latent": None,
            "perturbation": {"rho_clean": 0.5},
        },
    )
    found = read_stage_config(path)
    assert found.structure and STAGE_2.structure and found.perturbation
    assert found.structure == STAGE_2.structure.model_copy(update={"steps": 7})
    assert found.latent is None and found.perturbation.rho_clean == 0.5
    assert found.settings.keys() == {"structure"}


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"preset": "stage-3"}, "preset: is 'stage-3'"),
        ({"preset": "stage-1", "structure": {"steps": 0}}, "structure.steps"),
        ({"preset": "stage-1", "learning_rate": 1}, "learning_rate"),
        ({"preset": "stage-1", "structure": {"ema_decay": None}}, "ema_decay is null"),
        (
            {"preset": "base", "structure": None, "train_encoder": True},
            "the encoder can only train with the structure flow",
        ),
        ({"name": "x"}, "structure: Field required"),
        ([1], "is not an object"),
    ],
)
def test_a_wrong_file_is_refused(values: object, match: str, tmp_path: Path) -> None:
    path = tmp_path / "stage.json"
    write_json(path, values)
    with pytest.raises(InputError, match=match):
        read_stage_config(path)


def test_the_stage_of_a_command(tmp_path: Path) -> None:
    assert chosen_stage("1", None) is not None
    assert chosen_stage("2", None).name == "stage-2"
    assert chosen_stage("mini-2", None).name == "mini-stage-2"
    path = tmp_path / "stage.json"
    write_json(path, {"preset": "stage-1", "latent": None})
    assert chosen_stage(None, path).settings.keys() == {"structure"}
    for stage, file in ((None, None), ("1", path)):
        with pytest.raises(InputError, match="`stage`"):
            chosen_stage(stage, file)
