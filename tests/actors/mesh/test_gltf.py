"""Reading GLB files; trimesh, which wrote or read the same file, is the witness."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from recast.actors.mesh_gltf import files_of_glb, read_glb
from recast.core.errors import InputError
from support.mesh_files import (
    HALVES,
    SQUARE,
    SQUARE_UV,
    Glb,
    box,
    car,
    packed,
    picture,
    textured_square,
)

RED = np.full((4, 4, 3), [200, 10, 10], np.uint8)


def square() -> Glb:
    glb = Glb()
    glb.primitive(SQUARE, HALVES)
    return glb


def test_placed_triangles_are_those_of_trimesh(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scene = trimesh.Scene()
    for name in ("body", "wheel"):
        corners, faces = box([0, 0, 0], rng.uniform(1, 2, 3))
        scene.add_geometry(trimesh.Trimesh(corners, faces, process=False), name, geom_name=name)
    turn = trimesh.transformations.euler_matrix(0.1, 0.2, 0.3) * 2.0
    turn[:3, 3], turn[3, 3] = [1, 2, 3], 1
    scene.graph.update("other", "body", matrix=turn, geometry="wheel")  # an instance
    mirrored = np.diag([1.0, -1.0, 1.0, 1.0])
    scene.graph.update("third", "other", matrix=mirrored, geometry="wheel")
    path = tmp_path / "a.glb"
    path.write_bytes(scene.export(file_type="glb"))
    ours = np.concatenate([part.corners for part in read_glb(path)])
    theirs = trimesh.load_scene(path).to_mesh().triangles
    assert len(ours) == 48
    ours, theirs = (np.round(np.sort(one, axis=1), 5).reshape(-1, 9) for one in (ours, theirs))
    for one in ours:  # the same triangles, in another order and wound either way
        assert np.abs(theirs - one).max(axis=1).min() < 1e-4


def test_texture_factor_and_coordinates(tmp_path: Path) -> None:
    glb = textured_square(RED)
    glb.tree["materials"][0] |= {"alphaMode": "MASK", "alphaCutoff": 0.25}
    glb.tree["materials"][0]["pbrMetallicRoughness"] |= {
        "baseColorFactor": [0.001, 0.5, 1.0, 0.9],
        "roughnessFactor": 0.3,
    }
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    material = part.material
    assert material.texture is not None
    assert np.all(material.texture == [200, 10, 10, 255])
    np.testing.assert_array_equal(material.factor, [0.001, 0.5, 1.0, 0.9])
    assert (material.alpha, material.cutoff, material.gloss) == ("MASK", 0.25, 0.7)
    np.testing.assert_array_equal(part.uv, SQUARE_UV[HALVES])


def test_quantised_and_moved_coordinates(tmp_path: Path) -> None:
    glb = textured_square(RED)
    one = glb.tree["meshes"][0]["primitives"][0]
    half = np.round(SQUARE_UV * 65535 / 2).astype(np.uint16)
    one["attributes"]["TEXCOORD_1"] = glb.array(half, normalized=True)
    use = glb.tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    use["extensions"] = {
        "KHR_texture_transform": {"texCoord": 1, "scale": [2, 4], "offset": [0.5, 0]}
    }
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    np.testing.assert_allclose(part.uv, (SQUARE_UV * [1, 2] + [0.5, 0])[HALVES], atol=1e-4)


def test_the_texture_turns_as_in_the_example_of_the_extension(tmp_path: Path) -> None:
    """KHR_texture_transform: "only the lower left quadrant, rotated clockwise 90 degrees"."""
    glb = textured_square(RED)
    use = glb.tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    use["extensions"] = {
        "KHR_texture_transform": {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}
    }
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    assert part.uv is not None
    upper_left = np.flatnonzero((SQUARE_UV[HALVES].reshape(-1, 2) == [0, 0]).all(axis=1))[0]
    np.testing.assert_allclose(part.uv.reshape(-1, 2).min(axis=0), [0.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(part.uv.reshape(-1, 2).max(axis=0), [0.5, 1.0], atol=1e-6)
    np.testing.assert_allclose(part.uv.reshape(-1, 2)[upper_left], [0.0, 1.0], atol=1e-6)


@pytest.mark.parametrize("required", [False, True])
def test_instances_are_drawn_where_they_stand(tmp_path: Path, required: bool) -> None:
    """Of the node's frame; quaternions may be normalised whole numbers."""
    glb = square()
    half = round(32767 * 0.5**0.5)
    turns = np.array([[0, 0, 0, 32767], [0, 0, half, half]], np.int16)
    attributes = {
        "TRANSLATION": glb.array(np.array([[0, 0, 0], [5, 0, 0]], np.float32)),
        "ROTATION": glb.array(turns, normalized=True),
        "SCALE": glb.array(np.array([[1, 1, 1], [2, 2, 2]], np.float32)),
    }
    name = "EXT_mesh_gpu_instancing"
    glb.tree["nodes"] = [
        {"mesh": 0, "translation": [0, 0, 3], "extensions": {name: {"attributes": attributes}}}
    ]
    glb.tree["extensionsRequired" if required else "extensionsUsed"] = [name]
    first, second = read_glb(glb.write(tmp_path / "a.glb"))
    np.testing.assert_allclose(first.corners, (SQUARE + np.array([0, 0, 3]))[HALVES], atol=1e-6)
    turned = np.stack([5 - 2 * SQUARE[:, 1], 2 * SQUARE[:, 0], np.full(4, 3)], axis=1)
    np.testing.assert_allclose(second.corners, turned[HALVES], atol=1e-3)


