"""Which way up a vehicle lies, told from its shape, in all 24 orientations of a file."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.actors import Observation, SplatGenerator, axes_of, make_generator, register
from recast.actors.generate import LEAST_EVIDENCE, postures
from recast.actors.icp import outer_surface
from recast.actors.place import place_asset
from recast.cli.main import main
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.runs.config import RunConfig
from recast.splats import CLASSIC, MIP, Gaussians, LowPass, write_ply
from recast.studies.generation.cells import place_canonical
from recast.synthetic.vehicles import KINDS, sample_vehicle
from recast.trellis import viewer_frame
from recast.trellis.vae import RepresentationConfig, offset_perturbation, raw_to_gaussians
from support import made_up_actors as made_up

SIZES = {
    "sedan": (4.7, 1.85, 1.45),
    "hatchback": (4.1, 1.75, 1.48),
    "suv": (4.6, 1.9, 1.7),
    "pickup": (5.4, 1.93, 1.84),
    "van": (5.5, 2.0, 2.3),
    "bus": (11.5, 2.55, 3.1),
}
TEMPLATES = tuple(f"template {style}" for style in SIZES)
SYNTHETIC = tuple(f"synthetic {kind}" for kind in KINDS)


def orientations() -> list[np.ndarray]:
    """The 24 rotations by quarters of a turn."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            rotation = np.zeros((3, 3))
            rotation[range(3), order] = signs
            if np.linalg.det(rotation) > 0:
                found.append(rotation)
    return found


ORIENTATIONS = orientations()


def points_gaussians(points: np.ndarray) -> Gaussians:
    """Small opaque grey Gaussians."""
    n = len(points)
    return Gaussians(
        torch.as_tensor(points, dtype=torch.float32),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        torch.full((n, 3), float(np.log(0.02))),
        torch.full((n,), 3.0),
        torch.zeros(n, 1, 3),
    )


@lru_cache
def vehicle(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) of its outer surface in the actor frame, thinned, and its size."""
    source, kind = name.split(" ")
    if source == "template":
        size = np.array(SIZES[kind])
        points = outer_surface(made_up.car(size, style=kind)).points
        return points[:: max(1, len(points) // 4000)], size
    rng = np.random.default_rng([13, KINDS.index(kind)])
    model = sample_vehicle(rng, kind)
    corners = model.surface.vertices[model.surface.faces]
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    chosen = rng.choice(len(areas), 4000, p=areas / areas.sum())
    shares = np.sort(rng.random((4000, 2)), axis=1)
    weights = np.column_stack([shares[:, 0], np.diff(shares, axis=1)[:, 0]])
    points = corners[chosen, 0] + np.einsum("nk,nkc->nc", weights, edges[chosen])
    return outer_surface(points_gaussians(points)).points, np.asarray(model.size)


def up_in_file(rotation: np.ndarray) -> str:
    """The file's axis that points up, of a vehicle that was turned by a rotation."""
    axis = int(np.argmax(np.abs(rotation[:, 2])))
    return f"{'+' if rotation[axis, 2] > 0 else '-'}{'xyz'[axis]}"


@pytest.mark.parametrize("name", ["template hatchback", "synthetic pickup"])
def test_up_is_found_in_all_24_orientations(name: str) -> None:
    points, size = vehicle(name)
    for rotation in ORIENTATIONS:
        best, second, *_ = postures(points @ rotation.T, size)
        assert best.up == up_in_file(rotation)
        assert best.fits and best.convincing
        assert best.total - second.total > LEAST_EVIDENCE
        # the convention turns the file's up to z
        np.testing.assert_allclose(best.axes.rotation() @ rotation[:, 2], [0, 0, 1], atol=1e-12)


@given(
    st.sampled_from([*TEMPLATES, *SYNTHETIC]),
    st.sampled_from(range(24)),
    st.floats(-np.pi, np.pi),
    st.floats(1e-3, 1e3),
    st.floats(-5.0, 5.0),
)
@settings(max_examples=25, deadline=None)
def test_any_heading_unit_and_place(
    name: str, index: int, yaw: float, unit: float, shift: float
) -> None:
    """TRELLIS gives any heading, others centimetres, others put the origin at the rear axle."""
    points, size = vehicle(name)
    rotation = ORIENTATIONS[index]
    lying = (points @ se3.rotation_z(yaw).T + [shift, 0.3 * shift, shift]) * unit
    best, second, *_ = postures(lying @ rotation.T, size)
    assert best.up == up_in_file(rotation)
    assert best.fits and best.convincing and best.total - second.total > LEAST_EVIDENCE


