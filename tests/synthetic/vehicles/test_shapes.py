"""Other shapes, and a user's own mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.synthetic.vehicles import SHAPES, read_mesh, sample_shape

trimesh = pytest.importorskip("trimesh")


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_are_closed_centred_and_differ(name):
    models = [sample_shape(np.random.default_rng(seed), name) for seed in range(3)]
    for model in models:
        model.surface.validate()
        assert model.kind == f"shape-{name}"
        assert model.category == "misc"
        mesh = trimesh.Trimesh(model.surface.vertices, model.surface.faces, process=False)
        assert mesh.is_watertight
        assert all(part.volume > 0 for part in mesh.split(only_watertight=False))
        np.testing.assert_allclose(model.surface.bounds()[1], model.size / 2, atol=1e-9)
    assert not np.allclose(models[0].size, models[1].size)


def test_shape_draws_are_deterministic_and_names_checked():
    a, b = (sample_shape(np.random.default_rng(5)) for _ in range(2))
    assert a.surface.vertices.tobytes() == b.surface.vertices.tobytes()
    with pytest.raises(InputError, match="chair"):
        sample_shape(np.random.default_rng(0), "teapot")


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply", "stl"])
def test_reads_a_closed_mesh_with_its_axes(tmp_path, suffix):
    # y up, z forward, as glTF has it.
    path = tmp_path / f"car.{suffix}"
    box = trimesh.creation.box((1.8, 1.5, 4.0))
    box.vertices[box.vertices[:, 2] > 0, 1] *= 0.5
    box.export(path)
    model = read_mesh(path, "mine", up="y", forward="z", length=4.4)
    np.testing.assert_allclose(model.size, np.array([4.0, 1.8, 1.5]) * 1.1, rtol=1e-5)
    assert model.kind == "mine"
    mesh = trimesh.Trimesh(model.surface.vertices, model.surface.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0
    front = model.surface.vertices[:, 0] > 0
    assert np.abs(model.surface.vertices[front, 2]).max() < 0.5


def test_a_mesh_that_is_inside_out_is_turned(tmp_path):
    path = tmp_path / "car.stl"
    box = trimesh.creation.box((4.0, 1.8, 1.5))
    box.invert()
    box.export(path)
    surface = read_mesh(path).surface
    assert trimesh.Trimesh(surface.vertices, surface.faces, process=False).volume > 0


def test_face_colours_become_linear_rgb(tmp_path):
    path = tmp_path / "car.ply"
    box = trimesh.creation.box((4.0, 1.8, 1.5))
    box.visual.face_colors = [188, 0, 0, 255]
    box.export(path)
    colours = read_mesh(path).surface.colours
    np.testing.assert_allclose(colours, np.tile([0.503, 0, 0], (12, 1)), atol=0.01)


@pytest.mark.parametrize(
    ("name", "content", "field"),
    [
        ("missing.stl", None, "mesh"),
        ("empty.stl", b"", "mesh"),
        ("empty.obj", b"", "mesh"),
        ("garbage.glb", b"\x00\x01garbage" * 40, "mesh"),
        ("garbage.ply", b"no ply at all\n" * 5, "mesh"),
        ("garbage.obj", b"f 1 2 3\nf 9 9 9\n", "mesh"),
        ("car.pkl", b"cos\nsystem\n", "format"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\n", "mesh"),
    ],
)
def test_bad_files_are_one_line(tmp_path, name, content, field):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_mesh(path)
    assert error.value.field == field
    assert "\n" not in str(error.value)


def test_open_mesh_and_impossible_sizes_are_refused(tmp_path):
    box = trimesh.creation.box((4.0, 1.8, 1.5))
    box.export(tmp_path / "car.stl")
    opened = trimesh.Trimesh(box.vertices, box.faces[1:], process=False)
    opened.export(tmp_path / "open.stl")
    with pytest.raises(InputError, match="watertight"):
        read_mesh(tmp_path / "open.stl")
    for length in (0.1, 400.0, -4.0, float("nan")):
        with pytest.raises(InputError, match="impossible"):
            read_mesh(tmp_path / "car.stl", length=length)
    with pytest.raises(InputError, match="axis of forward"):
        read_mesh(tmp_path / "car.stl", up="x", forward="-x")
    with pytest.raises(InputError, match="not an axis"):
        read_mesh(tmp_path / "car.stl", up="w")
    with pytest.raises(InputError, match="material"):
        read_mesh(tmp_path / "car.stl", material="cheese")


@pytest.mark.parametrize(
    ("vertices", "faces", "problem"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "3 0 1 7", "faces: names vertex 7 of 3"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "3 0 1 -1", "faces|cannot be read"),
        ([[0, 0, 0], [1, 0, 0], [0, 1e300, 0]], "3 0 1 2", "vertices: are not all within"),
        ([[0, 0, 0], [1, 0, 0], [0, 1e18, 0]], "3 0 1 2", "vertices: are not all within"),
        ([[0, 0, 0], [1, 0, 0], [0, "nan", 0]], "3 0 1 2", "vertices: are not all within"),
    ],
)
def test_meshes_with_impossible_numbers(
    tmp_path: Path, vertices: list[list[object]], faces: str, problem: str
) -> None:
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty double x\n"
        "property double y\nproperty double z\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = [" ".join(str(value) for value in row) for row in vertices]
    (tmp_path / "car.ply").write_text(header + "\n".join([*rows, faces]) + "\n")
    with pytest.raises(InputError, match=problem):
        read_mesh(tmp_path / "car.ply")