def test_hidden_nodes_and_all_below_are_not_drawn(tmp_path: Path) -> None:
    glb = square()
    hidden = {"KHR_node_visibility": {"visible": False}}
    glb.tree["nodes"] = [
        {"children": [1, 3]},
        {"children": [2], "extensions": hidden},
        {"mesh": 0},
        {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": True}}},
    ]
    assert len(read_glb(glb.write(tmp_path / "a.glb"))) == 1


@pytest.mark.parametrize(("node", "height"), [({}, 1.0), ({"weights": [1.0, 0.5]}, 2.0)])
def test_morph_targets_have_their_default_weights(
    tmp_path: Path, node: dict, height: float
) -> None:
    """Those of the node before those of the mesh; targets are sparse, or have no data at all."""
    glb = square()
    raised = glb.sparse(4, np.array([2], np.uint8), np.array([[0, 0, 2]], np.float32))
    glb.tree["accessors"].append({"count": 4, "componentType": 5126, "type": "VEC3"})
    targets = [{"POSITION": raised}, {"POSITION": len(glb.tree["accessors"]) - 1}]
    glb.tree["meshes"][0]["primitives"][0]["targets"] = targets
    glb.tree["meshes"][0]["weights"] = [0.5, 1.0]
    glb.tree["nodes"][0] |= node
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    moved = SQUARE.copy()
    moved[2, 2] = height
    np.testing.assert_allclose(part.corners, moved[HALVES])


def test_sparse_rows_replace_those_of_the_view(tmp_path: Path) -> None:
    glb = square()
    index = glb.sparse(4, np.array([1], np.uint8), np.array([[7, 0, 0]], np.float32), bufferView=0)
    glb.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = index
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    assert part.corners[0, 1].tolist() == [7, 0, 0]
    np.testing.assert_array_equal(part.corners[1], SQUARE[HALVES[1]])


def test_samplers_say_how_a_texture_goes_on(tmp_path: Path) -> None:
    glb = textured_square(RED)
    glb.tree["samplers"] = [{}, {"wrapS": 33648, "wrapT": 33071}]
    for sampler, wrap in ((0, ("REPEAT", "REPEAT")), (1, ("MIRROR", "CLAMP"))):
        glb.tree["textures"][0]["sampler"] = sampler
        (part,) = read_glb(glb.write(tmp_path / "a.glb"))
        assert part.material.wrap == wrap


def test_emission_and_unlit_materials(tmp_path: Path) -> None:
    glb = textured_square(RED)
    one = glb.tree["meshes"][0]["primitives"][0]
    one["attributes"]["TEXCOORD_1"] = glb.array(SQUARE_UV * 3)
    glb.tree["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]},
            "emissiveFactor": [0.1, 0.2, 0.3],
            "emissiveTexture": {"index": 0, "texCoord": 1},
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 2.0}},
        }
    ]
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    assert part.glow is not None and part.glow.texture is not None
    np.testing.assert_allclose(part.glow.factor, [0.2, 0.4, 0.6])
    np.testing.assert_allclose(part.glow.uv, (SQUARE_UV * 3)[HALVES])
    assert part.uv is None and part.material.lit
    glb.tree["materials"][0]["extensions"] = {"KHR_materials_unlit": {}}
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    assert part.glow is None and not part.material.lit


