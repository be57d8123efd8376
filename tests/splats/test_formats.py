"""All formats of Gaussians: axes, bounds of what comes back, and declared filters."""

from __future__ import annotations

import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.geometry import se3
from recast.splats import MIP, Gaussians, LowPass, concatenate
from recast.splats.formats import (
    EXTENSION,
    format_of,
    formats,
    has_gaussians,
    read_gaussians,
    read_gltf,
    write_gaussians,
    write_gltf,
)
from recast.splats.gaussians import evaluate_harmonics, quat_to_matrix
from recast_bridges.splats.usd import read_usd, write_usd
from support.splat_scenes import random_gaussians

AHEAD = {"ply": (1, 0, 0), "gltf": (0, 0, 1), "spz": (0, 0, -1), "usd": (1, 0, 0)}
LEFT = {"ply": (0, 1, 0), "gltf": (1, 0, 0), "spz": (-1, 0, 0), "usd": (0, 1, 0)}
UP = {"ply": (0, 0, 1), "gltf": (0, 1, 0), "spz": (0, 1, 0), "usd": (0, 0, 1)}
LINEAR = {"gltf": (write_gltf, read_gltf), "usd": (write_usd, read_usd)}


def covariances(gaussians: Gaussians) -> torch.Tensor:
    axes = quat_to_matrix(gaussians.quats.double()) * gaussians.log_scales.double().exp()[:, None]
    return axes @ axes.mT


def tree_of(path: Path) -> tuple[dict, bytes]:
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[20 + length :]


def with_tree(path: Path, tree: dict, rest: bytes) -> Path:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<5I", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    path.write_bytes(head + text + rest)
    return path


@pytest.mark.parametrize("name", list(formats()))
def test_files_have_the_axes_of_their_format(tmp_path: Path, name: str) -> None:
    """Places and colours seen from ahead, left and above, as the file itself has them."""
    one = formats()[name]  # type: ignore[index]
    path = tmp_path / f"a{one.suffix}"
    gaussians = random_gaussians("normal", count=3, degree=1)
    gaussians = replace(gaussians, means=torch.eye(3), sh=gaussians.sh.clamp(-0.9, 0.9))
    write_gaussians(path, gaussians)
    ways = torch.tensor([AHEAD[name], LEFT[name], UP[name]], dtype=torch.float32)
    stored = one.read(path)
    assert torch.allclose(stored.means, ways, atol=1e-6)
    own = evaluate_harmonics(gaussians.sh[:, None], torch.eye(3)[None])
    seen = evaluate_harmonics(stored.sh[:, None], ways[None])
    assert (seen - own).abs().max() < (0.06 if name == "spz" else 1e-5)
    back = read_gaussians(path)
    assert torch.allclose(back.means, gaussians.means, atol=1e-6)
    if name != "spz":  # its bounds are those of test_spz
        assert torch.allclose(covariances(back), covariances(gaussians), 1e-5, 1e-9)


@pytest.mark.parametrize("name", list(LINEAR))
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_only_rounding_is_lost(tmp_path: Path, name: str, degree: int) -> None:
    write, read = LINEAR[name]
    gaussians = random_gaussians("needles", count=70_000 if degree == 0 else 200, degree=degree)
    write(tmp_path / "a", gaussians, None)
    back = read(tmp_path / "a")
    assert torch.equal(back.means, gaussians.means) and torch.equal(back.sh, gaussians.sh)
    quats = gaussians.quats / gaussians.quats.norm(dim=1, keepdim=True)
    assert torch.equal(back.quats, quats)
    # An ulp of the exponential and of the logarithm each.
    bound = 2**-22 * (1 + gaussians.log_scales.abs())
    assert ((back.log_scales - gaussians.log_scales).abs() <= bound).all()
    opacities = back.logit_opacities.sigmoid() - gaussians.logit_opacities.sigmoid()
    assert opacities.abs().max() <= 2**-22


@pytest.mark.parametrize("name", list(LINEAR))
def test_opacities_of_one_and_flat_gaussians_stay_finite(tmp_path: Path, name: str) -> None:
    write, read = LINEAR[name]
    extreme = replace(
        random_gaussians("normal", count=2, degree=0),
        logit_opacities=torch.tensor([80.0, -80.0]),
        log_scales=torch.tensor([[-59.99, 0, 13.99], [1.0, 2, 3]]),
    )
    write(tmp_path / "a", extreme, None)
    back = read(tmp_path / "a")
    assert back.fault() is None
    expected = extreme.logit_opacities.sigmoid()
    assert torch.allclose(back.logit_opacities.sigmoid(), expected, 0, 2**-23)
    assert torch.allclose(back.log_scales, extreme.log_scales, 0, 1e-4)


