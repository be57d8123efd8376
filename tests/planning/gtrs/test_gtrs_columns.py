"""Tokens of the columns, of models that look at an earlier image, too."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import torch

from recast.dynamics import PACIFICA
from recast.geometry.boxes import bev_corners
from recast.planning.gtrs import PRIMITIVES
from recast.planning.gtrs.model import GtrsModel, new_model
from recast.planning.gtrs.perception import COLUMN_SCALES, ColumnTokens, Foresight, metres
from recast.planning.pdm.forecast import box_centres


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
    wanted = config.image_tokens + 2 * config.token_columns
    assert tokens.shape == (2, wanted, config.channels)
    torch.testing.assert_close(tokens[:, : config.image_tokens], model.image_tokens(now))
    assert tiny_model.look(now).shape[1] == config.image_tokens  # it looks at one image


@torch.no_grad()
def test_a_column_is_its_rows_one_after_another(model: GtrsModel) -> None:
    config = model.config
    columns = model.get_submodule("_columns")
    assert isinstance(columns, ColumnTokens)
    tokens = model.image_tokens(features(model, 0, 1))
    stacked = columns._stacked(tokens)[0]
    rows = tokens[0].reshape(config.token_rows, config.token_columns, -1)
    for column in range(config.token_columns):
        wanted = torch.cat([columns.narrow(rows[row, column]) for row in range(config.token_rows)])
        torch.testing.assert_close(stacked[column], wanted)


@torch.no_grad()
def test_what_was_earlier_changes_how_things_move_alone(model: GtrsModel) -> None:
    now, earlier = features(model, 0), features(model, 1)
    second = torch.ones(2)
    seen = model.look(now, earlier, second)
    changed = model.look(now, earlier + 1.0, second)
    there = model.config.image_tokens + model.config.token_columns
    torch.testing.assert_close(changed[:, :there], seen[:, :there])
    assert (changed - seen)[:, there:].abs().amax(dim=(0, 2)).min() > 0


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


@torch.no_grad()
def test_how_much_nearer_it_came_is_carried_past_all_layers(model: GtrsModel) -> None:
    """What these learnt of the usual motion of what is seen cannot drown it."""
    columns = model.get_submodule("_columns")
    assert isinstance(columns, ColumnTokens)
    for parameter in columns.compare.parameters():
        parameter.zero_()
    now, earlier = (model.image_tokens(features(model, seed, 1)) for seed in (0, 1))
    stands = model.foresight.stands
    found = columns(now, earlier, torch.tensor([0.5]), stands)[0]
    here, there = (stands(columns._seen(tokens))[0] for tokens in (now, earlier))
    for column, token in enumerate(found[model.config.token_columns :]):
        far, was = metres(here[column]), metres(there[column])
        sure = here[column, 0].sigmoid() * there[column, 0].sigmoid()
        came = sure * (far - was) / 0.5 / 5.0
        carried = columns.carry(torch.stack([came, came / (1.0 + (far / 20.0) ** 2)]))
        torch.testing.assert_close(token, carried)


class TestForesight:
    """What trajectories come close to, against plain loops and shapely."""

    SPEED = 8.0

    @pytest.fixture
    def foresight(self) -> Foresight:
        found = Foresight(8, image_tokens=5, columns=4)
        with torch.no_grad():
            found.directions.copy_(torch.tensor([0.9, 0.12, -0.05, -0.8]))
        return found

    @pytest.fixture
    def trajectories(self) -> torch.Tensor:
        status = np.zeros((1, 8), np.float32)
        status[0, 4], status[0, 7] = self.SPEED, 0.4
        return torch.from_numpy(PRIMITIVES.trajectories(status)[:, ::7])

    @property
    def status(self) -> torch.Tensor:
        return torch.tensor([[0, 1, 0, 0, self.SPEED, 0, 0, 0.4]])

    def seen(self, seed: int) -> torch.Tensor:
        rng = np.random.default_rng(seed)
        values = np.stack(
            [
                rng.uniform(3, 6, 4),  # all are surely there
                np.log(rng.uniform(4, 40, 4)),
                *rng.uniform(-1, 1, (2, 4)),
                rng.uniform(-12, 4, 4),
                rng.uniform(-3, 3, 4),
            ],
            axis=-1,
        )
        return torch.from_numpy(values[None]).float() / torch.tensor(COLUMN_SCALES)

    @pytest.mark.parametrize("seed", range(4))
    @torch.no_grad()
    def test_the_closest_thing_is_found(
        self, foresight: Foresight, trajectories: torch.Tensor, seed: int
    ) -> None:
        seen = self.seen(seed)
        read = seen * torch.tensor(COLUMN_SCALES)
        met = foresight._met(seen, self.status, trajectories)[0].numpy().reshape(-1, 4, 8)
        looks = np.concatenate([np.arange(1, 40, 2), np.full(5, 39)])
        beyond = np.concatenate([np.zeros(20), 0.4 * np.arange(1, 6)])
        for row, path in enumerate(trajectories[0].numpy().astype(float)):
            worst: dict[int, tuple[float, float, float]] = {}
            for look, (index, more) in enumerate(zip(looks, beyond, strict=True)):
                pose = path[index].copy()
                pose[:2] += more * (path[39] - path[38])[:2] / 0.1
                box = shapely.Polygon(
                    bev_corners(box_centres(pose, PACIFICA), PACIFICA.length, PACIFICA.width)
                )
                span = int(np.searchsorted([7, 14, 20], look, side="right"))
                for angle, values in zip(
                    foresight.directions.tolist(), read[0].numpy(), strict=True
                ):
                    away = np.exp(values[1]) * np.array([np.cos(angle), np.sin(angle)])
                    velocity = values[4:] + np.array([self.SPEED, 0.0])
                    time = 0.1 * (index + 1) + more
                    point = shapely.Point(away + [1.5, 0.0] + time * velocity)
                    gap = box.distance(point) or -box.exterior.distance(point)
                    p = 1 / (1 + np.exp(-values[0]))
                    badness = np.log(p) - max(gap, -1.0) / 1.5
                    if span not in worst or badness > worst[span][0]:
                        worst[span] = (badness, gap, p)
            for span, (_, gap, p) in worst.items():
                if gap < -1.0:  # all are as bad: which of them is told does not matter
                    assert met[row, span, 0] > 0.9 * p
                    continue
                for i, (half, over) in enumerate([(0.2, 0.3), (0.7, 0.5), (2.0, 1.0)]):
                    wanted = p / (1 + np.exp(-(half - gap) / over))
                    assert met[row, span, i] == pytest.approx(wanted, abs=2e-3)

    @torch.no_grad()
    def test_what_is_not_there_is_not_met(
        self, foresight: Foresight, trajectories: torch.Tensor
    ) -> None:
        seen = self.seen(0)
        seen[..., 0] = -30.0
        assert foresight._met(seen, self.status, trajectories).abs().max() < 1e-6

    @torch.no_grad()
    def test_a_trajectory_along_the_road_is_not_off_it(self, foresight: Foresight) -> None:
        x = torch.linspace(0.5, 31.0, 40)
        bend = torch.stack([x, 0.004 * x**2, 0.008 * x], dim=-1)
        both = torch.stack([bend, bend + torch.tensor([0.0, 2.0, 0.0])])[None]
        road = torch.tensor([[0.0, 0.0, 0.4, 1.6, 3.6]])  # as `ROAD_AT` sees the bend
        off = foresight._off(road, both)[0]
        assert off[0].abs().max() < 0.1  # straight between what is read
        torch.testing.assert_close(
            off[1, 8:], torch.tanh(torch.tensor(2 / 3)).expand(8), atol=0.06, rtol=0
        )
        beside = foresight._off(torch.tensor([[-2.0, 0.0, 2.4, 3.6, 5.6]]), both)[0]
        assert beside[1].abs().max() < 0.1
        assert (beside[0, :8] < -0.4).all()

    def test_readings_learn_from_the_scores(
        self, foresight: Foresight, trajectories: torch.Tensor
    ) -> None:
        tokens = torch.randn((2, 13, 8), generator=torch.Generator().manual_seed(0))
        added = foresight(tokens, self.status.repeat(2, 1), trajectories)
        assert added.shape == (2, trajectories.shape[1], 8)
        added.square().sum().backward()
        for part in (foresight.stands, foresight.moves, foresight.weigh, foresight.read[0]):
            assert float(part.weight.grad.abs().sum()) > 0
