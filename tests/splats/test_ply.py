"""PLY files: bit-exact round trip, golden bytes, and every way a file can be wrong."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.splats import MIP, Gaussians, read_ply, write_ply
from recast.splats.gaussians import C0
from recast.splats.ply import read_low_pass
from support.splat_scenes import random_gaussians


def equal(a: Gaussians, b: Gaussians) -> bool:
    return all(torch.equal(x, y) for x, y in zip(vars(a).values(), vars(b).values(), strict=True))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip_is_bit_exact(tmp_path: Path, degree: int) -> None:
    gaussians = random_gaussians("normal", count=17, degree=degree)
    write_ply(tmp_path / "a.ply", gaussians)
    again = read_ply(tmp_path / "a.ply")
    assert equal(again, gaussians)
    write_ply(tmp_path / "b.ply", again)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_golden_bytes(tmp_path: Path) -> None:
    """One Gaussian of degree 1, byte by byte as the 3DGS release lays it out."""
    gaussians = Gaussians(
        means=torch.tensor([[1.0, 2, 3]]),
        quats=torch.tensor([[4.0, 5, 6, 7]]),
        log_scales=torch.tensor([[8.0, 9, 10]]),
        logit_opacities=torch.tensor([11.0]),
        # harmonic by harmonic, red green blue
        sh=torch.tensor([[[12.0, 13, 14], [21, 22, 23], [31, 32, 33], [41, 42, 43]]]),
    )
    write_ply(tmp_path / "one.ply", gaussians)
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(9)]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n"
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    values = [
        1,
        2,
        3,
        0,
        0,
        0,
        12,
        13,
        14,
        21,
        31,
        41,
        22,
        32,
        42,
        23,
        33,
        43,
        11,
        8,
        9,
        10,
        4,
        5,
        6,
        7,
    ]
    assert (tmp_path / "one.ply").read_bytes() == header.encode() + struct.pack("<26f", *values)


def columns_of(gaussians: Gaussians) -> dict[str, np.ndarray]:
    rest = gaussians.sh[:, 1:].transpose(1, 2).flatten(1)
    parts = {
        **{name: gaussians.means[:, i] for i, name in enumerate("xyz")},
        **{f"f_dc_{i}": gaussians.sh[:, 0, i] for i in range(3)},
        **{f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])},
        "opacity": gaussians.logit_opacities,
        **{f"scale_{i}": gaussians.log_scales[:, i] for i in range(3)},
        **{f"rot_{i}": gaussians.quats[:, i] for i in range(4)},
    }
    return {name: value.numpy() for name, value in parts.items()}


def foreign_file(
    path: Path, columns: dict[str, np.ndarray], form: str = "binary_little_endian"
) -> Path:
    """A PLY as another program might write it."""
    count = len(next(iter(columns.values())))
    header = f"ply\nformat {form} 1.0\ncomment by hand\nelement vertex {count}\n"
    kinds = {"f4": "float", "f8": "double", "u1": "uchar"}
    order = ">" if "big" in form else "<"
    types = [(name, order + value.dtype.str[1:]) for name, value in columns.items()]
    header += "".join(f"property {kinds[kind[1:]]} {name}\n" for name, kind in types)
    header += "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
    table = np.zeros(count, types)
    for name, value in columns.items():
        table[name] = value
    if form == "ascii":
        body = "\n".join(" ".join(repr(float(v)) for v in row) for row in table).encode()
    else:
        body = table.tobytes()
    path.write_bytes(header.encode() + body)
    return path


@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_any_order_type_and_extra_properties(tmp_path: Path, form: str) -> None:
    gaussians = random_gaussians("normal", count=9, degree=1)
    columns = columns_of(gaussians)
    mixed = {"red": np.zeros(9, np.uint8), **dict(reversed(columns.items()))}
    mixed["x"] = mixed["x"].astype(np.float64)
    assert equal(read_ply(foreign_file(tmp_path / "foreign.ply", mixed, form)), gaussians)


def test_zero_gaussians(tmp_path: Path) -> None:
    none = random_gaussians("normal", count=1).select(torch.zeros(0, dtype=torch.int64))
    write_ply(tmp_path / "none.ply", none)
    assert equal(read_ply(tmp_path / "none.ply"), none)


@pytest.mark.parametrize("missing", ["x", "opacity", "rot_3", "scale_0", "f_dc_1"])
def test_missing_property_is_named(tmp_path: Path, missing: str) -> None:
    columns = columns_of(random_gaussians("normal", count=3, degree=1))
    del columns[missing]
    with pytest.raises(InputError, match=f"property {missing}: is missing"):
        read_ply(foreign_file(tmp_path / "a.ply", columns))


def test_missing_harmonic(tmp_path: Path) -> None:
    columns = columns_of(random_gaussians("normal", count=3, degree=1))
    del columns["f_rest_8"]
    with pytest.raises(InputError, match=r"f_rest_\*: 8 properties"):
        read_ply(foreign_file(tmp_path / "a.ply", columns))
    columns["f_rest_44"] = columns["f_rest_0"]
    with pytest.raises(InputError, match="property f_rest_8: is missing"):
        read_ply(foreign_file(tmp_path / "a.ply", columns))


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name in ("y", "f_rest_5", "scale_0") for value in (np.nan, np.inf)]
    + [("opacity", np.nan), ("y", -np.inf)],
)
def test_value_that_is_not_finite_is_named(tmp_path: Path, name: str, value: float) -> None:
    columns = columns_of(random_gaussians("normal", count=5, degree=1))
    columns[name] = columns[name].copy()
    columns[name][3] = value
    with pytest.raises(InputError, match=f"property {name}: row 3 is not finite"):
        read_ply(foreign_file(tmp_path / "a.ply", columns))


def test_an_infinite_logit_is_an_opacity_of_one_or_zero(tmp_path: Path) -> None:
    columns = columns_of(random_gaussians("normal", count=5, degree=1))
    columns["opacity"] = np.array([0, np.inf, -np.inf, 1, 2], np.float32)
    columns["scale_1"] = np.array([0, -np.inf, 0, 0, 0], np.float32)
    gaussians = read_ply(foreign_file(tmp_path / "a.ply", columns))
    np.testing.assert_array_equal(gaussians.means[:, 0], columns["x"][[0, 1, 3, 4]])
    assert float(gaussians.logit_opacities[1].double().sigmoid()) == pytest.approx(
        1 - 2**-24, abs=1e-8
    )
    assert float(gaussians.log_scales[1, 1].exp()) < 1e-20


def test_the_filter_of_mip_splatting_widens_and_fades(tmp_path: Path) -> None:
    """sqrt(0.05^2 + 0.05^2), and an opacity of 0.88 times the root of the determinants' ratio."""
    gaussians = random_gaussians("normal", count=4)
    gaussians.log_scales[:] = np.log(0.05)
    gaussians.logit_opacities[:] = np.log(0.88 / 0.12)
    columns = columns_of(gaussians) | {"filter_3D": np.full(4, 0.05, np.float32)}
    path = foreign_file(tmp_path / "a.ply", columns)
    filtered = read_ply(path)
    np.testing.assert_allclose(filtered.log_scales.exp(), 0.0707, rtol=1e-3)
    np.testing.assert_allclose(filtered.logit_opacities.sigmoid(), 0.311, atol=1e-3)
    assert torch.equal(filtered.means, gaussians.means)
    assert read_low_pass(path) == MIP
    np.testing.assert_array_equal(read_ply(path, double=True).log_scales, filtered.log_scales)
    columns["scale_0"] = np.full(4, np.log(0.02), np.float32)
    thin = read_ply(foreign_file(path, columns))
    share = 0.02 / np.hypot(0.02, 0.05) / 2
    np.testing.assert_allclose(thin.logit_opacities.sigmoid(), 0.88 * share, rtol=1e-4)


