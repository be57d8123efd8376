from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
import torch

from recast.logs import Track, Trajectory
from recast.scene import SceneConfig, resolve_config
from recast.scene.density import DensitySchedule
from recast.scene.population import RESET_OPACITY, change_population, reset_opacities
from recast.scene.trainable import TrainableScene, rows

from .made_up import part


def steps(config: SceneConfig, what: str) -> list[int]:
    schedule = DensitySchedule(config)
    return [i for i in range(1, config.iterations + 1) if getattr(schedule, what)(i)]


def test_the_default_grows_to_a_share_of_the_run_and_never_resets() -> None:
    config = SceneConfig(iterations=1000)
    assert steps(config, "changes") == [100, 200, 300, 400, 500]  # before 60 %
    assert steps(config, "resets") == [] and steps(config, "prunes_oversize") == []


def test_the_papers_schedules_at_the_papers_steps() -> None:
    street = resolve_config("streetgs", options={"iterations": 30_000})
    assert steps(street, "resets") == list(range(3000, 25_001, 3000))
    changes = steps(street, "changes")
    assert (changes[0], changes[1], changes[-1]) == (500, 600, 24_900)
    assert steps(street, "prunes_oversize")[0] == 3001
    omnire = resolve_config("omnire", options={"iterations": 30_000})
    assert steps(omnire, "resets") == list(range(3000, 27_001, 3000))
    assert steps(omnire, "changes")[-1] == 14_900


@pytest.mark.parametrize("iterations", [1, 3, 47])
def test_short_runs_do_not_end_transparent(iterations: int) -> None:
    config = resolve_config("omnire", options={"iterations": iterations})
    assert iterations not in steps(config, "resets")


@pytest.fixture
def model() -> TrainableScene:
    return TrainableScene(part(40, 0), {"a": part(12, 1)}, fourier_terms=3)


def a_step(model: TrainableScene) -> None:
    drawn = model.draw({})
    drawn.gaussians.logit_opacities.sum().backward()
    model.take_gradients(drawn)
    rates = dict.fromkeys(("means", "quats", "log_scales", "logit_opacities", "sh"), 0.1)
    everywhere = torch.ones(40, dtype=torch.bool)
    model.step(everywhere, torch.zeros(12, dtype=torch.bool), rates)


def test_a_reset_lowers_opacities_and_forgets_their_moments(model: TrainableScene) -> None:
    with torch.no_grad():
        model.background.logit_opacities[3] = -9.0
    a_step(model)
    before = model.background.logit_opacities[3].clone()
    reset_opacities(model)
    limit = math.log(RESET_OPACITY / (1 - RESET_OPACITY))
    for gaussians in (model.background, model.local):
        assert float(gaussians.logit_opacities.detach().max()) <= limit + 1e-6
    assert model.background.logit_opacities[3] == before
    state = model.background_adam.state_dict()
    assert not state["first.logit_opacities"].any() and not state["second.logit_opacities"].any()
    a_step(model)  # goes on


def tracks() -> Mapping[str, Track]:
    trajectory = Trajectory(np.array([0], np.int64), np.eye(4)[None])
    return {"a": Track("a", "car", np.array([40.0, 40.0, 40.0]), trajectory)}


def test_large_rows_go_once_there_was_a_reset(model: TrainableScene) -> None:
    with torch.no_grad():
        model.background.log_scales[:5, 1] = math.log(2.0)
        model.local.log_scales[:3, 0] = math.log(0.5)
    config = SceneConfig(prune_above_m=1.9, actor_prune_above_m=0.45, prune_opacity=0.0)
    for oversize, background, local in ((False, 40, 12), (True, 35, 9)):
        change_population(model, tracks(), config, torch.Generator(), oversize)
        assert (len(model.background), len(model.local)) == (background, local)


def test_colours_over_time_follow_their_rows(model: TrainableScene) -> None:
    with torch.no_grad():
        model.waves[:] = torch.arange(12.0)[:, None, None]
        model.local.means[:, 0] = torch.arange(12.0)
    model.local_statistics.total[:] = 9.0
    model.local_statistics.views[:] = 1.0
    config = SceneConfig(densify_growth=10.0, actor_split_above_m=10.0, prune_opacity=0.0)
    change_population(model, tracks(), config, torch.Generator())
    assert len(model.local) == 24 == len(model.waves)
    assert torch.equal(model.waves[:, 0, 0].detach(), model.local.means[:, 0].detach())
    moments = model.local_adam.state_dict()["first.waves"]
    assert moments.shape == (24, 2, 3) and set(model.local_parameters()) == {
        *rows(model.local),
        "waves",
    }