@pytest.mark.parametrize("up", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_a_ply_that_lies_on_its_side_is_registered_upright(
    up: str, red_car: Gaussians, observation: Observation, street: DrivingLog, tmp_path: Path
) -> None:
    rotation = next(one for one in ORIENTATIONS if up_in_file(one) == up)
    pose = se3.from_rotation_translation(rotation @ se3.rotation_z(0.4), [0.1, 0.2, -0.3])
    write_ply(tmp_path / "car.ply", red_car.transformed(torch.from_numpy(pose), 0.22))
    asset = SplatGenerator(tmp_path / "car.ply").generate(observation, 0)
    assert "inferred from the shape" in str(asset.details["axes"])
    placed = register(asset, observation, street, street.tracks["7"])
    assert float((placed.gaussians.means - red_car.means).norm(dim=1).mean()) < 0.06
    assert placed.provenance.registration.axes == asset.axes.name


def test_our_viewer_frame_is_minus_y_up(
    red_car: Gaussians, observation: Observation, tmp_path: Path
) -> None:
    write_ply(tmp_path / "viewer.ply", viewer_frame(red_car))
    told = SplatGenerator(tmp_path / "viewer.ply").generate(observation, 0)
    named = SplatGenerator(tmp_path / "viewer.ply", "minus-y-up").generate(observation, 0)
    assert told.axes == named.axes and told.axes.up == "-y" and not told.axes.declares_front


def box_points(size: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (6000, 3))
    points[range(6000), rng.integers(3, size=6000)] = rng.choice([-0.5, 0.5], 6000)
    return points * size


def test_shapes_that_are_refused(
    red_car: Gaussians, observation: Observation, tmp_path: Path
) -> None:
    path = tmp_path / "thing.ply"
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(3000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    for points, message in (
        (ball, r"no orientation fits a box of 4\.40 x 1\.75 x 1\.45 m"),
        (vehicle("template bus")[0], "no orientation fits"),
        (box_points(observation.size), "does not show which way is up"),
        (box_points(np.array([1.0, 1.0, 1e-12])), "on a line or in a plane"),
        (np.zeros((100, 3)), "at one point"),
        (np.outer(np.linspace(0, 1, 100), [1.0, 2.0, 3.0]), "on a line or in a plane"),
    ):
        write_ply(path, points_gaussians(points))
        with pytest.raises(InputError, match=message) as caught:
            SplatGenerator(path).generate(observation, 0)
        assert caught.value.where == str(path) and "\n" not in str(caught.value)
    haze = replace(red_car, logit_opacities=torch.full_like(red_car.logit_opacities, -9.0))
    write_ply(path, haze)
    with pytest.raises(InputError, match="opaque"):
        SplatGenerator(path).generate(observation, 0)


def test_named_axes_ask_nothing_of_the_shape(observation: Observation, tmp_path: Path) -> None:
    write_ply(tmp_path / "box.ply", points_gaussians(box_points(observation.size)))
    asset = SplatGenerator(tmp_path / "box.ply", "z-up").generate(observation, 0)
    assert asset.axes.up == "+z" and "axes" not in asset.details


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.outer(np.linspace(0, 1, 100), [0.0, 0.0, 1.0]), "on a line or in a plane"),
        (box_points(np.array([1.0, 1.0, 1e-12])), "on a line or in a plane"),
        (np.repeat([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], 60, axis=0), "on a line or in a plane"),
        (1e-12 * box_points(np.ones(3)), "log_scales: at the size of a box"),
    ],
)
def test_what_cannot_stand_in_a_box_is_refused(
    points: np.ndarray, message: str, observation: Observation, street: DrivingLog, tmp_path: Path
) -> None:
    """With the axes named, where nothing is told from the shape."""
    write_ply(tmp_path / "thing.ply", points_gaussians(points))
    asset = SplatGenerator(tmp_path / "thing.ply", "z-up").generate(observation, 0)
    for use in (
        lambda: register(asset, observation, street, street.tracks["7"]),
        lambda: place_asset(asset, observation.size, [observation]),
        lambda: place_canonical(asset, observation.size),
    ):
        with pytest.raises(InputError, match=message):
            use()