def test_doubles_keep_their_digits_until_they_are_moved(tmp_path: Path) -> None:
    gaussians = random_gaussians("normal", count=50, degree=1)
    offset = np.array([458123.25, 5428765.5, 112.0])
    columns = columns_of(gaussians)
    for i, name in enumerate("xyz"):
        columns[name] = columns[name].astype(np.float64) + offset[i]
    path = foreign_file(tmp_path / "a.ply", columns)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = torch.from_numpy(-offset)
    placed = read_ply(path, double=True).transformed(pose)
    np.testing.assert_allclose(placed.means, gaussians.means, atol=1e-8)
    assert placed.quats.dtype == placed.sh.dtype == torch.float32
    assert read_ply(path).means.dtype == torch.float32


@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_headers_of_other_programs(tmp_path: Path, form: str) -> None:
    """Comments in any encoding that name end_header, Windows line ends, elements before vertex."""
    gaussians = random_gaussians("normal", count=3, degree=1)
    path = foreign_file(tmp_path / "a.ply", columns_of(gaussians), form)
    head, _, body = path.read_bytes().partition(b"end_header\n")
    first = np.array([7, 8], ">u2" if "big" in form else "<u2").tobytes()
    start = (
        b"comment end_header of Stra\xdfe\x85\nelement info 2\nproperty ushort id\nelement vertex"
    )
    head = head.replace(b"element vertex", start) + b"end_header\n"
    body = (b"7\n8\n" if form == "ascii" else first) + body
    path.write_bytes(head.replace(b"\n", b"\r\n") + body)
    assert equal(read_ply(path), gaussians)
    assert read_low_pass(path) is None


