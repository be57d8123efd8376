from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from recast.cameras import PinholeCamera
from recast.logs import Track, Trajectory
from recast.reconstruction import SceneConfig
from recast.reconstruction.losses import ActorOpacityTerm, Drawing, actor_opacity, sharp_shape
from recast.reconstruction.step import TrainableScene
from recast.reconstruction.tables import TrackPoses
from recast.reconstruction.views import DepthSamples, TrainingView, make_level
from recast.splats import rasterize
from support.gaussian_clouds import part


def test_only_needles_cost() -> None:
    log_scales = torch.log(torch.tensor([[1.0, 2.0, 9.0], [0.1, 1.0, 3.0]])).requires_grad_()
    loss = sharp_shape(log_scales)
    assert loss.item() == pytest.approx((30 - 10) / 2, rel=1e-5)
    loss.backward()
    assert log_scales.grad is not None
    assert (log_scales.grad[0] == 0).all()
    assert log_scales.grad[1, 0] < 0 < log_scales.grad[1, 2]


def view(index: int, held_out: bool = False) -> TrainingView:
    camera = PinholeCamera(48, 32, 40.0, 40.0, 24.0, 16.0)
    image = np.zeros((32, 48, 3), np.uint8)
    return TrainingView("front", index, index * 100_000, camera, np.eye(4), image, None, held_out)


def drive(positions: np.ndarray) -> Track:
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 3] = positions
    times = np.arange(len(positions), dtype=np.int64) * 100_000
    return Track("7", "car", np.array([1.0, 1.0, 1.0]), Trajectory(times, poses))


def test_even_motion_costs_nothing_also_around_held_out_labels() -> None:
    track = drive(np.arange(12)[:, None] * [1.0, 0.2, 0.0])
    views = [view(i, held_out=i == 4) for i in range(12)]
    poses = TrackPoses({"7": track}, views)
    assert poses.unevenness().item() == pytest.approx(0, abs=1e-6)


def test_a_bent_label_costs_what_the_formula_says_and_is_pulled_back() -> None:
    positions = np.arange(3)[:, None] * [1.0, 0.0, 0.0]
    positions[1, 1] = 0.3
    poses = TrackPoses({"7": drive(positions)}, [view(i) for i in range(3)])
    loss = poses.unevenness()
    assert loss.item() == pytest.approx(0.6)  # |0 + 0 - 2 * 0.3|
    loss.backward()
    assert poses.table.value.grad is not None
    assert poses.table.value.grad[:, 1].tolist() == pytest.approx([-1, 2, -1])


def test_no_tracks_and_short_tracks_cost_nothing() -> None:
    assert TrackPoses({}, [view(0)]).unevenness().item() == 0
    short = TrackPoses({"7": drive(np.zeros((2, 3)))}, [view(0), view(1)])
    assert short.unevenness().item() == 0
    unseen = TrackPoses({"7": drive(np.zeros((3, 3)))}, [view(0, held_out=True)])
    assert unseen.unevenness().item() == 0


def test_actor_opacity_by_hand() -> None:
    alpha = torch.tensor([[0.5, 0.5], [0.9, 0.0]])
    inside = torch.tensor([[True, False], [True, False]])
    entropy = 0.9 * -math.log(0.9) + 0.1 * -math.log(0.1)
    expected = (math.log(2) + math.log(2) + entropy) / 4
    assert actor_opacity(alpha, inside).item() == pytest.approx(expected, rel=1e-4)


def alone(model: TrainableScene, placed: dict[str, torch.Tensor]) -> tuple[Drawing, torch.Tensor]:
    """A drawing of actors at these poses, and what it costs that they are not opaque."""
    samples = DepthSamples(np.zeros(0, np.float32), np.zeros((0, 2), np.float32))
    level = make_level(view(0), np.zeros((32, 48), bool), None, samples).unpacked()
    drawn, size = model.draw(placed), (level.camera.width, level.camera.height)
    result = rasterize(drawn.gaussians, torch.eye(4), level.K, *size)
    drawing = Drawing(
        iteration=0,
        grows=False,
        image=result.rgb,
        result=result,
        drawn=drawn,
        camera_from_world=torch.eye(4),
        boxes=[(np.ones(3), at) for at in placed.values()],
        exposure_change=None,
        tracks=TrackPoses({}, [view(0)]),
    )
    return drawing, ActorOpacityTerm(SceneConfig()).value(drawing, level)


def test_haze_beside_the_box_is_taken_away() -> None:
    haze, far = part(1, 0), part(1, 1)
    haze.means[:] = torch.tensor([1.2, 0.0, 0.0])  # in the actor's frame, outside its box
    far.means[:] = torch.tensor([0.0, 0.0, 9.0])
    at = torch.eye(4)
    at[2, 3] = 5.0
    drawing, loss = alone(TrainableScene(far, {"7": haze}), {"7": at})
    loss.backward()
    gradient = drawing.drawn.gaussians.logit_opacities.grad
    assert gradient is not None and gradient[1] > 0 and gradient[0] == 0


def test_without_actors_there_is_nothing_to_render() -> None:
    _, loss = alone(TrainableScene(part(3, 0), {}), {})
    assert loss.item() == 0


def test_actors_alone_count_only_after_densification() -> None:
    drawing, _ = alone(TrainableScene(part(3, 0), {}), {})
    term = ActorOpacityTerm(SceneConfig())
    assert term.applies(drawing) and not term.applies(replace(drawing, grows=True))
