"""Which Gaussians a page gets, against known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from recast.viewer.splat_nodes import NEAREST, importance, most_important, path_distances
from support.gaussian_clouds import grey_gaussians


def test_importance_is_opacity_times_area_over_squared_distance() -> None:
    gaussians = replace(
        grey_gaussians(np.zeros((2, 3)), 1.0),
        log_scales=torch.log(torch.tensor([[0.1, 2.0, 3.0], [1.0, 1.0, 1.0]])),
        logit_opacities=torch.tensor([0.0, 100.0]),
    )
    found = importance(gaussians, np.array([10.0, 5.0]))
    assert found == pytest.approx([0.5 * 6.0 / 100, 1.0 / 25])


def test_what_is_on_the_path_does_not_outweigh_everything() -> None:
    gaussians = grey_gaussians(np.zeros((2, 3)), 1.0)
    near, at_limit = importance(gaussians, np.array([0.0, NEAREST]))
    assert near == at_limit


def test_distances_are_to_the_nearest_point_of_the_path() -> None:
    gaussians = grey_gaussians(np.array([[0.0, 3.0, 4.0], [10.0, 1.0, 0.0]]), 1.0)
    path = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    assert path_distances(gaussians, path).tolist() == [5.0, 1.0]
    assert path_distances(gaussians, np.zeros((0, 3))).tolist() == [NEAREST, NEAREST]


def test_the_most_important_of_all_parts_are_kept_in_order() -> None:
    rows = most_important([np.array([1.0, 9.0, 5.0]), np.array([7.0, 2.0])], 3)
    assert [row.tolist() for row in rows] == [[1, 2], [0]]


def test_nothing_is_left_out_where_there_is_room() -> None:
    rows = most_important([np.array([1.0]), np.array([2.0, 3.0])], 3)
    assert [row.tolist() for row in rows] == [[0], [0, 1]]


def test_of_equal_ones_the_first_stays_and_none_may_stay() -> None:
    assert most_important([np.ones(4)], 2)[0].tolist() == [0, 1]
    assert most_important([np.ones(4)], 0)[0].tolist() == []
