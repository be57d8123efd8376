from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
import torch

from recast.logs import Track, Trajectory
from recast.reconstruction import SceneConfig, resolve_config
from recast.reconstruction.densify import control_density, reset_opacities, rows
from recast.reconstruction.settings import OPTIM, DensitySchedule
from recast.reconstruction.step import TrainableScene
from support.gaussian_clouds import part


def steps(config: SceneConfig, what: str, views: int = 60) -> list[int]:
    schedule = DensitySchedule(config, views)
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


@pytest.mark.parametrize(("views", "first"), [(60, 200), (150, 200), (600, 700), (5000, 1100)])
def test_omnire_waits_after_a_reset_until_every_image_was_seen(views: int, first: int) -> None:
    config = resolve_config("omnire", options={"iterations": 30_000})
    changes = steps(config, "changes", views)
    assert changes[0] == 500  # there was no reset yet
    for reset in (3000, 6000, 12_000):
        # What is changed in the step of a reset comes before it.
        assert [i for i in changes if i >= reset][:2] == [reset, reset + first]
    # Gradients count from the last change that was left out; until then they have no use.
    counted = set(steps(config, "counts", views))
    left_out = range(3000, 3000 + first - 100)
    assert not counted & set(left_out) and counted >= set(range(left_out[-1] + 1, 6000))


def test_short_runs_keep_most_of_their_changes() -> None:
    config = resolve_config("omnire", options={"iterations": 2800})
    assert steps(config, "changes", 210) == [100, 200, 300, 500, 600, 800, 900, 1100, 1200]


def test_only_a_reset_makes_a_pause() -> None:
    config = SceneConfig(iterations=1000, densify_every=10, densify_until=1.0, densify_pause=1.0)
    everything = list(range(10, 1000, 10))
    assert steps(config, "changes") == everything
    resets = {"opacity_reset_every": 0.2, "opacity_reset_until": 0.4}
    config = config.model_copy(update=resets)
    assert steps(config, "resets") == [200, 400]
    paused = {*range(210, 261, 10), *range(410, 461, 10)}
    assert steps(config, "changes") == [i for i in everything if i not in paused]
    config = config.model_copy(update={"densify_pause": 0.0})
    assert steps(config, "changes") == everything


def test_absolute_gradients_are_asked_for_only_while_they_count() -> None:
    assert steps(SceneConfig(iterations=100), "counts_sizes") == []
    for one in ("densify_by", "actor_densify_by"):
        config = SceneConfig(iterations=100, **{one: "absolute_norm"})
        assert steps(config, "counts_sizes") == list(range(1, 60))


def test_actors_have_a_threshold_of_their_own(model: TrainableScene) -> None:
    for statistics in (model.background_statistics, model.local_statistics):
        statistics.total[:] = 4e-4
        statistics.views[:] = 1
    config = SceneConfig(
        densify_gradient=6e-4, actor_densify_gradient=2e-4, densify_growth=10.0, prune_opacity=0.0
    )
    control_density(model, tracks(), config, torch.Generator())
    assert (len(model.background), len(model.local)) == (40, 24)
    model.background_statistics.total[:] = 7e-4
    model.background_statistics.views[:] = 1
    control_density(model, tracks(), config, torch.Generator())
    assert (len(model.background), len(model.local)) == (80, 24)


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
    limit = math.log(OPTIM.reset_opacity / (1 - OPTIM.reset_opacity))
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
        control_density(model, tracks(), config, torch.Generator(), oversize)
        assert (len(model.background), len(model.local)) == (background, local)


def test_colours_over_time_follow_their_rows(model: TrainableScene) -> None:
    with torch.no_grad():
        model.fourier[:] = torch.arange(12.0)[:, None, None]
        model.local.means[:, 0] = torch.arange(12.0)
    model.local_statistics.total[:] = 9.0
    model.local_statistics.views[:] = 1.0
    config = SceneConfig(densify_growth=10.0, actor_split_above_m=10.0, prune_opacity=0.0)
    control_density(model, tracks(), config, torch.Generator())
    assert len(model.local) == 24 == len(model.fourier)
    assert torch.equal(model.fourier[:, 0, 0].detach(), model.local.means[:, 0].detach())
    moments = model.local_adam.state_dict()["first.waves"]
    assert moments.shape == (24, 2, 3) and set(model.local_parameters()) == {
        *rows(model.local),
        "waves",
    }