def test_a_gltf_with_its_buffer_beside_it(tmp_path: Path) -> None:
    glb = textured_square(RED)
    glb.tree["buffers"] = [{"uri": "a.bin", "byteLength": len(glb.binary)}]
    (tmp_path / "a.bin").write_bytes(glb.binary)
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(glb.tree))
    (part,) = read_glb(path)
    np.testing.assert_array_equal(part.corners, SQUARE[HALVES])
    assert files_of_glb(path) == [tmp_path / "a.bin"]


def test_whole_numbers_of_colours_are_shares(tmp_path: Path) -> None:
    """Even if the exporter forgot to say so."""
    glb = square()
    index = glb.array(np.array([[255, 0, 51, 255]] * 4, np.uint8))
    glb.tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = index
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    np.testing.assert_allclose(part.colours, np.broadcast_to([1, 0, 0.2, 1], (2, 3, 4)))


def test_vertex_colours_become_linear_shares(tmp_path: Path) -> None:
    glb = square()
    colours = np.array([[255, 0, 51]] * 4, np.uint8)
    padded = np.zeros((4, 4), np.uint8)  # rows are aligned to four bytes
    padded[:, :3] = colours
    index = glb.array(padded, normalized=True)
    glb.tree["accessors"][index]["type"] = "VEC3"
    glb.tree["bufferViews"][-1]["byteStride"] = 4
    glb.tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = index
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    np.testing.assert_allclose(part.colours, np.broadcast_to([1, 0, 0.2, 1], (2, 3, 4)))


@pytest.mark.parametrize(
    ("extension", "factor", "alpha", "gloss"),
    [
        ({"KHR_materials_transmission": {"transmissionFactor": 0.6}}, [1, 1, 1, 0.4], "BLEND", 0),
        ({"KHR_materials_transmission": {"transmissionFactor": 1.0}}, [1, 1, 1, 0.08], "BLEND", 0),
        (
            {
                "KHR_materials_pbrSpecularGlossiness": {
                    "diffuseFactor": [0.1, 0.2, 0.3, 1.0],
                    "glossinessFactor": 0.8,
                }
            },
            [0.1, 0.2, 0.3, 1.0],
            "OPAQUE",
            0.8,
        ),
    ],
)
def test_materials_of_extensions(
    tmp_path: Path, extension: dict, factor: list[float], alpha: str, gloss: float
) -> None:
    glb = square()
    glb.tree["meshes"][0]["primitives"][0]["material"] = 0
    glb.tree["materials"] = [{"extensions": extension}]
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    np.testing.assert_allclose(part.material.factor, factor)
    assert (part.material.alpha, part.material.gloss) == (alpha, gloss)


@pytest.mark.parametrize("mode", [5, 6])
def test_strips_and_fans(tmp_path: Path, mode: int) -> None:
    order = [0, 1, 3, 2] if mode == 5 else [0, 1, 2, 3]
    glb = Glb()
    glb.primitive(SQUARE[order], None, mode=mode)
    (part,) = read_glb(glb.write(tmp_path / "a.glb"))
    areas = np.linalg.norm(np.cross(*np.diff(part.corners, axis=1).transpose(1, 0, 2)), axis=1) / 2
    np.testing.assert_allclose(areas, [0.5, 0.5])


def test_files_beside_it(tmp_path: Path) -> None:
    glb = textured_square(RED)
    glb.tree["images"] = [{"uri": "textures/my%20paint.png"}]
    glb.tree["buffers"].append({"uri": "more.bin", "byteLength": 4})
    path = glb.write(tmp_path / "a.glb")
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures/my paint.png").write_bytes(picture(RED))
    assert files_of_glb(path) == [tmp_path / "more.bin", tmp_path / "textures/my paint.png"]
    (part,) = read_glb(path)
    assert part.material.texture is not None
    glb.tree["images"] = [
        {"uri": "data:image/png;base64," + base64.b64encode(picture(RED)).decode()}
    ]
    glb.tree["buffers"].pop()
    (part,) = read_glb(glb.write(path))
    assert part.material.texture is not None
    assert files_of_glb(path) == []