@pytest.mark.parametrize("name", ["ply", "gltf", "usd"])
@pytest.mark.parametrize("low_pass", [MIP, LowPass(0.25), None])
def test_filters_are_declared(tmp_path: Path, name: str, low_pass: LowPass | None) -> None:
    one = formats()[name]  # type: ignore[index]
    path = tmp_path / f"a{one.suffix}"
    write_gaussians(path, random_gaussians("normal", count=2), low_pass)
    assert one.low_pass(path) == low_pass
    if low_pass == MIP:
        path.write_bytes(path.read_bytes().replace(b"0.1 antialiased", b"0.1 unantialias"))
        with pytest.raises(InputError, match="cannot be understood"):
            one.low_pass(path)


def test_unknown_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"use \.ply, \.glb, \.spz, \.usda"):
        format_of("car.splat")


def test_gltf_is_what_the_specification_says(tmp_path: Path) -> None:
    gaussians = random_gaussians("normal", count=5, degree=1)
    write_gltf(tmp_path / "a.glb", gaussians)
    tree, rest = tree_of(tmp_path / "a.glb")
    (primitive,) = tree["meshes"][0]["primitives"]
    assert tree["extensionsUsed"] == [EXTENSION] and primitive["mode"] == 0
    assert primitive["extensions"][EXTENSION]["kernel"] == "ellipse"
    names = ["ROTATION", "SCALE", "OPACITY", "SH_DEGREE_0_COEF_0"]
    names += [f"SH_DEGREE_1_COEF_{i}" for i in range(3)]
    wanted = {"POSITION", "COLOR_0", *(f"{EXTENSION}:{name}" for name in names)}
    assert set(primitive["attributes"]) == wanted
    accessor = tree["accessors"][primitive["attributes"][f"{EXTENSION}:SH_DEGREE_1_COEF_2"]]
    view = tree["bufferViews"][accessor["bufferView"]]
    start = 8 + view["byteOffset"]
    stored = np.frombuffer(rest[start : start + view["byteLength"]], "<f4").reshape(5, 3)
    assert np.array_equal(stored, gaussians.sh[:, 3])
    low, high = tree["accessors"][0]["min"], tree["accessors"][0]["max"]
    assert low == gaussians.means.amin(0).tolist() and high == gaussians.means.amax(0).tolist()


def test_gltf_nodes_place_gaussians(tmp_path: Path) -> None:
    gaussians = random_gaussians("normal", count=5, degree=2)
    write_gltf(tmp_path / "a.glb", gaussians)
    tree, rest = tree_of(tmp_path / "a.glb")
    turn = se3.exp(np.array([1.0, 2, 3, 0.3, -0.2, 0.5]))
    matrix = turn.copy()
    matrix[:3, :3] *= 2
    tree["nodes"] = [{"mesh": 0}, {"children": [2], "matrix": matrix.T.ravel().tolist()}]
    tree["nodes"].append({"mesh": 0})
    tree["scenes"] = [{"nodes": [0, 1]}]
    back = read_gltf(with_tree(tmp_path / "b.glb", tree, rest))
    moved = gaussians.transformed(torch.from_numpy(turn), 2.0)
    parts = concatenate([gaussians, moved])
    order = back.means[:, 0].argsort(), parts.means[:, 0].argsort()
    assert torch.allclose(back.means[order[0]], parts.means[order[1]], atol=1e-5)
    assert torch.allclose(back.sh[order[0]], parts.sh[order[1]], atol=1e-5)
    back, parts = back.select(order[0]), parts.select(order[1])
    assert torch.allclose(covariances(back), covariances(parts), 1e-4, 1e-9)
    for wrong in (np.diag([1, 2, 1, 1.0]), np.diag([1, 1, -1, 1.0]), np.diag([0, 0, 0, 1.0])):
        tree["nodes"][1]["matrix"] = wrong.ravel().tolist()
        with pytest.raises(InputError, match="shear, mirror, or scale unevenly"):
            read_gltf(with_tree(tmp_path / "c.glb", tree, rest))


