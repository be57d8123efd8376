"""Reading OBJ files and their material libraries."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from recast.actors.mesh_obj import files_of_obj, read_obj
from recast.core.errors import InputError
from recast.geometry.colour import srgb_to_linear
from support.mesh_files import box, picture

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


@pytest.mark.parametrize(
    ("library", "alphas"),
    [
        ("newmtl m\nTr 1\nnewmtl n\nTr 1.0\n", [1, 1]),  # MeshLab: nothing would be left
        ("newmtl m\nTr 1\nnewmtl n\nTr 0.3\n", [1, 0.3]),  # its glass
        ("newmtl m\nd 1\nTr 1\nnewmtl n\nTr 1\nd 1\n", [1, 1]),  # d wins, before and behind
        ("newmtl m\nTr 0\nnewmtl n\nTr 1\n", [1, 0]),  # something is opaque: as the format says
        ("newmtl m\nTr 0.2\nnewmtl n\nTr 0.7\n", [0.8, 0.3]),
        ("newmtl m\nKd 1 1 1\nnewmtl n\nTr 1\n", [1, 0]),
        ("newmtl m\nTr 1\n", [0, None]),  # the other part is grey, and opaque
        ("newmtl m\nTr 1\nnewmtl n\nTr 1\nnewmtl unused\nTr 0\n", [1, 1]),
    ],
)
def test_tr_is_opacity_where_nothing_would_be_seen(
    tmp_path: Path, library: str, alphas: list[float | None]
) -> None:
    text = f"mtllib a.mtl\n{SQUARE}usemtl m\nf 1 2 3\nusemtl n\nf 1 3 4\n"
    parts = read_obj(write(tmp_path, text, library))
    for part, alpha in zip(parts, alphas, strict=True):
        assert part.material.factor[3] == pytest.approx(1 if alpha is None else alpha)
        assert part.material.alpha == ("OPAQUE" if alpha in (1, None) else "BLEND")


@pytest.mark.parametrize(
    ("numbers", "rgba"),
    [
        ("255 0 51", [1, 0, 0.2, 1]),
        ("0.9 0 0.2 0.5", [0.9, 0, 0.2, 0.5]),
        ("0.5 0 0.2 1", [0.5, 0, 0.2, 1]),
        ("1 0.5 0 0.2", [0.5, 0, 0.2, 1]),  # a weight and three colours
        ("1 1 0 0.2 0.5", [1, 0, 0.2, 0.5]),
        ("1.0 255 0 51 255", [1, 0, 0.2, 1]),
        ("255 0 51 0.5", [1, 0, 0.2, 0.5]),
        ("65535 0 13107", [1, 0, 0.2, 1]),
    ],
)
def test_numbers_behind_the_coordinates_are_colours(
    tmp_path: Path, numbers: str, rgba: list[float]
) -> None:
    other = numbers.replace("0.2", "0.25")  # so that only weights and full alphas are constant
    lines = f"v 0 0 0 {numbers}\nv 1 0 0 {other}\nv 1 1 0 {numbers}\n"
    (part,) = read_obj(write(tmp_path, lines + "f 1 2 3\n"))
    assert part.colours is not None
    expected = np.append(srgb_to_linear(np.array(rgba[:3])), rgba[3])
    np.testing.assert_allclose(part.colours[0, 0], expected, atol=1e-9)
    assert part.material.alpha == ("OPAQUE" if rgba[3] == 1 else "BLEND")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_byte_order_mark_is_not_a_word(tmp_path: Path, encoding: str) -> None:
    path = write(tmp_path, "")
    path.write_bytes(f"v 5 0 0\n{SQUARE}f 1 3 4\n".encode(encoding))
    (tmp_path / "a.mtl").write_bytes("newmtl m\nKd 1 0 0\n".encode(encoding))
    (part,) = read_obj(path)
    assert part.corners[0, 0].tolist() == [5, 0, 0]
    path.write_bytes(f"mtllib a.mtl\n{SQUARE}usemtl m\nf 1 2 3\n".encode(encoding))
    (red,) = read_obj(path)
    np.testing.assert_array_equal(red.material.factor, [1, 0, 0, 1])


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
@pytest.mark.parametrize("on_disk", ["utf-8", "latin-1"])
def test_names_that_are_not_ascii(tmp_path: Path, encoding: str, on_disk: str) -> None:
    """Mesh in UTF-8, library in either encoding, and the picture's name in either."""
    (tmp_path / os.fsdecode("Stra\xdfe.png".encode(on_disk))).write_bytes(picture(RED))
    path = write(tmp_path, "")
    path.write_text(f"mtllib a b.mtl c.mtl\n{SQUARE}usemtl T\xfcr\nf 1 2 3\n", "utf-8")
    (tmp_path / "a b.mtl").write_bytes('newmtl T\xfcr\nmap_Kd "Stra\xdfe.png"\n'.encode(encoding))
    (tmp_path / "c.mtl").write_text("newmtl other\n")
    (part,) = read_obj(path)
    assert part.material.texture is not None
    assert len(files_of_obj(path)) == 3