def test_large_textures_are_averaged(tmp_path: Path) -> None:
    stripes = np.zeros((2, 4100, 3), np.uint8)
    stripes[:, ::2] = 200
    (part,) = read_glb(textured_square(stripes).write(tmp_path / "a.glb"))
    assert part.material.texture is not None
    assert max(part.material.texture.shape) <= 2048
    assert part.material.texture[..., 0].mean() == pytest.approx(100, abs=2)


def _set(path: str, value: object) -> Callable[[Glb], None]:
    def change(glb: Glb) -> None:
        *parents, last = path.split(".")
        node = glb.tree
        for name in parents:
            node = node[int(name) if isinstance(node, list) else name]
        if isinstance(node, list):
            node[int(last)] = value
        else:
            node[last] = value

    return change


def _nan(glb: Glb) -> None:
    glb.binary = struct.pack("<f", np.nan) + glb.binary[4:]


def _two_parents(glb: Glb) -> None:
    glb.tree["nodes"] = [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]


def _billion_laughs(glb: Glb) -> None:
    glb.tree["nodes"] = [{"children": [i + 1, i + 1]} for i in range(60)] + [{"mesh": 0}]


def _cycle(glb: Glb) -> None:
    glb.tree["nodes"] = [{"children": [1], "mesh": 0}, {"children": [0]}]


def _many_instances(glb: Glb) -> None:
    """15 kB of triangles, drawn forty thousand times: 10^7 of them, in a file of a megabyte."""
    glb.tree["meshes"][0]["primitives"] = [glb.tree["meshes"][0]["primitives"][0]] * 1000
    glb.tree["nodes"] = [{"mesh": 0}] * 10_000
    glb.tree["scenes"][0]["nodes"] = list(range(10_000))


