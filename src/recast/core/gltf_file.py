"""glTF 2.0, binary (GLB) or as text: the container, its buffers, and the tree of what it draws.

Khronos, glTF 2.0 Specification, sections 3.5, 3.6 and 4.4. Arrays stay where they lie in the file,
so that what a file claims takes no memory.

The tree is the JSON chunk, as far as geometry and base colour go.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from recast.arrays import Array
from recast.core import files
from recast.core.errors import InputError
from recast.core.files import member
from recast.core.records import validation_error
from recast.geometry import se3

Four = tuple[float, float, float, float]
Share = Field(1.0, ge=0, le=1)

MOST_NODES = 100_000
_MOST_PRIMITIVES = 20_000
_VISIBILITY, _INSTANCES = "KHR_node_visibility", "EXT_mesh_gpu_instancing"
POINTS, TRIANGLES, STRIP, FAN = 0, 4, 5, 6
"""Modes of a primitive."""


class GltfPart(BaseModel):
    """An object of the chunk; members that are not declared are not looked at."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False, alias_generator=to_camel)
    extensions: Mapping[str, Any] = {}


class GltfView(GltfPart):
    """A range of bytes of a buffer."""

    buffer: int
    byte_offset: int = Field(0, ge=0)
    byte_length: int = Field(ge=1)
    byte_stride: int | None = Field(None, ge=1, le=252)


class SparseIndices(GltfPart):
    """Rows of an accessor, in a view."""

    buffer_view: int
    byte_offset: int = Field(0, ge=0)
    component_type: Literal[5121, 5123, 5125]


class SparseValues(GltfPart):
    """Numbers of rows of an accessor, in a view."""

    buffer_view: int
    byte_offset: int = Field(0, ge=0)


class Sparse(GltfPart):
    """Rows of an accessor that differ from its view, or from zeros."""

    count: int = Field(ge=1)
    indices: SparseIndices
    values: SparseValues


class Accessor(GltfPart):
    """An array in a view."""

    buffer_view: int | None = None
    byte_offset: int = Field(0, ge=0)
    component_type: Literal[5120, 5121, 5122, 5123, 5125, 5126]
    normalized: bool = False
    count: int = Field(ge=1)
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    sparse: Sparse | None = None


class Data(GltfPart):
    """A buffer or an image."""

    uri: str | None = None
    buffer_view: int | None = None


class GltfTexture(GltfPart):
    """An image and how it is sampled."""

    source: int | None = None
    sampler: int | None = None


class Sampler(GltfPart):
    """How a texture goes on beyond 0 and 1: clamped, mirrored or repeated."""

    wrap_s: Literal[33071, 33648, 10497] = 10497
    wrap_t: Literal[33071, 33648, 10497] = 10497


class TextureUse(GltfPart):
    """A texture of a material."""

    index: int
    tex_coord: int = Field(0, ge=0)


class Metallic(GltfPart):
    """The metallic-roughness model."""

    base_color_factor: Four = (1.0, 1.0, 1.0, 1.0)
    base_color_texture: TextureUse | None = None
    roughness_factor: float = Share


class Glossy(GltfPart):
    """KHR_materials_pbrSpecularGlossiness, which stands in the place of `Metallic`."""

    diffuse_factor: Four = (1.0, 1.0, 1.0, 1.0)
    diffuse_texture: TextureUse | None = None
    glossiness_factor: float = Share


class Transmission(GltfPart):
    """KHR_materials_transmission: clear glass."""

    transmission_factor: float = Field(0.0, ge=0, le=1)


class EmissiveStrength(GltfPart):
    """KHR_materials_emissive_strength."""

    emissive_strength: float = Field(1.0, ge=0)


class NodeVisibility(GltfPart):
    """KHR_node_visibility; it holds for the nodes below as well."""

    visible: bool = True


class Instances(GltfPart):
    """EXT_mesh_gpu_instancing: accessors of TRANSLATION, ROTATION and SCALE."""

    attributes: dict[str, int]


class TextureTransform(GltfPart):
    """KHR_texture_transform."""

    offset: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    tex_coord: int | None = Field(None, ge=0)

    def apply(self, uv: Array) -> Array:
        """Texture coordinates (..., 2) as the extension moves them."""
        sine, cosine = np.sin(self.rotation), np.cos(self.rotation)
        turn = np.array([[cosine, sine], [-sine, cosine]])
        return (uv * self.scale) @ turn.T + self.offset