def test_discs_and_plain_colours(tmp_path: Path) -> None:
    """2DGS has two scales; some exporters write red green blue instead of f_dc."""
    gaussians = random_gaussians("normal", count=3)
    columns = columns_of(gaussians)
    del columns["scale_2"]
    flat = read_ply(foreign_file(tmp_path / "a.ply", columns))
    assert torch.equal(flat.log_scales[:, :2], gaussians.log_scales[:, :2])
    assert float(flat.log_scales[:, 2].exp().max()) < 1e-20
    for i, name in enumerate(("red", "green", "blue")):
        del columns[f"f_dc_{i}"]
        columns[name] = np.array([0, 51, 255], np.uint8)
    for form in ("binary_little_endian", "ascii"):
        plain = read_ply(foreign_file(tmp_path / "b.ply", columns, form))
        np.testing.assert_allclose(plain.sh[:, 0, 1] * C0 + 0.5, [0, 0.2, 1], atol=1e-6)


def test_quaternion_of_norm_zero(tmp_path: Path) -> None:
    columns = columns_of(random_gaussians("normal", count=5, degree=1))
    for i in range(4):
        columns[f"rot_{i}"] = np.zeros(5, np.float32)
    with pytest.raises(InputError, match="row 0 has a norm out of 1e-15"):
        read_ply(foreign_file(tmp_path / "a.ply", columns))


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_truncated_at_every_length(tmp_path: Path, form: str) -> None:
    columns = columns_of(random_gaussians("normal", count=4, degree=0))
    whole = foreign_file(tmp_path / "a.ply", columns, form).read_bytes()
    cut = tmp_path / "cut.ply"
    # As text the last number may lose digits unnoticed; a whole number lost is noticed.
    for size in range(0, len(whole) - (25 if form == "ascii" else 0), 7):
        cut.write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"cut\.ply"):
            read_ply(cut)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"solid not a ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex x\nend_header\n",
        b"ply\nformat utf8 1.0\nelement vertex 1\nend_header\n",
        b"ply\nelement vertex 1\nproperty float x\nend_header\n",
        b"ply\nformat ascii 1.0\nproperty float x\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex 1\n" + b"property float x\n" * 2 + b"end_header\n1",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\nword",
        b"ply\nformat ascii 1.0\nelement face 1\nelement vertex 1\nproperty float x\nend_header\n1",
        b"ply\nformat ascii 1.0\nelement vertex 99999999999999\nproperty float x\nend_header\n1",
        b"ply\nformat ascii 1.0\nelement vertex -1\nproperty float x\nend_header\n",
        b"ply\n\xff\xfe\nend_header\n",
        b"ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int a\nelement vertex 0\n"
        b"property float x\nend_header\n",
    ],
)
def test_what_is_no_ply_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.ply"):
        read_ply(tmp_path / "bad.ply")


def test_the_compressed_layout_is_named(tmp_path: Path) -> None:
    header = "ply\nformat binary_little_endian 1.0\nelement chunk 1\nproperty float min_x\n"
    header += "element vertex 1\nproperty uint packed_position\nend_header\n"
    (tmp_path / "a.ply").write_bytes(header.encode() + bytes(8))
    with pytest.raises(InputError, match="compressed PLY of SuperSplat"):
        read_ply(tmp_path / "a.ply")


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is missing"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(InputError, match="is a folder"):
        read_ply(tmp_path)


def test_bad_gaussians_are_not_written(tmp_path: Path) -> None:
    gaussians = random_gaussians("normal", count=3)
    gaussians.means[1, 1] = float("nan")
    with pytest.raises(ValueError, match=r"means: row 1"):
        write_ply(tmp_path / "a.ply", gaussians)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("rot", 1e-30, "rot_0..3: row 2 has a norm out of"),
        ("rot", 1e20, "rot_0..3: row 2 has a norm out of"),
        ("scale_1", 14.5, "scale_0..2: row 2 is out of -60..14"),
        ("scale_1", -61.0, "scale_0..2: row 2 is out of -60..14"),
        ("opacity", 1e20, "opacity: row 2 is out of"),
        ("f_dc_1", -1e30, r"f_dc_\* f_rest_\*: row 2 is out of"),
        ("z", 1e16, "x y z: row 2 is out of"),
    ],
)
def test_value_out_of_range_is_named(tmp_path: Path, name: str, value: float, problem: str) -> None:
    columns = columns_of(random_gaussians("normal", count=5, degree=1))
    for column in [f"rot_{i}" for i in range(4)] if name == "rot" else [name]:
        columns[column] = columns[column].copy()
        columns[column][2] = value
    with pytest.raises(InputError, match=problem):
        read_ply(foreign_file(tmp_path / "a.ply", columns))


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_more_rows_than_bytes_take_no_memory(tmp_path: Path, form: str) -> None:
    """A header that promises vertices without properties, or more than the file holds."""
    for properties in ("", "property uchar x\n"):
        header = f"ply\nformat {form} 1.0\nelement vertex {10**17}\n{properties}end_header\n"
        (tmp_path / "a.ply").write_bytes(header.encode())
        with pytest.raises(InputError, match="is missing"):
            read_ply(tmp_path / "a.ply")
