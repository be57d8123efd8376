"""The training loss against reference vectors."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from recast.planning.gtrs import METRIC_WEIGHTS, GtrsModel, training_loss, vocabulary_dropout

Vectors = dict[str, Tensor]

TERMS = {
    "no_at_fault_collisions": "pdm_noc_loss",
    "drivable_area_compliance": "pdm_da_loss",
    "time_to_collision_within_bound": "pdm_ttc_loss",
    "ego_progress": "pdm_progress_loss",
    "driving_direction_compliance": "pdm_ddc_loss",
    "lane_keeping": "pdm_lk_loss",
    "traffic_light_compliance": "pdm_tl_loss",
    "imi": "imi_loss",
}


def _targets(tiny_io: Vectors) -> Vectors:
    prefix = "train.gt."
    return {k.removeprefix(prefix): v for k, v in tiny_io.items() if k.startswith(prefix)}


def test_loss_and_gradients(
    tiny_model: GtrsModel, tiny_vocabulary: Tensor, tiny_io: Vectors
) -> None:
    logits = tiny_model.score(
        tiny_model.look(tiny_io["in.feature_map"]), tiny_io["in.status"], tiny_vocabulary
    )
    torch.testing.assert_close(logits["imi"], tiny_io["train.logit.imi"], rtol=1e-5, atol=1e-5)
    terms = training_loss(
        logits, _targets(tiny_io), tiny_vocabulary, tiny_io["train.target_trajectory"]
    )
    assert sorted(terms) == sorted(TERMS)
    for name, golden in TERMS.items():
        expected = tiny_io[f"train.{golden}"].squeeze()
        torch.testing.assert_close(terms[name], expected, rtol=1e-5, atol=1e-5)
    loss = torch.stack(list(terms.values())).sum()
    torch.testing.assert_close(loss, tiny_io["train.loss"].squeeze(), rtol=1e-5, atol=1e-5)
    loss.backward()
    parameters, compared = dict(tiny_model.named_parameters()), 0
    for name, expected in tiny_io.items():
        if name.startswith("train.grad."):
            found = parameters[name.removeprefix("train.grad.")].grad
            assert found is not None
            torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)
            compared += 1
    assert compared == 5


def test_half_a_collision_counts_as_one() -> None:
    logits = {name: torch.zeros(1, 3) for name in TERMS}
    targets = {name: torch.tensor([[0.0, 0.5, 1.0]]) for name in METRIC_WEIGHTS}
    hard = {name: torch.tensor([[0.0, 0.0, 1.0]]) for name in METRIC_WEIGHTS}
    logits = {name: torch.tensor([[0.3, -1.0, 2.0]]) for name in logits}
    trajectories, human = torch.zeros(3, 40, 3), torch.zeros(1, 8, 3)
    soft_terms = training_loss(logits, targets, trajectories, human)
    hard_terms = training_loss(logits, hard, trajectories, human)
    same = {name for name in METRIC_WEIGHTS if torch.equal(soft_terms[name], hard_terms[name])}
    assert same == {"no_at_fault_collisions", "driving_direction_compliance"}


def test_imitation_is_least_for_what_the_human_drove() -> None:
    trajectories = torch.zeros(3, 40, 3)
    trajectories[:, :, 0] = 0.1 * torch.arange(1, 41) * torch.tensor([[2.0], [6.0], [10.0]])
    human = trajectories[1:2, 4::5]
    losses = []
    for favoured in range(3):
        logits = {name: torch.zeros(1, 3) for name in TERMS}
        logits["imi"] = 8.0 * torch.eye(3)[favoured : favoured + 1]
        losses.append(float(training_loss(logits, {}, trajectories, human, {})["imi"]))
    assert losses[1] < 1e-2 < min(losses[0], losses[2])


def test_vocabulary_dropout_draws_without_repeats_from_its_generator() -> None:
    first = vocabulary_dropout(50, 20, torch.Generator().manual_seed(1))
    again = vocabulary_dropout(50, 20, torch.Generator().manual_seed(1))
    other = vocabulary_dropout(50, 20, torch.Generator().manual_seed(2))
    assert torch.equal(first, again) and not torch.equal(first, other)
    assert len(set(first.tolist())) == 20 and int(first.min()) >= 0 and int(first.max()) < 50
    for kept in (0, 51):
        with pytest.raises(ValueError, match=r"1 \.\. 50"):
            vocabulary_dropout(50, kept, torch.Generator())