class GltfMaterial(GltfPart):
    """A material."""

    pbr_metallic_roughness: Metallic = Metallic()
    alpha_mode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"
    alpha_cutoff: float = 0.5
    emissive_factor: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emissive_texture: TextureUse | None = None


class Primitive(GltfPart):
    """Geometry of one material."""

    attributes: dict[str, int]
    indices: int | None = None
    material: int | None = None
    mode: int = TRIANGLES
    targets: tuple[dict[str, int], ...] = ()
    weights: tuple[float, ...] = ()
    """Weights of the targets: those of the mesh or the node, see `placed_primitives`."""


class GltfMesh(GltfPart):
    """Primitives that move together."""

    primitives: tuple[Primitive, ...]
    weights: tuple[float, ...] = ()


class GltfNode(GltfPart):
    """A frame, maybe with a mesh."""

    children: tuple[int, ...] = ()
    mesh: int | None = None
    skin: int | None = None
    weights: tuple[float, ...] | None = None
    matrix: tuple[float, ...] | None = Field(None, min_length=16, max_length=16)
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: Four = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def pose(self) -> Array:
        """(4, 4) of this node in its parent's frame, scale included.

        Raises:
            ValueError: the quaternion is zero.
        """
        if self.matrix is not None:
            return np.array(self.matrix).reshape(4, 4).T
        return _pose(np.array(self.translation), np.array(self.rotation), np.array(self.scale))


def _pose(translation: Array, rotation: Array, scale: Array) -> Array:
    """(..., 4, 4) of translations, quaternions xyzw and scales (..., 3 or 4).

    Raises:
        ValueError: a quaternion is zero.
    """
    turn = se3.quat_to_matrix(np.roll(rotation, 1, axis=-1))
    return se3.from_rotation_translation(turn * scale[..., None, :], translation)


class GltfScene(GltfPart):
    """Nodes without a parent."""

    nodes: tuple[int, ...] = ()


class GltfAsset(GltfPart):
    """What the file says about itself."""

    extras: Any = None


class Tree(GltfPart):
    """The whole chunk."""

    asset: GltfAsset = GltfAsset()
    scene: int = 0
    scenes: tuple[GltfScene, ...] = ()
    nodes: tuple[GltfNode, ...] = Field((), max_length=MOST_NODES)
    meshes: tuple[GltfMesh, ...] = ()
    materials: tuple[GltfMaterial, ...] = ()
    textures: tuple[GltfTexture, ...] = ()
    samplers: tuple[Sampler, ...] = ()
    images: tuple[Data, ...] = ()
    accessors: tuple[Accessor, ...] = ()
    buffer_views: tuple[GltfView, ...] = ()
    buffers: tuple[Data, ...] = ()
    extensions_required: tuple[str, ...] = ()


def placed_primitives(file: GlbFile) -> list[tuple[Primitive, Array, str]]:
    """Primitives of the scene, `scene_from_mesh` (4, 4), and their names; each instance is one.

    Raises:
        InputError: the nodes are no tree, one is rigged, instances lack data, or there are too many
            primitives.
    """
    tree = file.tree
    children = {child for node in tree.nodes for child in node.children}
    roots: Sequence[int] = [i for i in range(len(tree.nodes)) if i not in children]
    if tree.scenes:
        roots = file.at(tree.scenes, tree.scene, "scene").nodes
    waiting = [(root, np.eye(4), "scenes.nodes") for root in roots]
    seen: set[int] = set()
    found: list[tuple[Primitive, Array, str]] = []
    while waiting:
        index, pose, named = waiting.pop()
        node, field = file.at(tree.nodes, index, named), f"nodes.{index}"
        if index in seen:
            raise file.fault(field, "has two parents")
        seen.add(index)
        visibility = file.extension(node, _VISIBILITY, NodeVisibility)
        if visibility is not None and not visibility.visible:
            continue
        if node.skin is not None:
            raise file.fault(f"{field}.skin", "is rigged, which is not read")
        try:
            pose = pose @ node.pose()
        except ValueError:
            raise file.fault(f"{field}.rotation", "is a quaternion of norm zero") from None
        waiting += [(child, pose, f"{field}.children") for child in node.children]
        if node.mesh is None:
            continue
        mesh = file.at(tree.meshes, node.mesh, f"{field}.mesh")
        weights = mesh.weights if node.weights is None else node.weights
        instances = _instances(file, node, field)
        if len(found) + len(instances) * len(mesh.primitives) > _MOST_PRIMITIVES:
            raise file.fault("nodes", f"draw more than {_MOST_PRIMITIVES} primitives")
        for i, primitive in enumerate(mesh.primitives):
            one = primitive.model_copy(update={"weights": weights})
            name = f"meshes.{node.mesh}.primitives.{i}"
            found += [(one, pose @ instance, name) for instance in instances]
    return found


