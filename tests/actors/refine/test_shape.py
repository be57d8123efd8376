from __future__ import annotations

import numpy as np
import torch

from recast.actors.refine.descent import Bend, FreeGaussians, PoseOffsets, split, split_rows
from recast.splats import Gaussians
from recast.splats.gaussians import quat_to_matrix
from support import made_up_actors as made_up


def points(count: int = 200) -> torch.Tensor:
    chance = torch.Generator().manual_seed(0)
    half = torch.from_numpy(made_up.SIZE / 2).float()
    return (2 * torch.rand(count, 3, generator=chance) - 1) * half


def test_a_bend_begins_as_no_change(red_car: Gaussians) -> None:
    bend = Bend(made_up.SIZE)
    with torch.no_grad():
        same = bend(red_car)
    for name in ("means", "log_scales", "logit_opacities", "sh"):
        torch.testing.assert_close(getattr(same, name), getattr(red_car, name))
    torch.testing.assert_close(quat_to_matrix(same.quats), quat_to_matrix(red_car.quats))


def test_both_sides_bend_alike() -> None:
    bend = Bend(made_up.SIZE)
    with torch.no_grad():
        bend.offsets.copy_(torch.randn(bend.offsets.shape, generator=torch.Generator()))
    left = points()
    flip = torch.tensor([1.0, -1.0, 1.0])
    torch.testing.assert_close(bend.field(left * flip), bend.field(left) * flip)


def test_gaussians_turn_as_their_centres_do(red_car: Gaussians) -> None:
    bend = Bend(made_up.SIZE)
    with torch.no_grad():
        bend.turn.fill_(0.3)
        bend.move.copy_(torch.tensor([0.1, -0.2, 0.05]))
        moved = bend(red_car)
    c, s = np.cos(0.3), np.sin(0.3)
    turn = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float32)
    torch.testing.assert_close(moved.means, red_car.means @ turn.T + bend.move, atol=1e-5, rtol=0)
    torch.testing.assert_close(
        quat_to_matrix(moved.quats), turn @ quat_to_matrix(red_car.quats), atol=1e-5, rtol=0
    )


def test_poses_have_no_common_offset() -> None:
    times = np.arange(12, dtype=np.int64) * 100_000
    poses = PoseOffsets(times)
    with torch.no_grad():
        poses.values.copy_(torch.randn(poses.values.shape, generator=torch.Generator()) + 3)
        shifts = torch.stack([poses.at(int(time))[:3, 3] for time in times])
    torch.testing.assert_close(shifts.mean(dim=0), torch.zeros(3), atol=1e-5, rtol=0)
    assert float(shifts.abs().max()) > 0.1


def test_one_image_alone_moves_no_pose() -> None:
    poses = PoseOffsets(np.array([5], np.int64))
    with torch.no_grad():
        poses.values.fill_(1.0)
    torch.testing.assert_close(poses.at(5), torch.eye(4))


def test_a_split_keeps_place_and_almost_the_spread(red_car: Gaussians) -> None:
    few = red_car.select(torch.arange(50))
    few = Gaussians(
        few.means, few.quats, few.log_scales + 1.5, few.logit_opacities, few.sh
    )  # none below the finest
    chosen = torch.arange(50) < 20
    rows = split_rows(few, chosen)
    assert [len(part) for part in rows] == [30, 20, 20]
    finer = split(few, *rows)
    assert len(finer) == 70
    first, second = finer.means[30:50], finer.means[50:]
    torch.testing.assert_close((first + second) / 2, few.means[:20], atol=1e-6, rtol=0)
    # Variance along the longest axis: that of a half, and that of the halves' centres.
    apart = (first - second).norm(dim=1) / 2
    sigma = few.log_scales[:20].amax(dim=1).exp()
    variance = (0.65 * sigma).square() + apart.square()
    torch.testing.assert_close(variance.sqrt() / sigma, torch.full((20,), 0.885), atol=1e-3, rtol=0)


def test_what_is_not_free_does_not_change(red_car: Gaussians) -> None:
    free = FreeGaussians(red_car, torch.ones(10))
    with torch.no_grad():
        for change in free.changes.values():
            change.fill_(0.01)
        now = free()
    moved = (now.means - red_car.means).abs().amax(dim=1)
    assert bool((moved[:10] > 0.009).all()) and not bool(moved[10:].any())
