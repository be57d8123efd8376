"""Vehicles from textured mesh files: GLB and OBJ to flat Gaussians."""

from recast.actors.mesh.generator import MeshGenerator
from recast.actors.mesh.read import MESH_SUFFIXES, files_of_mesh, read_triangles

__all__ = ["MESH_SUFFIXES", "MeshGenerator", "files_of_mesh", "read_triangles"]