def _instances(file: GlbFile, node: GltfNode, field: str) -> Array:
    """(N, 4, 4) places of a node's mesh in the node's frame: one, unless it has instances."""
    extension = file.extension(node, _INSTANCES, Instances)
    if extension is None:
        return np.eye(4)[None]
    named = f"{field}.{_INSTANCES}"
    known = {"TRANSLATION": (0.0, 0.0, 0.0), "ROTATION": (0.0, 0.0, 0.0, 1.0), "SCALE": (1.0,) * 3}
    given = {name: index for name, index in extension.attributes.items() if name in known}
    if not given:
        raise file.fault(named, f"has none of {', '.join(known)}")
    count = file.at(file.tree.accessors, next(iter(given.values())), named).count
    if count > _MOST_PRIMITIVES:
        raise file.fault(named, f"draws more than {_MOST_PRIMITIVES} instances")
    rows = [
        file.rows(given[name], f"{named}.{name}", (len(usual),), count).astype(np.float64)
        if name in given
        else np.tile(usual, (count, 1))
        for name, usual in known.items()
    ]
    try:
        return _pose(*rows)
    except ValueError:
        raise file.fault(f"{named}.ROTATION", "holds a quaternion of norm zero") from None


One = TypeVar("One")
Kind = TypeVar("Kind", bound=GltfPart)

MOST_BYTES = 1 << 29
"""Maximum size in bytes of a file of triangles, and of any file that it names."""
LONGEST_GLB = (1 << 32) - 1
"""Bytes that the container's header can tell."""
_MEND = "export it again as plain glTF 2.0 binary (.glb), uncompressed and without a rig"
_JSON_BYTES = 1 << 25
_GLB, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_COMPRESSION = "compression"  # in names of extensions without which there is no geometry
_MOST_MADE = 1 << 24  # rows of sparse arrays, which a file can claim without having them
_TEXT_SUFFIX = ".gltf"