@pytest.mark.parametrize(
    ("text", "forward", "up", "front"),
    [
        ("z-up", "+x", "+z", False),
        ("minus-y-up", "+x", "-y", False),
        ("minus-x-up", "+y", "-x", False),
        ("x,z", "+x", "+z", True),
        ("-z,-y", "-z", "-y", True),
        ("unit_cube_y_up", "+z", "+y", False),
    ],
)
def test_axes_by_name_and_by_two_axes(text: str, forward: str, up: str, front: bool) -> None:
    axes = axes_of(text)
    assert (axes.forward, axes.up, axes.declares_front) == (forward, up, front)
    np.testing.assert_allclose(np.linalg.det(axes.rotation()), 1.0)


@pytest.mark.parametrize(
    "text", ["", "up", "w-up", "x", "x,x", "x,-x", "x,y,z", "x,q", ",", "auto "]
)
def test_axes_that_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="is not an axis convention"):
        axes_of(text)


def test_axes_of_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ply(tmp_path / "car.ply", points_gaussians(box_points(np.ones(3))))
    make = ["actor", "make", str(tmp_path), "--track", "7", "--out", str(tmp_path / "out")]
    for generator, axes, message in (
        ("template", "y-up", "does not apply to the generator template, whose axes are fixed"),
        (str(tmp_path / "car.ply"), "sideways", "is not an axis convention"),
    ):
        assert main([*make, "--generator", generator, "--axes", axes]) == 2
        told = " ".join(capsys.readouterr().err.split())
        assert f"--axes: {axes}: {message}" in told
    generator = make_generator(str(tmp_path / "car.ply"), "-y,z")
    assert isinstance(generator, SplatGenerator)
    assert generator.axes == axes_of("-y,z") and generator.axes.declares_front
    record = {"track": "7", "motions": ("cut-in-a",), "axes": "y-up"}
    assert RunConfig.model_validate(record).arm("replaced").axes == "y-up"


@pytest.mark.parametrize("low_pass", [CLASSIC, LowPass(0.2, antialiased=True)])
def test_the_filter_of_a_ply_is_the_declared_one(
    low_pass: LowPass, red_car: Gaussians, observation: Observation, tmp_path: Path
) -> None:
    path = tmp_path / "car.ply"
    write_ply(path, red_car, low_pass)
    assert SplatGenerator(path, "x,z").generate(observation, 0).low_pass == low_pass
    assert SplatGenerator(path, "x,z", MIP).generate(observation, 0).low_pass == MIP


def test_the_filter_of_a_ply_that_declares_none(
    red_car: Gaussians, observation: Observation, tmp_path: Path
) -> None:
    """What the published decoder makes is told by its rows; all else is as 3DGS made it."""
    config = RepresentationConfig()
    voxels = torch.from_numpy(np.random.default_rng(0).integers(0, 64, (40, 3))).int()
    raw = 2.0 * torch.randn(40, config.channels, generator=torch.Generator().manual_seed(0))
    decoded = raw_to_gaussians(raw, voxels, offset_perturbation(config), config, 64)
    shuffled = torch.randperm(len(decoded), generator=torch.Generator().manual_seed(0))
    for gaussians, expected in (
        (decoded, MIP),
        (viewer_frame(decoded), MIP),  # as it is exported
        (decoded.select(shuffled), CLASSIC),
        (decoded.select(torch.arange(len(decoded) - 1)), CLASSIC),
        (decoded.transformed(torch.eye(4), 4.5), CLASSIC),  # in metres
        (red_car.transformed(torch.eye(4), 0.2), CLASSIC),
    ):
        write_ply(tmp_path / "car.ply", gaussians)
        found = SplatGenerator(tmp_path / "car.ply", "x,z").generate(observation, 0)
        assert found.low_pass == expected
