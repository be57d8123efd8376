"""Reading OBJ files and their material libraries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from actors.mesh.made import box, picture
from recast.actors.mesh.obj import files_of_obj, read_obj
from recast.core.errors import InputError
from recast.geometry.colour import srgb_to_linear

RED = np.full((4, 4, 3), [200, 10, 10], np.uint8)
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def write(folder: Path, text: str, library: str | None = None) -> Path:
    (folder / "a.obj").write_text(text)
    if library is not None:
        (folder / "a.mtl").write_text(library)
    return folder / "a.obj"


def test_triangles_are_those_of_trimesh(tmp_path: Path) -> None:
    corners, faces = box([0, 0, 0], [4, 2, 1])
    trimesh.Trimesh(corners, faces, process=False).export(tmp_path / "a.obj")
    (part,) = read_obj(tmp_path / "a.obj")
    np.testing.assert_allclose(part.corners, corners[faces], atol=1e-6)


@pytest.mark.parametrize("face", ["f 1/1 2/2 3/3 4/4", "f -4/-4/7 -3/-3/7 -2/-2/7 -1/-1/7"])
def test_polygons_and_relative_indices(tmp_path: Path, face: str) -> None:
    (tmp_path / "red.png").write_bytes(picture(RED))
    more = "v 9 9 9\nvt 9 9\n"  # relative indices count from the face's own line
    path = write(
        tmp_path,
        f"# made by hand\nmtllib a.mtl\nusemtl m\n{SQUARE}{face}\n{more}",
        "newmtl m\nmap_Kd red.png\n",
    )
    (part,) = read_obj(path)
    fan = [[0, 1, 2], [0, 2, 3]]
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(part.corners, square[fan])
    np.testing.assert_array_equal(part.uv, (square[:, :2] * [1, -1] + [0, 1])[fan])


def test_a_line_may_go_on_in_the_next(tmp_path: Path) -> None:
    (part,) = read_obj(write(tmp_path, SQUARE + "f 1 2 \\\n3\r\n"))
    assert len(part) == 1


@pytest.mark.parametrize(
    ("library", "rgba", "alpha"),
    [
        ("newmtl m\nKd 0.5 0.25 1\n", [0.5, 0.25, 1, 1], "OPAQUE"),
        ("newmtl other\nKd 1 1 1\nnewmtl m\nKd 0.5 0.25 1\nd 0.3\n", [0.5, 0.25, 1, 0.3], "BLEND"),
        ("newmtl m\nTr 0.7\nKd 0.5 0.25 1\n", [0.5, 0.25, 1, 0.3], "BLEND"),
        (
            "newmtl m\nmap_Kd -s 1 1 1 -clamp on my red.png\nKd 0 0 0\nd 0.4\n",
            [1, 1, 1, 0.4],
            "BLEND",
        ),
        ("newmtl m\nmap_Kd sub\\red.png\n", [1, 1, 1, 1], "OPAQUE"),
    ],
)
def test_materials(tmp_path: Path, library: str, rgba: list[float], alpha: str) -> None:
    (tmp_path / "sub").mkdir()
    for name in ("my red.png", "sub/red.png"):
        (tmp_path / name).write_bytes(picture(RED))
    path = write(tmp_path, f"mtllib a.mtl\n{SQUARE}usemtl m\nf 1/1 2/2 3/3\n", library)
    (part,) = read_obj(path)
    expected = np.append(srgb_to_linear(np.array(rgba[:3])), rgba[3])
    np.testing.assert_allclose(part.material.factor, expected, atol=1e-12)
    assert part.material.alpha == alpha
    assert (part.material.texture is not None) == ("map_Kd" in library)
    assert (part.uv is not None) == ("map_Kd" in library)


def test_without_materials_it_is_grey_or_of_its_vertex_colours(tmp_path: Path) -> None:
    (grey,) = read_obj(write(tmp_path, SQUARE + "usemtl unknown\nf 1 2 3\n"))
    np.testing.assert_array_equal(grey.material.factor, [0.5, 0.5, 0.5, 1])
    coloured = "v 0 0 0 1 0 0.5\nv 1 0 0 1 0 0.5\nv 1 1 0 1 0 0.5\nf 1 2 3\n"
    (red,) = read_obj(write(tmp_path, coloured))
    assert red.colours is not None
    np.testing.assert_array_equal(red.material.factor, np.ones(4))
    np.testing.assert_allclose(red.colours[0, 0], [1, 0, srgb_to_linear(np.array(0.5)), 1])


def test_every_file_that_counts_is_named(tmp_path: Path) -> None:
    (tmp_path / "red.png").write_bytes(picture(RED))
    library = "newmtl m\nmap_Kd red.png\nnewmtl n\nKd 1 1 1\nmap_Kd red.png\n"
    path = write(tmp_path, f"mtllib a.mtl\n{SQUARE}f 1 2 3\n", library)
    assert files_of_obj(path) == [tmp_path / "a.mtl", tmp_path / "red.png"]


@pytest.mark.parametrize(
    ("text", "library", "named"),
    [
        ("", None, "no triangles"),
        (SQUARE, None, "no triangles"),
        (SQUARE + "f 1 2\n", None, "no triangles"),
        (SQUARE + "f 1 2 5\n", None, "line 9"),
        (SQUARE + "f 1 2 0\n", None, "line 9"),
        (SQUARE + "f 1 2 -5\n", None, "line 9"),
        (SQUARE + "f 1/9 2 3\n", None, "line 9"),
        (SQUARE + f"f 1 2 {'9' * 40}\n", None, "line 9"),
        (SQUARE + "f a b c\n", None, "line 9"),
        ("v 0 0\n" + SQUARE + "f 1 2 3\n", None, "line 1"),
        ("v 0 0 nan\n" + SQUARE + "f 1 2 3\n", None, "vertices"),
        ("v 0 0 1e300\n" + SQUARE + "f 1 2 3\n", None, "vertices"),
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", None, "a.mtl: file: is missing"),
        ("mtllib ../a.mtl\n" + SQUARE + "f 1 2 3\n", None, "mtllib"),
        ("mtllib /etc/passwd\n" + SQUARE + "f 1 2 3\n", None, "mtllib"),
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", "newmtl m\nmap_Kd no.png", "no.png"),
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", "newmtl m\nmap_Kd ../no.png", "line 2"),
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", "newmtl m\nmap_Kd C:\\no.png", "line 2"),
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", "newmtl m\nmap_Kd a.mtl", "no whole picture"),
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", "newmtl m\nmap_Kd", "line 2"),
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", "newmtl m\nKd 1 x 1", "line 2"),
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", "newmtl m\nd nan", "line 2"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, library: str | None, named: str) -> None:
    with pytest.raises(InputError, match=named) as error:
        read_obj(write(tmp_path, text, library))
    assert "\n" not in str(error.value)


def test_a_polygon_of_too_many_triangles(tmp_path: Path) -> None:
    text = SQUARE + "f" + " 1" * 3_000_003
    with pytest.raises(InputError, match="3000001 triangles"):
        read_obj(write(tmp_path, text))
