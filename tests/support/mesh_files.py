"""Mesh files made by hand, byte by byte, and a box-shaped car."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

TYPES = {"float32": 5126, "uint16": 5123, "int16": 5122, "uint32": 5125, "uint8": 5121}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
"""Corners of a square of edge one in the xy plane."""
HALVES = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
SQUARE_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
"""Its texture coordinates in glTF: the picture stands upright, seen from +z."""
CAR = np.array([4.0, 1.8, 1.4])
"""Size of `car`."""


class Glb:
    """A GLB in the making: `tree` is the JSON chunk, to be changed at will."""

    def __init__(self) -> None:
        self.binary = b""
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": []}],
            "buffers": [{}],
            "bufferViews": [],
            "accessors": [],
        }

    def view(self, data: bytes) -> int:
        """Add bytes; the index of their buffer view."""
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.tree["bufferViews"].append(view)
        self.binary += data
        return len(self.tree["bufferViews"]) - 1

    def array(self, values: np.ndarray, **more: Any) -> int:
        """Add numbers (N,) or (N, width); the index of their accessor."""
        width = 1 if values.ndim == 1 else values.shape[1]
        self.tree["accessors"].append(
            {
                "bufferView": self.view(values.tobytes()),
                "count": len(values),
                "componentType": TYPES[values.dtype.name],
                "type": KINDS[width],
                **more,
            }
        )
        return len(self.tree["accessors"]) - 1

    def primitive(
        self, points: np.ndarray, faces: np.ndarray | None, mesh: int = 0, **more: Any
    ) -> dict[str, Any]:
        """Add triangles to a mesh; the primitive."""
        found: dict[str, Any] = {"attributes": {"POSITION": self.array(points)}, **more}
        if faces is not None:
            found["indices"] = self.array(faces.ravel())
        self.tree["meshes"][mesh]["primitives"].append(found)
        return found

    def sparse(self, count: int, rows: np.ndarray, values: np.ndarray, **more: Any) -> int:
        """Add `count` rows of which only some are given; the index of their accessor."""
        places = {
            "indices": {"bufferView": self.view(rows.tobytes()), "componentType": 5121},
            "values": {"bufferView": self.view(values.tobytes())},
        }
        numbers = {"count": count, "componentType": 5126, "type": KINDS[values.shape[1]]}
        sparse = {"count": len(rows), **places}
        self.tree["accessors"].append({**numbers, "sparse": sparse, **more})
        return len(self.tree["accessors"]) - 1

    def bytes(self) -> bytes:
        """The file."""
        self.tree["buffers"][0].setdefault("byteLength", len(self.binary))
        return packed(json.dumps(self.tree).encode(), self.binary)

    def write(self, path: Path) -> Path:
        """Write the file."""
        path.write_bytes(self.bytes())
        return path


def packed(tree: bytes, binary: bytes) -> bytes:
    """A GLB of its two chunks."""
    tree += b" " * (-len(tree) % 4)
    binary += bytes(-len(binary) % 4)
    body = struct.pack("<I4s", len(tree), b"JSON") + tree
    body += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def picture(pixels: np.ndarray, form: str = "PNG") -> bytes:
    """A picture file of (H, W, 3 or 4) uint8."""
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, form)
    return out.getvalue()


def textured_square(pixels: np.ndarray) -> Glb:
    """The square with a picture on it, inside of the file."""
    glb = Glb()
    one = glb.primitive(SQUARE, HALVES, material=0)
    one["attributes"]["TEXCOORD_0"] = glb.array(SQUARE_UV)
    glb.tree["images"] = [{"bufferView": glb.view(picture(pixels)), "mimeType": "image/png"}]
    glb.tree["textures"] = [{"source": 0}]
    glb.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    return glb


def box(low: Any, high: Any) -> tuple[np.ndarray, np.ndarray]:
    """Corners (8, 3) and faces (12, 3) of a box, wound counter-clockwise seen from outside."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
    placed = np.asarray(low) + corners * np.subtract(high, low)
    return placed.astype(np.float32), np.array(faces, np.uint16)


def car(glass: float = 0.3) -> Glb:
    """A saloon of boxes as glTF has it (y up, z forward): body, cabin of glass, roof and wheels."""
    glb = Glb()
    parts = [
        ((-2.0, -0.9, -0.45), (2.0, 0.9, 0.25), 0),
        ((-1.0, -0.8, 0.25), (0.9, 0.8, 0.66), 1),
        ((-1.0, -0.8, 0.66), (0.9, 0.8, 0.7), 0),
    ]
    parts += [
        ((x - 0.3, y - 0.1, -0.7), (x + 0.3, y + 0.1, -0.45), 2)
        for x in (-1.3, 1.3)
        for y in (-0.75, 0.75)
    ]
    to_gltf = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    for low, high, material in parts:
        corners, faces = box(low, high)
        glb.primitive((corners @ to_gltf.T).astype(np.float32), faces, material=material)
    paint = [[0.5, 0.02, 0.02, 1.0], [0.05, 0.05, 0.05, glass], [0.02, 0.02, 0.02, 1.0]]
    glb.tree["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorFactor": colour},
            "alphaMode": "BLEND" if colour[3] < 1 else "OPAQUE",
        }
        for colour in paint
    ]
    return glb