class GlbFile:
    """An open file; `tree` is its JSON chunk.

    Raises:
        InputError: no whole GLB, a member that is missing or out of range, or compressed. Also from
            the methods: there is no such member, it is wrong, of another width or with too few
            rows, or not all of it is there.
    """

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES) -> None:
        self.path = path
        data = memoryview(files.read_bytes(path, most_bytes))
        is_text = path.suffix.lower() == _TEXT_SUFFIX
        chunks = {_JSON: data} if is_text else self._chunks(data)
        if len(chunks.get(_JSON, b"")) not in range(1, _JSON_BYTES):
            raise self.fault("JSON", f"is missing, or of more than {_JSON_BYTES} bytes")
        try:
            self.tree = Tree.model_validate(files.parse_json(path, bytes(chunks[_JSON])))
        except ValidationError as error:
            raise validation_error(path, error, _MEND) from None
        for name in self.tree.extensions_required:
            if _COMPRESSION in name.lower():
                raise self.fault("extensionsRequired", f"names {name}, which is not read")
        self._buffers: dict[int, memoryview] = {}
        self._sparse: dict[int, NDArray[Any]] = {}
        first = self.tree.buffers[0] if self.tree.buffers else None
        compressed = first is not None and self._compressions(first)  # it has no data of its own
        if _BIN in chunks and first is not None and first.uri is None and not compressed:
            self._buffers[0] = chunks[_BIN]

    def fault(self, field: str, problem: str) -> InputError:
        """The error of a member."""
        return InputError(self.path, field, problem, _MEND)

    def no_data(self, field: str, owner: GltfPart) -> InputError:
        """The error of a member whose data are missing, or compressed by an extension."""
        names = self._compressions(owner)
        return self.fault(field, f"has no data{' without ' * bool(names)}{', '.join(names)}")

    def _compressions(self, owner: GltfPart) -> list[str]:
        return [name for name in owner.extensions if _COMPRESSION in name.lower()]

    def at(self, members: Sequence[One], index: int, field: str) -> One:
        """The member that `field` names by its index."""
        if not 0 <= index < len(members):
            raise self.fault(field, f"is {index}, of {len(members)}")
        return members[index]

    def extension(self, owner: GltfPart, name: str, kind: type[Kind]) -> Kind | None:
        """An extension of an object; None if it has none of that name."""
        if name not in owner.extensions:
            return None
        try:
            return kind.model_validate(owner.extensions[name])
        except ValidationError as error:
            fault = validation_error(self.path, error, _MEND)
            raise self.fault(f"{name}.{fault.field}", fault.problem) from None

    def view(self, index: int, field: str) -> memoryview:
        """The bytes of a buffer view."""
        view = self.at(self.tree.buffer_views, index, field)
        buffer = self._buffer(view.buffer)
        end = view.byte_offset + view.byte_length
        if end > len(buffer):
            raise self.fault(f"bufferViews.{index}", f"ends at byte {end} of {len(buffer)}")
        return buffer[view.byte_offset : end]

    def array(self, index: int, field: str, widths: tuple[int, ...]) -> NDArray[Any]:
        """An accessor's numbers (N, width); its width is one of `widths`.

        They stay where they lie, unless they are sparse. Without data they are zeros.
        """
        accessor = self.at(self.tree.accessors, index, field)
        width = _WIDTHS.get(accessor.type, 0)
        if width not in widths:
            raise self.fault(field, f"is of type {accessor.type}")
        dtype, shape = np.dtype(_TYPES[accessor.component_type]), (accessor.count, width)
        name = f"accessors.{index}"
        if accessor.buffer_view is None:
            values = np.broadcast_to(np.zeros((), dtype), shape)
        else:
            values = self._numbers(accessor.buffer_view, accessor.byte_offset, dtype, shape, name)
        if accessor.sparse is None:
            return values
        if index not in self._sparse:
            self._sparse[index] = self._replaced(values, accessor.sparse, f"{name}.sparse")
        return self._sparse[index]

    def _numbers(
        self, index: int, offset: int, dtype: np.dtype, shape: tuple[int, int], field: str
    ) -> NDArray[Any]:
        """Numbers (N, width) in a view, from a byte of it on."""
        data = self.view(index, f"{field}.bufferView")
        row = shape[1] * dtype.itemsize
        stride = self.tree.buffer_views[index].byte_stride or row
        end = offset + (shape[0] - 1) * stride + row
        if end > len(data):
            raise self.fault(field, f"ends at byte {end} of {len(data)}")
        return np.ndarray(shape, dtype, data, offset, (stride, dtype.itemsize))

    def _replaced(self, values: NDArray[Any], sparse: Sparse, field: str) -> NDArray[Any]:
        """A copy of numbers with some rows replaced."""
        if sum(map(len, self._sparse.values())) + len(values) > _MOST_MADE:
            raise self.fault(field, f"arrays have more than {_MOST_MADE} rows")
        kind = np.dtype(_TYPES[sparse.indices.component_type])
        at, of = sparse.indices, sparse.values
        rows = self._numbers(at.buffer_view, at.byte_offset, kind, (sparse.count, 1), field)[:, 0]
        if int(rows.max()) >= len(values):
            raise self.fault(field, f"replaces row {rows.max()} of {len(values)}")
        shape = (sparse.count, values.shape[1])
        replaced = values.copy()
        replaced[rows] = self._numbers(of.buffer_view, of.byte_offset, values.dtype, shape, field)
        return replaced

    def corners(
        self,
        index: int,
        field: str,
        widths: tuple[int, ...],
        faces: NDArray[np.int64],
        shares: bool = False,
    ) -> NDArray[np.float64]:
        """An accessor's numbers at the corners of faces (F, 3), (F, 3, width); shares as such.

        With `shares`, whole numbers are normalised even if the accessor does not say so. Only what
        is asked for becomes floats: primitives may share one array of all vertices.
        """
        values = self.array(index, field, widths)
        if len(faces) and faces.max() >= len(values):
            raise self.fault(field, f"has {len(values)} rows, the indices go up to {faces.max()}")
        return self._shares(index, values[faces].astype(np.float64), values.dtype, shares)

    def rows(
        self, index: int, field: str, widths: tuple[int, ...], count: int
    ) -> NDArray[np.float32]:
        """An accessor's numbers (`count`, width); shares as such."""
        values = self.array(index, field, widths)
        if len(values) != count:
            raise self.fault(field, f"has {len(values)} rows, not {count}")
        return self._shares(index, values.astype(np.float32), values.dtype)

    def _shares(
        self, index: int, values: NDArray[Any], kind: np.dtype, always: bool = False
    ) -> NDArray[Any]:
        """Numbers that an accessor stored as `kind`, normalised if it says so (section 3.6.2.2)."""
        if (always or self.tree.accessors[index].normalized) and kind.kind != "f":
            return np.maximum(values / np.iinfo(kind).max, -1.0).astype(values.dtype)
        return values

    def _buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            buffer = self.at(self.tree.buffers, index, "buffer")
            if buffer.uri is None:
                raise self.no_data(f"buffers.{index}", buffer)
            data = data_of(self.path, buffer.uri, f"buffers.{index}.uri")
            self._buffers[index] = memoryview(data)
        return self._buffers[index]

    def _chunks(self, data: memoryview) -> dict[int, memoryview]:
        """The first chunk of each type."""
        if len(data) < 20 or struct.unpack("<II", data[:8]) != (_GLB, 2):
            raise self.fault("header", "is not that of a binary glTF 2.0 file")
        found: dict[int, memoryview] = {}
        at = 12
        while at + 8 <= len(data):
            length, kind = struct.unpack("<II", data[at : at + 8])
            if at + 8 + length > len(data):
                problem = f"of {length} bytes at byte {at}, but {len(data) - at - 8} are left"
                raise self.fault("chunk", problem)
            found.setdefault(kind, data[at + 8 : at + 8 + length])
            at += 8 + length
        return found


