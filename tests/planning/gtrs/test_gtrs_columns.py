"""Tokens of the columns, of models that look at an earlier image, too."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.planning.gtrs.model import ColumnTokens, GtrsModel, new_model


@pytest.fixture
def model(tiny_model: GtrsModel) -> GtrsModel:
    config = tiny_model.config.model_copy(update={"history": 1.0})
    return new_model(config, torch.Generator().manual_seed(3))


def features(model: GtrsModel, seed: int, count: int = 2) -> torch.Tensor:
    config = model.config
    shape = count, config.backbone.out_channels, config.token_rows, config.token_columns
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@torch.no_grad()
def test_columns_come_after_the_image(model: GtrsModel, tiny_model: GtrsModel) -> None:
    config, now = model.config, features(model, 0)
    tokens = model.look(now)
    assert tokens.shape == (2, config.image_tokens + config.token_columns, config.channels)
    torch.testing.assert_close(tokens[:, : config.image_tokens], model.image_tokens(now))
    assert tiny_model.look(now).shape[1] == config.image_tokens  # it looks at one image


@torch.no_grad()
def test_a_pooled_column_is_the_weighted_mean_of_its_rows(model: GtrsModel) -> None:
    config = model.config
    columns = model.get_submodule("_columns")
    assert isinstance(columns, ColumnTokens)
    tokens = model.image_tokens(features(model, 0, 1))
    pooled = columns._pooled(tokens)[0]
    rows = tokens[0].reshape(config.token_rows, config.token_columns, -1)
    for column in range(config.token_columns):
        weights = torch.softmax(columns.weigh(rows[:, column]), dim=0)
        wanted = torch.cat([(weights[:, q, None] * rows[:, column]).sum(dim=0) for q in (0, 1)])
        torch.testing.assert_close(pooled[column], wanted)


@torch.no_grad()
def test_what_was_earlier_changes_the_columns_near_it_alone(model: GtrsModel) -> None:
    now, earlier = features(model, 0), features(model, 1)
    second = torch.ones(2)
    seen = model.look(now, earlier, second)
    changed = earlier.clone()
    changed[..., 0] += 1.0
    difference = (model.look(now, changed, second) - seen).abs().amax(dim=(0, 2)).numpy()
    # Two convolutions over columns reach three of them, 5 and 3 wide.
    reached = np.arange(len(difference)) - model.config.image_tokens
    assert (difference[(reached >= 0) & (reached <= 3)] > 0).any()
    assert not difference[(reached < 0) | (reached > 3)].any()


@torch.no_grad()
def test_without_an_earlier_image_it_matters_to_nobody(model: GtrsModel) -> None:
    now, earlier = features(model, 0), features(model, 1)
    alone, both = model.look(now), model.look(now, earlier, torch.ones(2))
    some = model.look(now, earlier, torch.tensor([1.0, 0.0]))
    torch.testing.assert_close(some[0], both[0])
    torch.testing.assert_close(some[1], alone[1])
    assert (alone - both).abs().max() > 1e-3


@torch.no_grad()
def test_how_much_earlier_matters(model: GtrsModel) -> None:
    """Half a second of motion is half as far as a second of it."""
    now, earlier = features(model, 0), features(model, 1)
    half = model.look(now, earlier, torch.full((2,), 0.5))
    assert (half - model.look(now, earlier, torch.ones(2))).abs().max() > 1e-3
