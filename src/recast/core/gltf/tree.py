"""The JSON chunk of a glTF 2.0 file, as far as geometry and base colour go, and what it draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from pydantic.alias_generators import to_camel

from recast.arrays import Array
from recast.geometry import se3

if TYPE_CHECKING:
    from recast.core.gltf.file import GlbFile

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
    """Of the targets: those of the mesh or the node, see `placed_primitives`."""


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