def named_uri(path: Path, uri: str, what: str) -> Path | None:
    """The file that a glTF URI names, see `names.member`; None if the data stands in the URI."""
    if uri.startswith("data:"):
        return None
    return member(path.parent, unquote(uri).replace("\\", "/"), path, what)


def data_of(path: Path, uri: str, what: str) -> bytes:
    """The bytes of a glTF URI: base64 in place, or a file.

    Raises:
        InputError: the base64 is broken, or see `names.member` and `files.read_bytes`.
    """
    file = named_uri(path, uri, what)
    if file is not None:
        return files.read_bytes(file, MOST_BYTES)
    head, _, text = uri.partition(",")
    try:
        if head.endswith(";base64"):
            return base64.b64decode(text, validate=True)
    except ValueError:
        pass
    raise InputError(path, what, "is not base64", "export it again")


def write_glb(path: str | Path, tree: Mapping[str, Any], binary: bytes) -> None:
    """Write a GLB, whole or not at all.

    Args:
        tree: the JSON chunk, whose first buffer is `binary`.

    Raises:
        InputError: the file would be larger than a GLB can be, or the disk refuses.
    """
    text = json.dumps(tree, separators=(",", ":"), allow_nan=False).encode()
    chunks = [(_JSON, text + b" " * (-len(text) % 4)), (_BIN, binary + bytes(-len(binary) % 4))]
    length = 12 + sum(8 + len(data) for _, data in chunks)
    if length > LONGEST_GLB:
        problem = f"would have {length} bytes, a GLB has {LONGEST_GLB} at most"
        raise InputError(path, "size", problem, "write its parts, or another format")
    parts = [struct.pack("<III", _GLB, 2, length)]
    for kind, data in chunks:
        parts += [struct.pack("<II", len(data), kind), data]
    files.write_bytes(path, b"".join(parts))
