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
POINTS, TRIANGLES, STRIP, FAN = 0, 4, 5, 6
"""Modes of a primitive."""


class Part(BaseModel):
    """An object of the chunk; members that are not declared are not looked at."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False, alias_generator=to_camel)
    extensions: Mapping[str, Any] = {}


class View(Part):
    """A range of bytes of a buffer."""

    buffer: int
    byte_offset: int = Field(0, ge=0)
    byte_length: int = Field(ge=1)
    byte_stride: int | None = Field(None, ge=1, le=252)


class Accessor(Part):
    """An array in a view."""

    buffer_view: int | None = None
    byte_offset: int = Field(0, ge=0)
    component_type: Literal[5120, 5121, 5122, 5123, 5125, 5126]
    normalized: bool = False
    count: int = Field(ge=1)
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    sparse: Any = None


class Data(Part):
    """A buffer or an image."""

    uri: str | None = None
    buffer_view: int | None = None


class Texture(Part):
    """An image and how it is sampled."""

    source: int | None = None


class TextureUse(Part):
    """A texture of a material."""

    index: int
    tex_coord: int = Field(0, ge=0)


class Metallic(Part):
    """The metallic-roughness model."""

    base_color_factor: Four = (1.0, 1.0, 1.0, 1.0)
    base_color_texture: TextureUse | None = None
    roughness_factor: float = Share


class Glossy(Part):
    """KHR_materials_pbrSpecularGlossiness, which stands in the place of `Metallic`."""

    diffuse_factor: Four = (1.0, 1.0, 1.0, 1.0)
    diffuse_texture: TextureUse | None = None
    glossiness_factor: float = Share


class Transmission(Part):
    """KHR_materials_transmission: clear glass."""

    transmission_factor: float = Field(0.0, ge=0, le=1)


class Placement(Part):
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


class Surface(Part):
    """A material."""

    pbr_metallic_roughness: Metallic = Metallic()
    alpha_mode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"
    alpha_cutoff: float = 0.5


class Primitive(Part):
    """Geometry of one material."""

    attributes: dict[str, int]
    indices: int | None = None
    material: int | None = None
    mode: int = TRIANGLES


class Mesh(Part):
    """Primitives that move together."""

    primitives: tuple[Primitive, ...]


class Node(Part):
    """A frame, maybe with a mesh."""

    children: tuple[int, ...] = ()
    mesh: int | None = None
    skin: int | None = None
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
        x, y, z, w = self.rotation
        turn = se3.quat_to_matrix([w, x, y, z])
        return se3.from_rotation_translation(turn * np.array(self.scale), self.translation)


class Scene(Part):
    """Nodes without a parent."""

    nodes: tuple[int, ...] = ()


class Asset(Part):
    """What the file says about itself."""

    extras: Any = None


class Tree(Part):
    """The whole chunk."""

    asset: Asset = Asset()
    scene: int = 0
    scenes: tuple[Scene, ...] = ()
    nodes: tuple[Node, ...] = Field((), max_length=MOST_NODES)
    meshes: tuple[Mesh, ...] = ()
    materials: tuple[Surface, ...] = ()
    textures: tuple[Texture, ...] = ()
    images: tuple[Data, ...] = ()
    accessors: tuple[Accessor, ...] = ()
    buffer_views: tuple[View, ...] = ()
    buffers: tuple[Data, ...] = ()
    extensions_required: tuple[str, ...] = ()


def placed_primitives(file: GlbFile) -> list[tuple[Primitive, Array, str]]:
    """Primitives of the scene, `scene_from_mesh` (4, 4), and their names.

    Raises:
        InputError: the nodes are no tree, one is rigged, or there are too many primitives.
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
        if node.skin is not None:
            raise file.fault(f"{field}.skin", "is rigged, which is not read")
        try:
            pose = pose @ node.pose()
        except ValueError:
            raise file.fault(f"{field}.rotation", "is a quaternion of norm zero") from None
        waiting += [(child, pose, f"{field}.children") for child in node.children]
        if node.mesh is None:
            continue
        primitives = file.at(tree.meshes, node.mesh, f"{field}.mesh").primitives
        names = (f"meshes.{node.mesh}.primitives.{i}" for i in range(len(primitives)))
        found += [(one, pose, name) for one, name in zip(primitives, names, strict=False)]
        if len(found) > _MOST_PRIMITIVES:
            raise file.fault("nodes", f"draw more than {_MOST_PRIMITIVES} primitives")
    return found