def _bomb(glb: Glb) -> None:
    """A PNG of 60000 x 60000 pixels, by its header."""
    data = bytearray(picture(RED))
    data[16:24] = struct.pack(">II", 60_000, 60_000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    glb.tree["images"][0]["bufferView"] = glb.view(bytes(data))


def _sparse(count: int, view: int | None) -> Callable[[Glb], None]:
    def change(glb: Glb) -> None:
        one = {
            "indices": {"bufferView": 2, "byteOffset": 4, "componentType": 5121},
            "values": {"bufferView": 0},
        }
        glb.tree["bufferViews"][0]["byteLength"] = 40 if view == 0 else 48
        glb.tree["accessors"][0] |= {"bufferView": view, "count": count, "sparse": one}
        glb.tree["accessors"][0]["sparse"]["count"] = 4

    return change


def _compressed(glb: Glb) -> None:
    """Draco that is used, not required."""
    glb.tree["accessors"][0]["bufferView"] = None
    one = glb.tree["meshes"][0]["primitives"][0]
    one["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}


def _compressed_buffer(glb: Glb) -> None:
    glb.tree["buffers"][0]["extensions"] = {"EXT_meshopt_compression": {"fallback": True}}


def _instanced(**attributes: int) -> Callable[[Glb], None]:
    return _set("nodes.0.extensions", {"EXT_mesh_gpu_instancing": {"attributes": attributes}})


def _morphs(count: int) -> dict:
    one = {"attributes": {"POSITION": 0}, "targets": [{"POSITION": 0}] * count}
    return {"primitives": [one], "weights": [1.0] * count}


WRONG: list[tuple[str, Callable[[Glb], None]]] = [
    ("accessors.0", _set("accessors.0.count", 10**9)),
    ("triangles", _set("accessors.1.count", 3 * 10**9)),
    ("accessors.1", _set("accessors.1.count", 3 * 10**6)),
    ("accessors.0", _set("accessors.0.byteOffset", 10**6)),
    ("accessors.0.count", _set("accessors.0.count", -1)),
    ("accessors.0.componentType", _set("accessors.0.componentType", 7)),
    ("accessors.0", _set("accessors.0.bufferView", None)),
    ("accessors.0.sparse", _set("accessors.0.sparse", {"count": 1})),
    ("accessors.0.sparse", _sparse(count=3, view=0)),
    ("accessors.0.sparse", _sparse(count=10**9, view=None)),
    ("replaces row 128 of 4", _sparse(count=4, view=None)),
    ("KHR_draco", _compressed),
    ("EXT_meshopt", _compressed_buffer),
    ("wrapS", _set("samplers", [{"wrapS": 7}])),
    ("sampler", _set("textures.0.sampler", 3)),
    ("instancing", _instanced(TRANSLATION=99)),
    ("instancing.ROTATION: is of type VEC3", _instanced(TRANSLATION=0, ROTATION=0)),
    ("has none of TRANSLATION", _instanced(_ID=0)),
    ("targets", _set("meshes.0", _morphs(1000))),
    ("POSITION", _set("accessors.0.type", "VEC2")),
    ("rows", _set("accessors.0.count", 3)),
    ("bufferViews.0", _set("bufferViews.0.byteLength", 10**9)),
    ("buffer", _set("bufferViews.0.buffer", 3)),
    ("scene", _set("scene", 4)),
    ("scenes.nodes", _set("scenes.0.nodes", [9])),
    ("nodes.0.mesh", _set("nodes.0.mesh", 5)),
    ("rigged", _set("nodes.0.skin", 0)),
    ("nodes.0.matrix", _set("nodes.0.matrix", [1.0] * 15)),
    ("rotation", _set("nodes.0.rotation", [0, 0, 0, 0])),
    ("vertices", _set("nodes.0.scale", [1e300, 1, 1])),
    ("two parents", _two_parents),
    ("two parents", _billion_laughs),
    ("two parents", _cycle),
    ("10000000|primitives|triangles", _many_instances),
    ("triangles", _set("meshes.0.primitives", [])),
    ("triangles", _set("meshes.0.primitives.0.mode", 1)),
    ("POSITION", _set("meshes.0.primitives.0.attributes", {})),
    ("vertices", _nan),
    ("TEXCOORD_3", _set("materials.0.pbrMetallicRoughness.baseColorTexture.texCoord", 3)),
    ("texture", _set("materials.0.pbrMetallicRoughness.baseColorTexture.index", 7)),
    (
        "KHR_texture_basisu",
        _set("textures.0", {"extensions": {"KHR_texture_basisu": {"source": 0}}}),
    ),
    ("images.0", _set("images.0", {})),
    ("is missing", _set("images.0", {"uri": "paint.png"})),
    ("images.0.uri", _set("images.0", {"uri": "../paint.png"})),
    ("images.0.uri", _set("images.0", {"uri": "/etc/passwd"})),
    ("images.0.uri", _set("images.0", {"uri": "%2e%2e/paint.png"})),
    ("is missing", _set("images.0", {"uri": "http://example.com/paint.png"})),
    ("images.0.uri", _set("images.0", {"uri": "data:image/png;base64,????"})),
    ("images.0", _set("images.0", {"uri": "data:image/png;base64,AAAA"})),
    ("60000x60000", _bomb),
    ("KHR_draco", _set("extensionsRequired", ["KHR_draco_mesh_compression"])),
]


@pytest.mark.parametrize(
    ("named", "change"),
    WRONG,
    ids=lambda value: value[:24] if isinstance(value, str) else value.__name__,
)
def test_what_is_wrong_is_named(tmp_path: Path, named: str, change: Callable[[Glb], None]) -> None:
    glb = textured_square(RED)
    change(glb)
    with pytest.raises(InputError, match=named) as error:
        read_glb(glb.write(tmp_path / "a.glb"))
    assert "\n" not in str(error.value)


def test_a_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    data, path = car().bytes(), tmp_path / "a.glb"
    for length in range(0, len(data) - 1, 37):
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            read_glb(path)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"glTF",
        packed(b"[]", b""),
        packed(b"{", b""),
        packed(b'{"a":' * 5000, b""),
        packed(json.dumps({"nodes": 7}).encode(), b""),
        struct.pack("<4sII", b"glTF", 1, 9) + bytes(9),
        struct.pack("<4sIII4s", b"glTF", 2, 24, 2**32 - 1, b"JSON") + bytes(8),
    ],
)
def test_what_is_no_glb(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(data)
    with pytest.raises(InputError):
        read_glb(path)
    with pytest.raises(InputError, match="is missing"):
        read_glb(tmp_path / "none.glb")
