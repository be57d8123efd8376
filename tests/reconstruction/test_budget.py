"""How many Gaussians a scene may have, and what the record says of it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig, TrainingStatus, TrainResult, train_scene
from recast.reconstruction.densify import (
    Budget,
    gaussian_budget,
    street_area,
)
from recast.reconstruction.settings import INIT
from recast.reconstruction.views import read_views
from recast.runs.display import describe
from support.tiny_street import TINY


@pytest.mark.parametrize("length", [0.0, 60.0, 300.0])
@pytest.mark.parametrize("heading", [0.0, 0.6])
def test_the_street_along_a_drive(length: float, heading: float) -> None:
    steps = np.linspace(0, length, 200)
    drive = np.stack([np.cos(heading) * steps, np.sin(heading) * steps], axis=-1)
    wanted = 2 * INIT.street_reach_m * length + math.pi * INIT.street_reach_m**2
    outline = 2 * length + 2 * math.pi * INIT.street_reach_m
    # Cells of 5 m along the outline count whole or not at all, and positions are rounded to cells.
    assert abs(street_area(drive) - wanted) <= 5 * math.sqrt(2) * outline
    there_and_back = np.concatenate([drive, drive[::-1]])
    assert street_area(there_and_back) == street_area(drive)


def test_the_smaller_of_area_and_pixels_counts(tiny_log: DrivingLog) -> None:
    config = SceneConfig(scale=1.0)
    views = read_views(tiny_log, config)
    found = gaussian_budget(config, views)
    training = [view for view in views if not view.held_out]
    pixels = sum(view.image.shape[0] * view.image.shape[1] for view in training)
    assert found.training_pixels == pixels
    assert not found.named
    derived = min(INIT.each_m2 * found.area_m2, pixels / INIT.pixels_each)
    assert found.most_gaussians == max(20_000, int(derived))
    larger = gaussian_budget(config, views * 10)  # more images of the same street
    assert larger.area_m2 == found.area_m2
    assert larger.most_gaussians == max(
        20_000, int(min(INIT.each_m2 * found.area_m2, derived * 10))
    )


def test_a_users_own_number_wins(tiny_log: DrivingLog) -> None:
    config = SceneConfig(scale=1.0, max_gaussians=123)
    found = gaussian_budget(config, read_views(tiny_log, config))
    assert found.named and found.most_gaussians == 123


def test_older_configurations_are_read() -> None:
    assert SceneConfig.model_validate({"version": 1, "max_gaussians": 240_000}).max_gaussians == (
        240_000
    )
    assert SceneConfig.model_validate({"version": 1}).max_gaussians is None


def test_a_limit_that_is_not_met(trained: TrainResult) -> None:
    assert not trained.budget.was_met
    assert trained.budget.explain().endswith("million pixels): not met")
    record = json.loads((trained.folder / "budget.json").read_text())
    assert Budget.model_validate(record) == trained.budget
    assert trained.budget.first_kept == trained.budget.first_found > 0


def test_first_points_and_growth_keep_to_the_limit(tiny_log: DrivingLog, tmp_path: Path) -> None:
    """Half as many Gaussians as there are first points: both are held to it, and it is said."""
    free = read_first_count(tiny_log, tmp_path / "free")
    most = free // 2
    config = TINY.model_copy(
        update={
            "max_gaussians": most,
            "unseen_surfaces": False,
            "densify_gradient": 1e-9,
            "densify_growth": 1e3,
            "densify_until": 1.0,
            "iterations": 60,
        },
    )
    told: list[TrainingStatus] = []
    result = train_scene(tiny_log, tmp_path / "scene", config, told.append)
    budget = result.budget
    assert budget.named and budget.first_found == free
    assert 0.95 * INIT.first_share * most <= budget.first_kept <= INIT.first_share * most
    assert max(status.gaussians for status in told) <= most
    assert result.history[-1]["gaussians"] > budget.first_kept, "growth has room"
    assert budget.limited_from == 20 and budget.limited_changes >= 1
    assert f"thinned from {free:,} to {budget.first_kept:,}" in budget.explain()
    assert "cut short from step 20" in budget.explain()
    assert f"limit of {most:,} met" in describe(told[-1])
    again = train_scene(tiny_log, tmp_path / "scene", config)
    assert again.budget == budget


def read_first_count(log: DrivingLog, folder: Path) -> int:
    return train_scene(
        log, folder, TINY.model_copy(update={"iterations": 1, "unseen_surfaces": False})
    ).budget.first_found