def test_gltf_shares_in_small_numbers_are_read(tmp_path: Path) -> None:
    """OPACITY may be normalised bytes: here the bytes of COLOR_0's first channel."""
    write_gltf(tmp_path / "a.glb", random_gaussians("normal", count=5, degree=0))
    tree, rest = tree_of(tmp_path / "a.glb")
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]
    colour = tree["accessors"][attributes["COLOR_0"]]
    tree["bufferViews"].append(tree["bufferViews"][colour["bufferView"]] | {"byteStride": 4})
    tree["accessors"].append(
        colour | {"type": "SCALAR", "bufferView": len(tree["bufferViews"]) - 1}
    )
    attributes[f"{EXTENSION}:OPACITY"] = len(tree["accessors"]) - 1
    start = 8 + tree["bufferViews"][-1]["byteOffset"]
    shares = torch.frombuffer(bytearray(rest[start : start + 20]), dtype=torch.uint8)[::4] / 255
    back = read_gltf(with_tree(tmp_path / "b.glb", tree, rest))
    assert torch.allclose(back.logit_opacities.sigmoid(), shares, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda t, p: p["extensions"].clear(), "draws no Gaussians"),
        (lambda t, p: p["extensions"][EXTENSION].update(kernel="cone"), "kernel"),
        (lambda t, p: p["extensions"][EXTENSION].update(colorSpace="lin_rec709_display"), "color"),
        (lambda t, p: p["attributes"].pop(f"{EXTENSION}:SH_DEGREE_1_COEF_1"), "3 harmonics"),
        (lambda t, p: p["attributes"].pop(f"{EXTENSION}:SCALE"), "lack KHR_gaussian_splatting:SC"),
        (lambda t, p: p.update(mode=4), "not made of points"),
        (lambda t, p: p.update(indices=0), "indices"),
        (lambda t, p: t["accessors"][1].update(count=4), "has 4 rows, not 5"),
        (lambda t, p: t["accessors"][0].update(count=1 << 40), "more than 10000000"),
        (lambda t, p: [a.update(count=900) for a in t["accessors"]], "ends at byte"),
        (lambda t, p: t.update(extensionsRequired=["KHR_gaussian_compression"]), "not read"),
        (lambda t, p: t["buffers"][0].update(uri="../secret.bin"), "not a file inside"),
    ],
)
def test_broken_gltf(tmp_path: Path, change, line: str) -> None:  # type: ignore[no-untyped-def]
    write_gltf(tmp_path / "a.glb", random_gaussians("normal", count=5, degree=1))
    tree, rest = tree_of(tmp_path / "a.glb")
    change(tree, tree["meshes"][0]["primitives"][0])
    with pytest.raises(InputError, match=line):
        read_gltf(with_tree(tmp_path / "b.glb", tree, rest))
    assert has_gaussians(tmp_path / "a.glb")


def test_usd_stages_say_their_axes_and_unit(tmp_path: Path) -> None:
    gaussians = random_gaussians("normal", count=5, degree=1)
    write_usd(tmp_path / "a.usda", gaussians)
    text = (tmp_path / "a.usda").read_text()
    y_up = re.sub(r"    (metersPerUnit|upAxis).*\n", "", text)  # centimetres and y up by rule
    (tmp_path / "b.usda").write_text(y_up)
    back = read_usd(tmp_path / "b.usda")
    x, y, z = (gaussians.means / 100).unbind(1)
    assert torch.allclose(back.means, torch.stack([x, -z, y], dim=1), atol=1e-6)
    assert torch.allclose(back.log_scales, gaussians.log_scales - np.log(100), atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("#usda 1.0", "PXR-USDC", "convert it to text with usdcat"),
        ("ParticleField3DGaussianSplat", "Xform", "draws no Gaussians"),
        ("float[] opacities", "float[] opacity", "opacities: is missing"),
        ("float[] opacities = [", "float[] opacities = [0.5, ", "has 6 rows, not 5"),
        ("float[] opacities = [", "float[] opacities = [x, ", "holds a value that is not a number"),
        ("float[] opacities = [", "float[] opacities = [nan, ", "rows"),
        ("float3[] scales = [(", "float3[] scales = [(1, ", "numbers in 5 tuples"),
        ("Degree = 1", "Degree = 2", "has 20 rows, not 45"),
        ("Degree = 1", "Degree = 4", "3 at most"),
        ("srgb_rec709_display", "lin_rec709_scene", "only srgb_rec709_display"),
        (
            "    float3[] scales",
            "    double3 xformOp:translate = (1, 2, 3)\n    float3[] scales",
            "xf",
        ),
        ('defaultPrim = "Gaussians"', "subLayers = [@/etc/passwd@]", "subLayers: is not read"),
        ("metersPerUnit = 1", "metersPerUnit = 0", "metersPerUnit"),
    ],
)
def test_broken_usd(tmp_path: Path, old: str, new: str, line: str) -> None:
    write_usd(tmp_path / "a.usda", random_gaussians("normal", count=5, degree=1))
    text = (tmp_path / "a.usda").read_text()
    assert old in text
    (tmp_path / "b.usda").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=line):
        read_usd(tmp_path / "b.usda")