def test_options_of_a_texture(tmp_path: Path) -> None:
    """Scale and offset count upwards from the lower left corner, before rows are turned round."""
    (tmp_path / "2 cars.png").write_bytes(picture(RED))
    library = "newmtl m\nmap_Kd -s 2 3 -o 0.5 0.25 0 -clamp on -mm 0 1 2 cars.png\n"
    path = write(tmp_path, f"mtllib a.mtl\n{SQUARE}usemtl m\nf 1/1 2/2 3/3\n", library)
    (part,) = read_obj(path)
    expected = np.array([[0, 0], [1, 0], [1, 1]]) * [2, 3] + [0.5, 0.25]
    np.testing.assert_allclose(part.uv, [expected * [1, -1] + [0, 1]])
    assert part.material.wrap == ("CLAMP", "CLAMP")


def test_masks_and_emission(tmp_path: Path) -> None:
    mask = np.zeros((2, 2, 3), np.uint8)
    mask[:, 1] = 255
    (tmp_path / "mask.png").write_bytes(picture(mask))
    (tmp_path / "red.png").write_bytes(picture(RED))
    library = "newmtl m\nKd 0 0 0\nmap_d mask.png\nKe 1 0.5 0\nmap_Ke red.png\n"
    library += "newmtl n\nmap_Kd red.png\nmap_d mask.png\nKe 0 0 0\n"
    text = f"mtllib a.mtl\n{SQUARE}usemtl m\nf 1/1 2/2 3/3\nusemtl n\nf 1/1 2/2 3/3\n"
    masked, both = read_obj(write(tmp_path, text, library))
    assert masked.material.texture is not None and both.material.texture is not None
    assert masked.material.alpha == both.material.alpha == "BLEND"
    np.testing.assert_array_equal(masked.material.texture[0, :, 3], [0, 255])
    np.testing.assert_array_equal(masked.material.factor, [0, 0, 0, 1])
    np.testing.assert_array_equal(both.material.texture[0, :, 3], [0, 0, 255, 255])
    assert masked.glow is not None and masked.glow.texture is not None
    np.testing.assert_allclose(masked.glow.factor, srgb_to_linear(np.array([1, 0.5, 0])))
    np.testing.assert_array_equal(masked.glow.uv, masked.uv)
    assert both.glow is None


@pytest.mark.parametrize("turned", [False, True])
def test_concave_polygons_keep_their_outline(tmp_path: Path, turned: bool) -> None:
    """An arrowhead of area 2, whose fan from its first corner would cover more."""
    corners = [(2, 0, 0), (0, 2, 0), (1, 0, 0), (0, -2, 0)]
    lines = "".join(f"v {x} {y} {z}\n" for x, y, z in corners[:: -1 if turned else 1])
    (part,) = read_obj(write(tmp_path, lines + "f 2 3 4 1\nf 1 2 3\n"))
    areas = np.linalg.norm(
        np.cross(part.corners[:, 1] - part.corners[:, 0], part.corners[:, 2] - part.corners[:, 0]),
        axis=1,
    )
    assert len(part) == 3
    assert areas[1:].sum() / 2 == pytest.approx(2.0) or areas[:2].sum() / 2 == pytest.approx(2.0)


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
        ("mtllib a.mtl\n" + SQUARE + "f 1 2 3\n", "newmtl m\nmap_Kd a.mtl", "cannot be decoded"),
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
