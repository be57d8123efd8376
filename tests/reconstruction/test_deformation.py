from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.logs import DrivingLog, Trajectory
from recast.reconstruction import TrainingStatus, TrainResult, train_scene
from recast.reconstruction.train import WORK_FOLDER
from recast.reconstruction.views import deforms, read_views
from recast.scene import SceneRasterizer, load_scene
from recast.scene.deformation import (
    Deformation,
    DeformationNetwork,
    encoded,
    encoded_size,
    layer_shapes,
)
from recast.scene.store import DEFORMATION_FILE, read_tensors, write_tensors
from recast.splats import Gaussians
from support.gaussian_clouds import part
from support.tiny_street import TINY, KilledError, contents, same, walking

BANDS, TIME_BANDS, CODE = 3, 2, 4
WALKER = TINY.model_copy(
    update={
        "deformable": True,
        "deformation_layers": 3,
        "deformation_width": 12,
        "deformation_from": 0.3,
        "iterations": 40,
        "evaluate_every": 40,
    }
)
PATH = Trajectory(np.array([0, 1_000_000], np.int64), np.stack([np.eye(4)] * 2))


def network(seed: int, dtype: torch.dtype = torch.float32, hidden: int = 8) -> DeformationNetwork:
    chance = torch.Generator().manual_seed(seed)
    shapes = layer_shapes(hidden, 16, BANDS, TIME_BANDS, CODE)
    layers = tuple(0.3 * torch.randn(*shape, generator=chance, dtype=dtype) for shape in shapes)
    return DeformationNetwork(layers, BANDS, TIME_BANDS)


class Plain(torch.nn.Module):
    """The network of Deformable 3DGS as its paper draws it, layer by layer."""

    def __init__(self, weights: DeformationNetwork) -> None:
        super().__init__()
        self.layers = torch.nn.ModuleList()
        for layer in weights.layers:
            linear = torch.nn.Linear(layer.shape[1] - 1, layer.shape[0], dtype=layer.dtype)
            linear.weight.data, linear.bias.data = layer[:, :-1].clone(), layer[:, -1].clone()
            self.layers.append(linear)

    def forward(self, places: torch.Tensor, share: float, code: torch.Tensor) -> torch.Tensor:
        rows = []
        for place in places:
            inputs = list(place)
            for k in range(BANDS):
                inputs += [*torch.sin(2**k * place), *torch.cos(2**k * place)]
            time = torch.tensor(share, dtype=places.dtype)
            inputs.append(time)
            for k in range(TIME_BANDS):
                inputs += [torch.sin(2**k * time), torch.cos(2**k * time)]
            joined = torch.stack([*inputs, *code])
            hidden = joined
            for number, layer in enumerate(self.layers[:-1]):
                hidden = torch.relu(layer(hidden))
                if number == 4:  # "the input is concatenated to the fifth layer's output"
                    hidden = torch.cat([joined, hidden])
            rows.append(self.layers[-1](hidden))
        return torch.stack(rows)


def test_the_network_is_that_of_deformable_3dgs() -> None:
    weights = network(0, torch.float64)
    assert weights.code_size == CODE
    assert weights.layers[0].shape[1] - 1 - CODE == encoded_size(BANDS, TIME_BANDS)
    places, code = torch.randn(5, 3, dtype=torch.float64), torch.randn(CODE, dtype=torch.float64)
    expected = Plain(weights)(places, 0.3, code)
    torch.testing.assert_close(weights(places, 0.3, code), expected, rtol=1e-12, atol=1e-12)


def test_encoding_without_bands_is_the_value() -> None:
    values = torch.randn(4, 3)
    assert torch.equal(encoded(values, 0), values)


def test_gradients_of_a_deformation_are_those_of_finite_differences() -> None:
    weights = network(1, torch.float64, hidden=3)
    gaussians = part(4, 2)
    gaussians = Gaussians(**{k: v.double() for k, v in vars(gaussians).items()})
    inputs = [layer.clone().requires_grad_() for layer in weights.layers]
    code = torch.randn(CODE, dtype=torch.float64, requires_grad=True)
    quats = gaussians.quats.clone().requires_grad_()

    def shaped(code: torch.Tensor, quats: torch.Tensor, *layers: torch.Tensor) -> torch.Tensor:
        own = Deformation(DeformationNetwork(layers, BANDS, TIME_BANDS), code, 2.0)
        moved = own.at(replace(gaussians, quats=quats), PATH, 400_000)
        return torch.cat([moved.means, moved.quats], dim=1)

    # float64, steps of 1e-6: ReLU is smooth at the values of this seed.
    assert torch.autograd.gradcheck(shaped, (code, quats, *inputs), eps=1e-6, atol=1e-6)


def test_without_outputs_a_deformable_actor_is_rigid() -> None:
    weights = network(3)
    *hidden, last = weights.layers
    still = replace(weights, layers=(*hidden, torch.zeros_like(last)))
    gaussians = part(6, 1)
    for time in (-5, 0, 300_000, 10**9):
        assert same(Deformation(still, torch.randn(CODE), 1.0).at(gaussians, PATH, time), gaussians)


def test_outside_of_its_time_the_shape_is_that_of_the_end() -> None:
    own, gaussians = Deformation(network(4), torch.randn(CODE), 1.0), part(6, 1)
    at = {time: own.at(gaussians, PATH, time) for time in (-(10**9), 0, 10**6, 10**9)}
    assert same(at[-(10**9)], at[0]) and same(at[10**6], at[10**9])
    assert not torch.equal(at[0].means, at[10**6].means)
    for name in ("log_scales", "logit_opacities", "sh"):
        assert torch.equal(getattr(at[0], name), getattr(gaussians, name))


