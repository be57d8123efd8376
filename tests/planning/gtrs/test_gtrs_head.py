"""The head against reference vectors, and its properties."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from recast.planning.gtrs import (
    COMBINED,
    HEADS,
    VOCABULARY_ONLY,
    GtrsModel,
    combined_trajectories,
    final_score,
    product_score,
)
from support.tiny_gtrs import fan

Vectors = dict[str, Tensor]
TOLERANCE = 1e-5


def close(found: Tensor, expected: Tensor, tolerance: float = TOLERANCE) -> None:
    torch.testing.assert_close(found, expected, rtol=tolerance, atol=tolerance)


@pytest.fixture
def chosen(shared: Path) -> Vectors:
    """What the reference drives: published trajectories, not ours to copy."""
    return load_file(shared / "golden" / "planners" / "gtrs_tiny_io.safetensors")


@torch.no_grad()
def test_every_step_of_the_head(
    tiny_model: GtrsModel, tiny_vocabulary: Tensor, tiny_io: Vectors
) -> None:
    vocabulary, head = tiny_vocabulary[None], tiny_model.head
    tokens = tiny_model.image_tokens(tiny_io["in.feature_map"])
    status = tiny_model.encode_status(tiny_io["in.status"])
    close(tokens, tiny_io["mid.keyval"])
    close(status, tiny_io["mid.status_encoding"])
    close(head.embed(vocabulary), tiny_io["mid.pos_embed"])
    close(head.encode(vocabulary), tiny_io["mid.vocab_encoded"])
    close(head.decode(head.prepare(vocabulary), tokens), tiny_io["mid.decoder_out"])


@torch.no_grad()
def test_logits_scores_and_choice(
    tiny_model: GtrsModel, tiny_vocabulary: Tensor, tiny_io: Vectors, chosen: Vectors
) -> None:
    logits = tiny_model.score(
        tiny_model.look(tiny_io["in.feature_map"]), tiny_io["in.status"], tiny_vocabulary
    )
    assert sorted(logits) == sorted(HEADS)
    for name in HEADS:
        close(logits[name], tiny_io[f"logit.{name}"])
    scores = final_score(logits)
    close(scores, tiny_io["scores"])
    best = scores.argmax(dim=1)
    assert best.tolist() == tiny_io["selected_indices"].tolist()
    assert torch.equal(tiny_vocabulary[best], chosen["trajectory"])


@torch.no_grad()
def test_combined_mode(
    tiny_model: GtrsModel, tiny_vocabulary: Tensor, tiny_io: Vectors, chosen: Vectors
) -> None:
    proposals = tiny_io["in.dp_proposals"]
    both = combined_trajectories(tiny_vocabulary, proposals)
    logits = tiny_model.score(
        tiny_model.look(tiny_io["in.feature_map"]), tiny_io["in.status"], both
    )
    for name, expected in tiny_io.items():
        if name.startswith("dp.logit."):
            close(logits[name.removeprefix("dp.logit.")], expected)
    scores = final_score(logits, COMBINED)
    close(scores[:, -6:], tiny_io["dp.overall_log_scores"])
    assert torch.equal(both[range(3), scores.argmax(dim=1)], chosen["dp.trajectory"])
    close(product_score(logits)[:, -6:], tiny_io["dp.overall_scores"])


@torch.no_grad()
def test_scores_of_made_up_arcs(tiny_model: GtrsModel, tiny_io: Vectors) -> None:
    # Computed here, by what agreed with the reference: for those who lack its vocabulary.
    inputs = tiny_model.look(tiny_io["in.feature_map"]), tiny_io["in.status"]
    scores = final_score(tiny_model.score(*inputs, torch.from_numpy(fan(12))))
    expected = [
        [8.169912, 7.722806, 8.457492, 8.134270],
        [5.495943, 5.956626, 6.834010, 6.830514],
        [10.385686, 9.998816, 11.063585, 10.869639],
    ]
    close(scores[:, :4], torch.tensor(expected), 1e-4)
    assert scores.argmax(dim=1).tolist() == [8, 2, 8]


@torch.no_grad()
def test_shared_vocabulary_equals_one_for_each_sample(
    tiny_model: GtrsModel, tiny_io: Vectors
) -> None:
    vocabulary = torch.from_numpy(fan(16))
    inputs = tiny_model.look(tiny_io["in.feature_map"]), tiny_io["in.status"]
    plain = tiny_model.score(*inputs, vocabulary.expand(3, -1, -1, -1))
    for _ in range(2):  # computed, then from the cache
        fast = tiny_model.score(*inputs, vocabulary)
        for name in HEADS:
            close(fast[name], plain[name], 1e-6)


@torch.no_grad()
def test_order_of_the_vocabulary_does_not_matter(tiny_model: GtrsModel, tiny_io: Vectors) -> None:
    vocabulary = torch.from_numpy(fan(16))
    inputs = tiny_model.look(tiny_io["in.feature_map"]), tiny_io["in.status"]
    shuffled = torch.randperm(16, generator=torch.Generator().manual_seed(0))
    scores = final_score(tiny_model.score(*inputs, vocabulary))
    other = final_score(tiny_model.score(*inputs, vocabulary[shuffled]))
    close(other, scores[:, shuffled])


def test_comfort_joins_the_weighted_sum() -> None:
    generator = torch.Generator().manual_seed(0)
    logits = {head: torch.randn(2, 4, generator=generator) for head in HEADS}
    weights = VOCABULARY_ONLY.model_copy(update={"comfort": 3.0})
    calm = torch.tensor([True, False, True, False])
    gain = final_score(logits, weights, calm) - final_score(logits)
    p = {head: value.double().sigmoid() for head, value in logits.items()}
    base = (
        weights.time_to_collision * p["time_to_collision_within_bound"]
        + weights.progress * p["ego_progress"]
        + weights.lane_keeping * p["lane_keeping"]
    )
    wanted = weights.average * torch.log((base + 3.0 * calm) / base)
    # Scores of about 10 in float32, a dozen operations each.
    torch.testing.assert_close(gain.double(), wanted, rtol=0, atol=12 * 2 * 16 * 2.0**-24)
    with pytest.raises(ValueError, match="comfort"):
        final_score(logits, weights)


def test_scores_stay_finite_where_sigmoids_are_zero() -> None:
    logits = {name: torch.full((1, 4), -200.0) for name in HEADS}
    logits["ego_progress"][0, 2] = -199.0
    scores = final_score(logits)
    assert torch.isfinite(scores).all()
    assert int(scores.argmax()) == 2


@pytest.mark.parametrize("name", HEADS)
def test_a_higher_logit_never_lowers_the_score(name: str) -> None:
    generator = torch.Generator().manual_seed(0)
    logits = {head: torch.randn(2, 5, generator=generator) for head in HEADS}
    raised = logits | {name: logits[name] + torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0])}
    gain = final_score(raised) - final_score(logits)
    assert (gain[:, 2] > 0).all()
    assert (gain[:, [0, 1, 3, 4]] <= 0).all()