@pytest.fixture(scope="module")
def walked(tiny_log: DrivingLog, tmp_path_factory: pytest.TempPathFactory) -> TrainResult:
    folder: Path = tmp_path_factory.mktemp("walked") / "scene"
    return train_scene(walking(tiny_log), folder, WALKER)


def test_people_that_move_deform_and_cars_do_not(walked: TrainResult, tiny_log: DrivingLog) -> None:
    tracks = walking(tiny_log).tracks
    assert deforms(tracks["0"], WALKER) and not deforms(tracks["1"], WALKER)
    assert not deforms(tiny_log.tracks["0"], WALKER) and not deforms(tracks["0"], TINY)
    actor = walked.scene.actors["0"]
    assert isinstance(actor.deformation, Deformation)
    assert walked.scene.actors["1"].deformation is None
    shapes = [actor.shaped_at(int(time)) for time in actor.trajectory.timestamps_us[[0, -1]]]
    assert all(shape.deformation is None for shape in shapes)
    moved = (shapes[0].gaussians.means - shapes[1].gaussians.means).norm(dim=1)
    assert float(moved.max()) > 1e-4
    middle = int(actor.trajectory.timestamps_us[[0, -1]].sum()) // 2
    assert same(actor.shaped_at(None).gaussians, actor.shaped_at(middle).gaussians)


def test_a_scene_is_drawn_in_the_shape_of_a_time(walked: TrainResult, tiny_log: DrivingLog) -> None:
    scene, view = walked.scene, read_views(tiny_log, TINY)[0]
    poses = scene.actor_poses(view.timestamp_us)
    drawn = SceneRasterizer(scene, "cpu")
    times = [int(time) for time in scene.actors["0"].trajectory.timestamps_us[[0, -1]]]
    images = [
        drawn.render(view.camera, view.camera_from_world, poses, shapes_us=time).rgb
        for time in (*times, times[0], None)
    ]
    assert np.array_equal(images[0], images[2])
    assert not np.array_equal(images[0], images[1])
    assert not np.array_equal(images[0], images[3])
    fixed = replace(scene, actors={k: v.shaped_at(times[1]) for k, v in scene.actors.items()})
    expected = SceneRasterizer(fixed, "cpu").render(view.camera, view.camera_from_world, poses).rgb
    assert np.array_equal(images[1], expected)
    assert same(scene.at(poses, times[1]), fixed.at(poses))


def test_a_killed_run_with_deformable_nodes_ends_in_the_same_bytes(
    walked: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    def kill(status: TrainingStatus) -> None:
        if status.iteration >= 30:
            raise KilledError

    folder = tmp_path / "scene"
    with pytest.raises(KilledError):
        train_scene(walking(tiny_log), folder, WALKER, progress=kill)
    assert (folder / WORK_FOLDER / "checkpoint.safetensors").is_file()
    train_scene(walking(tiny_log), folder, WALKER)
    assert contents(folder) == contents(walked.folder)
    assert DEFORMATION_FILE in contents(folder)


def test_a_deformable_scene_is_read_back_exactly(walked: TrainResult) -> None:
    loaded = load_scene(walked.folder)
    before, after = walked.scene.actors["0"].deformation, loaded.actors["0"].deformation
    assert isinstance(before, Deformation) and isinstance(after, Deformation)
    assert torch.equal(before.code, after.code) and before.reach == after.reach
    pairs = zip(before.network.layers, after.network.layers, strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert (before.network.bands, before.network.time_bands) == (
        after.network.bands,
        after.network.time_bands,
    )


def _without(name: str) -> Callable[[dict, dict], None]:
    return lambda tensors, header: tensors.pop(name)


def _other(name: str, value: torch.Tensor) -> Callable[[dict, dict], None]:
    return lambda tensors, header: tensors.update({name: value})


def _header(**changed: object) -> Callable[[dict, dict], None]:
    return lambda tensors, header: header.update(changed)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_without("layer/1"), r"layer/1: is missing"),
        (_without("code/0"), r"code/0: is missing"),
        (_other("layer/9", torch.zeros(2, 2)), r"layer/9: is not expected"),
        (_other("layer/1", torch.zeros(12, 12)), r"network: layer 1: expected \(12, 13\)"),
        (_other("layer/0", torch.zeros(5000, 3)), "network: a width of 5000"),
        (_other("layer/1", torch.full((12, 13), torch.nan)), "not finite"),
        (_other("code/0", torch.zeros(3)), r"expected \(16,\)"),
        (_other("code/0", torch.zeros(16, dtype=torch.float64)), "another kind"),
        (_other("reach/0", torch.tensor([0.0], dtype=torch.float64)), "is not 0.001 to 1000 m"),
        (_header(version=2), "version: is 2, this recast reads 1"),
        (_header(layers=10**9), "is missing"),
        (_header(bands=-1), "names no layers"),
        (_header(time_bands=99), "bands, at most 16"),
        (_header(actors=[]), "names no actors"),
        (_header(actors=["0", "7"]), "7: is missing"),
    ],
)
def test_a_damaged_deformation_is_one_line(
    walked: TrainResult,
    tmp_path: Path,
    damage: Callable[[dict, dict], None],
    message: str,
) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    for path in walked.folder.iterdir():
        (folder / path.name).symlink_to(path)
    tensors, header = read_tensors(folder / DEFORMATION_FILE)
    tensors = {name: tensor.clone() for name, tensor in tensors.items()}
    damage(tensors, header)
    (folder / DEFORMATION_FILE).unlink()
    write_tensors(folder / DEFORMATION_FILE, tensors, header)
    with pytest.raises(InputError, match=message) as caught:
        load_scene(folder)
    assert "\n" not in str(caught.value)
